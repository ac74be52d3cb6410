# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes files atomically: into a hidden folder beside the targets, then renamed, so that an error leaves the old files as they were.

The hidden folder holds a lock as long as its writer lives (util/locks.py).  What a killed process left is removed by the next one that
writes there, and nothing that is still in use.  Several files that belong together (a PLY and its decoder) are replaced together: if one
cannot be renamed, the others are as before.
"""
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO

from . import locks
from .errors import FastGSError
from .reading import regular_file

ASIDE = re.compile(r"\.fastgs-[0-9a-f]{12}\.tmp")
LOCK, BEFORE = ".held", ".before-"
"""In the hidden folder: its writer's lock, and what the names of copies of the old files begin with."""
STALE = 6 * 3600.0
"""Seconds after which hidden files are left over that no lock tells about: cached frames, and where there are no locks."""
_cleared: set[str] = set()
"""Folders from which this process has removed leftovers."""


def make_folder(folder: Path, what: str) -> None:
    """Make a folder for what a command writes; raises FastGSError where that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FastGSError(f"{folder}: the folder for the {what} cannot be made ({error.strerror}); choose another with --out.") from error


@contextmanager
def replacing(paths: list[Path]) -> Iterator[list[Path]]:
    """Temporary files that take the place of `paths`, all or none, when the block ends well; several lie in one folder.

    Raises FastGSError where a path cannot be written.
    """
    if any("\0" in str(path) for path in paths):
        raise FastGSError("this is no name for a file, as it has a zero in it; choose another.")
    targets = [Path(os.path.realpath(path)) for path in paths]
    for target in targets:
        _check(target)
    folder = targets[-1].parent
    if any(target.parent != folder for target in targets):
        raise FastGSError("its files are links into different folders; choose another name.")
    if str(folder) not in _cleared:
        _cleared.add(str(folder))
        remove_leftovers(folder)
    with _aside(folder) as aside:
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
        _replace(temporaries, targets)


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


def remove_leftovers(folder: str | Path) -> None:
    """Remove what killed processes of this user left aside in a folder."""
    with suppress(OSError):
        for entry in os.scandir(folder):
            if entry.name.startswith(".fastgs-") and entry.name.endswith(".tmp"):
                _remove_dead(Path(entry.path))


def appending(path: str | os.PathLike, mode: str = "ab", **options: Any) -> IO[Any]:
    """A regular file, opened as open() does to append to it, made where there is none; raises FastGSError for anything else, OSError.

    A pipe would make its writer wait for ever.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
    return os.fdopen(regular_file(path, flags), mode, **options)


@contextmanager
def _aside(folder: Path) -> Iterator[Path]:
    """A new hidden folder, held by this process, and removed at the end."""
    aside, lock = _held(folder)
    try:
        yield aside
    finally:
        if lock is not None:
            lock.close()
        shutil.rmtree(aside, ignore_errors=True)


def _held(folder: Path) -> tuple[Path, BinaryIO | None]:
    """A new hidden folder, and its lock where there are locks.

    Another process may find the lock before it is held, and takes the folder for a dead one's: then it is another folder's turn.
    """
    while True:
        aside = folder / f".fastgs-{secrets.token_hex(6)}.tmp"
        aside.mkdir()
        try:
            lock = locks.acquire(aside / LOCK)
        except locks.NoLocks:
            return aside, None
        except FileNotFoundError:
            continue
        if lock is not None:
            return aside, lock


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
                lock = locks.acquire(path / LOCK) if (path / LOCK).exists() or old else None
            except locks.NoLocks:
                lock = open(os.devnull, "rb") if old else None  # noqa: SIM115 (closed below)
            if lock is not None:
                with lock:  # nobody else can take it meanwhile
                    shutil.rmtree(path, ignore_errors=True)
                    left = locks.is_at(lock, path / LOCK)  # Windows removes no open file
                if left:
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


def _replace(temporaries: list[Path], targets: list[Path]) -> None:
    """Rename files aside to their targets, all or none."""
    before = [part.with_name(f"{BEFORE}{i}") for i, part in enumerate(temporaries[:-1])]
    for copy, target in zip(before, targets, strict=False):
        if target.exists():
            shutil.copy2(target, copy)
    try:
        for part, target in zip(temporaries, targets, strict=True):
            os.replace(part, target)
    except BaseException:
        for part, copy, target in zip(temporaries, before, targets, strict=False):
            if part.exists() or not temporaries[-1].exists():  # it is as before, or all are renamed
                continue
            if copy.exists():
                os.replace(copy, target)
            else:
                target.unlink()
        raise
