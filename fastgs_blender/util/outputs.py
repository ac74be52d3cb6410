# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written beside their target and renamed: whatever goes wrong, what was there before is still there."""
from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import FastGSError


@contextmanager
def replacing(paths: list[Path], release: Callable[[Path], None] = lambda path: None) -> Iterator[list[Path]]:
    """Temporary files that take the place of `paths`, all or none, when the block ends well.

    release(path) is called where the system refuses to replace a file because it is open (Windows), before a second try.
    Raises FastGSError where a path cannot be written.
    """
    try:
        targets = [Path(os.path.realpath(path)) for path in paths]
    except ValueError as error:  # a zero in the name
        raise FastGSError(f"this is no name for a file ({error}); choose another.") from error
    for target in targets:
        _check(target)
    temporaries = [target.with_name(f".fastgs-{secrets.token_hex(6)}.tmp") for target in targets]
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
        _replace_all(temporaries, targets, release)
    finally:
        for temporary in temporaries:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def _check(target: Path) -> None:
    if target.is_dir():
        raise FastGSError("this is a folder; give the name of a file in it.")
    if target.exists() and not target.is_file():
        raise FastGSError("this is not an ordinary file; choose another name.")
    if not target.parent.is_dir():
        raise FastGSError("its folder does not exist; create it first or choose another.")


def _replace_all(sources: list[Path], targets: list[Path], release) -> None:
    undo: list[tuple[Path | None, Path]] = []
    try:
        for number, (source, target) in enumerate(zip(sources, targets, strict=True)):
            kept = None
            if number + 1 < len(targets) and target.exists():
                kept = target.with_name(f".fastgs-{secrets.token_hex(6)}.tmp")
                os.replace(target, kept)
            undo.append((kept, target))
            try:
                os.replace(source, target)
            except PermissionError:
                release(target)
                os.replace(source, target)
    except BaseException:
        for kept, target in undo:
            if kept is not None:
                os.replace(kept, target)
            elif target != targets[-1]:
                target.unlink(missing_ok=True)
        raise
    for kept, _ in undo:
        if kept is not None:
            kept.unlink(missing_ok=True)
