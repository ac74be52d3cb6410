# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes files atomically: into a hidden folder beside the targets, then renamed, so that an error leaves the old files as they were.

The hidden folder holds a lock as long as its writer lives (util/locks.py).  What a killed process left is removed by the next one that
writes there, and nothing that is still in use.

Several files that belong together (a PLY and its decoder) are replaced together, even if the process is killed between two renames.
A journal beside them, written before the first rename, names every rename.  Whoever writes these files next completes it.  Reading changes
nothing: who reads files of different ages is told so.

A journal may come from a stranger, in an archive or a shared folder.  So it is followed only if this user owns it and it names nothing but
the files that are being written.
"""
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

from . import locks
from .errors import FastGSError
from .reading import read_json, regular_file

ASIDE = re.compile(r"\.fastgs-[0-9a-f]{12}\.tmp")
LOCK, BEFORE = ".held", ".before-"
"""In the hidden folder: its writer's lock, and what the names of copies of the old files begin with."""
COPY = re.compile(re.escape(BEFORE) + r"\d+")
LARGEST_JOURNAL = 1 << 16
STALE = 6 * 3600.0
"""Seconds after which hidden files are left over that no lock tells about: cached frames, and where there are no locks."""
PATIENCE, PAUSE = 2.0, 0.02
"""Seconds that a reader waits for another process to finish its renames, and between two looks."""
_cleared: set[str] = set()
"""Folders from which this process has removed leftovers."""


@contextmanager
def replacing(paths: list[Path]) -> Iterator[list[Path]]:
    """Temporary files that take the place of `paths`, all or none, when the block ends well; several lie in one folder.

    Raises FastGSError where a path cannot be written.
    """
    try:
        targets = [Path(os.path.realpath(path)) for path in paths]
    except ValueError as error:  # a zero in the name
        raise FastGSError(f"this is no name for a file ({error}); choose another.") from error
    for target in targets:
        _check(target)
    folder = targets[-1].parent
    if any(target.parent != folder for target in targets):
        raise FastGSError("its files are links into different folders; choose another name.")
    complete(targets)
    if str(folder) not in _cleared:
        _cleared.add(str(folder))
        remove_leftovers(folder)
    with _aside(folder, _journal(targets[-1])) as aside:
        temporaries = [aside / target.name for target in targets]
        for temporary in temporaries:
            temporary.touch(exist_ok=False)
        usual = [temporary.stat().st_mode for temporary in temporaries]
        yield temporaries
        for temporary, target, mode in zip(temporaries, targets, usual, strict=True):
            with open(temporary, "rb+") as stream:
                os.fsync(stream.fileno())
            with suppress(OSError):  # who may read it: as before, else what the user's system gives new files
                temporary.chmod((target.stat().st_mode if target.exists() else mode) & 0o7777)
        if len(targets) == 1:
            os.replace(temporaries[0], targets[0])
        else:
            _replace_together(aside, targets)


@contextmanager
def writing(paths: Iterable[str | os.PathLike], advice: str = "what was there before is kept") -> Iterator[list[Path]]:
    """replacing(); where the system or the block cannot write, FastGSError with the reason and `advice`, what to do about it."""
    targets = [Path(path) for path in paths]
    try:
        with replacing(targets) as parts:
            yield parts
    except (FastGSError, OSError) as error:
        reason = f"{getattr(error, 'strerror', None) or error}".rstrip(".")
        raise FastGSError(f"{targets[0]} could not be written: {reason}; {advice}.") from error


def complete(paths: Iterable[Path]) -> None:
    """Finish the replacement of these files that a killed process began; raises FastGSError where that fails.

    A file that was changed by hand meanwhile stays as it is.  A journal that is not ours, or names other files, is removed.
    """
    targets = [Path(os.path.realpath(path)) for path in paths]
    for target in targets:
        journal = _journal(target)
        if not os.path.lexists(journal):
            continue
        found = _read_journal(journal)
        own = all(map(_ours, (journal, target.parent / found.aside))) if found is not None else False
        if found is None or not own or not {step.target for step in found.steps} <= {each.name for each in targets}:
            with suppress(OSError):
                journal.unlink()
            continue
        try:
            _follow(journal, found)
        except OSError as error:
            raise FastGSError(f"{target}: saving it was stopped halfway, and the rest cannot be done ({error.strerror or error}); make its "
                              "folder writable and try again.") from error


def check_whole(path: Path) -> None:
    """Raise FastGSError where `path` and its companions are of different ages, because saving them was stopped between two renames.

    Nothing is changed.  Where another process is about to rename the rest, it is waited for.
    """
    journal = _journal(Path(os.path.realpath(path)))
    until = time.monotonic() + PATIENCE
    while os.path.lexists(journal) and _is_mixed(journal):
        if time.monotonic() > until:
            raise FastGSError(f"{path}: saving it was stopped halfway, so its files do not belong together; save it there again.")
        time.sleep(PAUSE)


def remove_leftovers(folder: str | Path) -> None:
    """Remove what killed processes of this user left aside in a folder, but for what a journal still needs."""
    folder = Path(folder)
    with suppress(OSError):
        names = [entry.name for entry in os.scandir(folder) if entry.name.startswith(".fastgs-")]
        needed = {found.aside for name in names if name.endswith(".journal") and (found := _read_journal(folder / name))}
        for name in names:
            if name.endswith(".tmp") and name not in needed:
                _remove_dead(folder / name)


def appending(path: str | os.PathLike, mode: str = "ab", **options: Any) -> IO[Any]:
    """A regular file, opened as open() does to append to it, made where there is none; raises FastGSError for anything else, OSError.

    A pipe would make its writer wait for ever.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
    return os.fdopen(regular_file(path, flags), mode, **options)


class _Step(NamedTuple):
    """Of a journal: the new file's name in the hidden folder, None: the file goes; its target's name; the target's state before."""

    source: str | None
    target: str
    state: list[int] | None


class _Journal(NamedTuple):
    """The renames of a replacement, and its hidden folder; undo: they bring back what was there before."""

    steps: list[_Step]
    aside: str
    undo: bool


@contextmanager
def _aside(folder: Path, journal: Path) -> Iterator[Path]:
    """A new hidden folder, held by this process, and removed at the end, unless a journal says what is still to be done with it."""
    aside = folder / f".fastgs-{secrets.token_hex(6)}.tmp"
    aside.mkdir()
    lock = None
    try:
        with suppress(locks.NoLocks):
            lock = locks.hold(aside / LOCK)
        yield aside
    finally:
        if lock is not None:
            lock.close()
        found = _read_journal(journal) if os.path.lexists(journal) else None
        if found is None or found.aside != aside.name:
            shutil.rmtree(aside, ignore_errors=True)


def _remove_dead(path: Path) -> None:
    """Remove a hidden folder, or a file such as the cache of frames has them, unless its writer lives."""
    with suppress(OSError, FastGSError):
        about = os.lstat(path)
        old = time.time() - about.st_mtime > STALE
        if not _ours(path):
            return
        if stat.S_ISREG(about.st_mode) and old:
            path.unlink()
        elif stat.S_ISDIR(about.st_mode) and ASIDE.fullmatch(path.name):
            try:
                lock = locks.hold(path / LOCK) if (path / LOCK).exists() or old else None
            except locks.NoLocks:
                lock = open(os.devnull, "rb") if old else None  # noqa: SIM115 (closed below)
            if lock is not None:
                lock.close()  # Windows removes no open file
                shutil.rmtree(path, ignore_errors=True)


def _ours(path: Path) -> bool:
    """Whether this user owns what is at a path, and it is no link."""
    try:
        about = os.lstat(path)
    except OSError:
        return False
    return not stat.S_ISLNK(about.st_mode) and (not hasattr(os, "geteuid") or about.st_uid == os.geteuid())


def _check(target: Path) -> None:
    if target.is_dir():
        raise FastGSError("this is a folder; give the name of a file in it.")
    if target.exists() and not target.is_file():
        raise FastGSError("this is not an ordinary file; choose another name.")
    if not target.parent.is_dir():
        raise FastGSError("its folder does not exist; create it first or choose another.")


def _journal(target: Path) -> Path:
    """Where the journal of a replacement lies whose last file is `target`; a hash, because names have a greatest length."""
    return target.parent / f".fastgs-{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:12]}.journal"


def _state(path: Path) -> list[int] | None:
    """What tells whether a file was changed: its length and time of change; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return [found.st_size, found.st_mtime_ns]


def _replace_together(aside: Path, targets: list[Path]) -> None:
    """Rename the files aside to their targets, all or none; a process that is killed leaves a journal from which the rest is done."""
    journal, steps = _journal(targets[-1]), [_Step(target.name, target.name, _state(target)) for target in targets]
    kept = [f"{BEFORE}{i}" if target.exists() else None for i, target in enumerate(targets[:-1])]
    for copy, target in zip(kept, targets, strict=False):
        if copy is not None:
            shutil.copy2(target, aside / copy)
    forward = _Journal(steps, aside.name, False)
    _write_journal(journal, forward)
    try:
        _follow(journal, forward)
    except BaseException:
        if not (aside / targets[-1].name).exists():
            raise  # all are renamed
        undo = _Journal([_Step(copy, target.name, _state(target)) for copy, target in zip(kept, targets, strict=False)
                         if not (aside / target.name).exists()], aside.name, True)
        _write_journal(journal, undo)
        _follow(journal, undo)
        raise


def _write_journal(journal: Path, found: _Journal) -> None:
    part = journal.parent / found.aside / ".journal"
    with open(part, "w", encoding="utf-8") as stream:
        json.dump(found._asdict(), stream)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(part, journal)


def _is_pending(folder: Path, aside: str, step: _Step) -> bool:
    there = step.source is None or os.path.isfile(folder / aside / step.source)  # False for a name that is too long, too
    return there and (step.source is not None or step.state is not None) and _state(folder / step.target) == step.state


def _is_mixed(journal: Path) -> bool:
    """Whether some renames of a journal are done and others are still to be done."""
    found = _read_journal(journal)
    if found is None:
        return False
    pending = sum(_is_pending(journal.parent, found.aside, step) for step in found.steps)
    return pending > 0 and (found.undo or pending < len(found.steps))


def _follow(journal: Path, found: _Journal) -> None:
    """Do the steps of a journal that are still to be done, and remove it; another process may do the same at the same time."""
    folder = journal.parent
    for step in found.steps:
        if not _is_pending(folder, found.aside, step):
            continue
        with suppress(FileNotFoundError):  # the other process was quicker
            if step.source is None:
                (folder / step.target).unlink()
            else:
                os.replace(folder / found.aside / step.source, folder / step.target)
    journal.unlink(missing_ok=True)
    shutil.rmtree(folder / found.aside, ignore_errors=True)


def _read_journal(journal: Path) -> _Journal | None:
    """What a journal says; None where it is damaged, or says what _replace_together() never does: it may be from outside."""
    try:
        values = read_json(journal, LARGEST_JOURNAL)
        found = _Journal([_Step(*step) for step in values["steps"]], values["aside"], values["undo"])
        good = (ASIDE.fullmatch(found.aside) is not None and isinstance(found.undo, bool)
                and all(_is_plain(step.target) and _is_aside(step) for step in found.steps)
                and not os.path.islink(journal.parent / found.aside))
    except (FastGSError, KeyError, TypeError, ValueError):
        return None
    return found if good else None


def _is_aside(step: _Step) -> bool:
    """Whether a step's source is in the hidden folder; C:x would lie in another one on Windows."""
    return step.source in (None, step.target) or (isinstance(step.source, str) and COPY.fullmatch(step.source) is not None)


def _is_plain(name: object) -> bool:
    """Whether a name is that of a file in the same folder."""
    return isinstance(name, str) and name not in ("", ".", "..") and not any(c in name for c in "/\\\0")
