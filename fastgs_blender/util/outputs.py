# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes files atomically: into a temporary file beside the target, then renamed, so that an error leaves the old file as it was.

Several files that belong together (a PLY and its decoder) are replaced together, even if the process is killed between two renames.
A journal beside them, written before the first rename, names every rename; whoever reads or writes the files next completes it.
"""
from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import FastGSError
from .reading import read_json

ASIDE = re.compile(r"\.fastgs-[0-9a-f]{12}\.tmp")
LARGEST_JOURNAL = 1 << 16


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
        complete(target)
    if len({target.parent for target in targets}) > 1:
        raise FastGSError("its files are links into different folders; choose another name.")
    temporaries = [_aside(target) for target in targets]
    try:
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
            _replace_together(temporaries, targets)
    finally:
        if not _journal(targets[-1]).exists():  # else the rest is done from them
            for temporary in temporaries:
                with suppress(OSError):
                    temporary.unlink(missing_ok=True)


def complete(path: Path) -> None:
    """Finish the replacement of `path` and its companions that a killed process began; raises FastGSError where that fails.

    A file that was changed by hand meanwhile stays as it is.
    """
    journal = _journal(Path(os.path.realpath(path)))
    if not os.path.lexists(journal):
        return
    try:
        _follow(journal)
    except OSError as error:
        raise FastGSError(f"{path}: saving it was stopped halfway, and the rest cannot be done ({error.strerror or error}); make its "
                          "folder writable and try again.") from error


def _check(target: Path) -> None:
    if target.is_dir():
        raise FastGSError("this is a folder; give the name of a file in it.")
    if target.exists() and not target.is_file():
        raise FastGSError("this is not an ordinary file; choose another name.")
    if not target.parent.is_dir():
        raise FastGSError("its folder does not exist; create it first or choose another.")


def _aside(target: Path) -> Path:
    return target.with_name(f".fastgs-{secrets.token_hex(6)}.tmp")


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


def _replace_together(sources: list[Path], targets: list[Path]) -> None:
    """Rename each source to its target, all or none; a process that is killed leaves a journal from which the rest is done."""
    journal, kept = _journal(targets[-1]), [_aside(target) if target.exists() else None for target in targets[:-1]]
    before = [_state(target) for target in targets]
    try:
        for copy, target in zip(kept, targets, strict=False):
            if copy is not None:
                shutil.copy2(target, copy)
        _write_journal(journal, [[s.name, t.name, state] for s, t, state in zip(sources, targets, before, strict=True)],
                       [*kept, *sources])
        try:
            _follow(journal)
        except BaseException:
            if not sources[-1].exists():
                raise  # all are renamed
            undo = [[copy and copy.name, target.name, _state(target)] for copy, target, source in zip(kept, targets, sources, strict=False)
                    if not source.exists()]
            _write_journal(journal, undo, [*kept, *sources])
            _follow(journal)
            raise
    finally:
        if not journal.exists():
            for copy in kept:
                if copy is not None:
                    copy.unlink(missing_ok=True)


def _write_journal(journal: Path, steps: list, leftovers: list[Path | None]) -> None:
    """steps: [name aside or None, name, state of that file before the step]; leftovers: removed at the end."""
    part = _aside(journal)
    try:
        with open(part, "w", encoding="utf-8") as stream:
            json.dump({"steps": steps, "leftovers": [path.name for path in leftovers if path is not None]}, stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, journal)
    finally:
        part.unlink(missing_ok=True)


def _follow(journal: Path) -> None:
    """Do the steps of a journal that are still to be done, and remove it; another process may do the same at the same time."""
    steps, leftovers = _read_journal(journal)
    folder = journal.parent
    for source, target, state in steps:
        if source is None:
            if _state(folder / target) == state:
                (folder / target).unlink(missing_ok=True)
        elif (folder / source).exists() and _state(folder / target) == state:
            with suppress(FileNotFoundError):  # the other process was quicker
                os.replace(folder / source, folder / target)
    journal.unlink(missing_ok=True)
    for name in leftovers:
        with suppress(OSError):
            (folder / name).unlink(missing_ok=True)


def _read_journal(journal: Path) -> tuple[list, list]:
    """The steps and leftovers of a journal; none where it is damaged: it is from outside, and names may not leave the folder."""
    try:
        found = read_json(journal, LARGEST_JOURNAL)
        steps, leftovers = found["steps"], found["leftovers"]
        names = [*(source for source, _, _ in steps if source is not None), *leftovers]
        targets = [target for _, target, _ in steps]
        good = (all(isinstance(name, str) and ASIDE.fullmatch(name) for name in names)
                and all(isinstance(name, str) and name == os.path.basename(name) and name not in ("", ".", "..") for name in targets))
    except (FastGSError, KeyError, TypeError, ValueError):
        return [], []
    return (steps, leftovers) if good else ([], [])
