# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a run, taken by the process that trains in it.  A run that cannot begin leaves nothing behind."""
import contextlib
import os
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ...util import locks
from ...util.errors import FastGSError
from .files import LOCK, RUN, STATUS

PATIENCE = 5.0
"""Seconds to wait for another process that trains in the folder: it may be about to end."""


class _Taken(NamedTuple):
    """A folder that this process holds.

    lock  None where the file system has no locks
    made  the folders that did not exist before, inner ones first; owns: whether the lock's file did not either
    """

    lock: BinaryIO | None
    made: list[Path]
    owns: bool


_taken: dict[str, _Taken] = {}
"""By folder."""


def take(out: str | Path) -> None:
    """Hold a run's folder, which is made where there is none, until release() or the end of this process.

    Raises FastGSError where it cannot be made or written, or another process trains in it.
    """
    out = Path(out)
    made: list[Path] = []
    try:
        made += [path for path in (out, *out.parents) if not path.exists()]
        out.mkdir(parents=True, exist_ok=True)
        if os.path.realpath(out) not in _taken:
            owns = not (out / LOCK).exists()
            _taken[os.path.realpath(out)] = _Taken(_lock(out), made, owns)
    except FastGSError:
        _remove(made)
        raise
    except (OSError, ValueError) as error:
        _remove(made)
        raise FastGSError(f"{out}: the folder for the model cannot be made ({getattr(error, 'strerror', None) or error}).") from error


def release(out: str | Path) -> None:
    """Let other processes train in the folder again; what take() made is removed if no run has begun there."""
    out = Path(out)
    taken = _taken.pop(os.path.realpath(out), None)
    if taken is None:
        return
    begun = any((out / name).exists() for name in (RUN, STATUS))
    if taken.lock is not None:
        locks.release(taken.lock, out / LOCK if taken.owns and not begun else None)
    if not begun:
        _remove(taken.made)


def _remove(made: list[Path]) -> None:
    """Remove those of the folders that hold nothing."""
    for path in made:
        with contextlib.suppress(OSError, ValueError):
            path.rmdir()


def _lock(out: Path) -> BinaryIO | None:
    """The lock of a run's folder; None where the file system has no locks.  Raises FastGSError where another process has it."""
    try:
        lock = locks.acquire(out / LOCK, PATIENCE)
    except locks.NoLocks:
        return None
    except OSError as error:
        raise FastGSError(f"{out}: nothing can be written there ({error.strerror}); choose another folder.") from error
    if lock is None:
        raise FastGSError(f"{out}: another process is training in this folder; wait until it has ended, stop it, or train into another "
                          "folder.")
    return lock
