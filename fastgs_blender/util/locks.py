# SPDX-License-Identifier: GPL-3.0-or-later
"""Lock files that running processes hold: others can tell whether the holder lives, and the lock ends with its process, however it ends."""
import contextlib
import errno
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from .reading import regular_file

FLAGS = os.O_RDWR | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
"""How a lock file is opened: a link, which may have come in an archive, would make a file wherever it leads."""
PLACE = 1 << 30
"""The byte that is locked on Windows: beyond the file's content, so that it can still be read."""
LOCKED = {errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK}
"""What the system answers where another process holds the lock; anything else means that it cannot lock there (NoLocks)."""
INHERITED = "FASTGS_LOCK_HANDLE"
"""Environment variable with the handle of a lock that a process was given by the one that started it (POSIX)."""
TRIES, PAUSE = 5, 0.01
"""is_locked() on Windows: a look holds the file for a moment, so another look a moment later decides."""


class NoLocks(OSError):
    """The file system has no locks."""


def acquire(path: str | os.PathLike, patience: float = 0.0) -> BinaryIO | None:
    """Hold the file until it is closed or this process ends; returns the open file, None where another process holds it.

    patience  seconds to go on trying
    Raises OSError where the file cannot be opened or is a link, FastGSError for a pipe or a device, and NoLocks where its file system
    has no locks.
    """
    until = time.monotonic() + patience
    while True:
        file = open(path, "a+b", opener=lambda name, _: regular_file(name, FLAGS))  # noqa: SIM115 (it is what is returned)
        try:
            if _lock(file) and is_at(file, path):
                return file
        except BaseException:
            file.close()
            raise
        file.close()
        if time.monotonic() >= until:
            return None
        time.sleep(0.02)


def release(file: BinaryIO, remove: Path | None = None) -> None:
    """End a lock; `remove` is its path where the file goes too, unless another process has taken it meanwhile."""
    if remove and os.name != "nt":  # before another process can hold it: that one then finds that the file is no longer there
        remove.unlink()
    file.close()
    if remove and os.name == "nt":
        with contextlib.suppress(OSError):  # an open file cannot be removed there
            remove.unlink()


def inherited() -> BinaryIO | None:
    """The lock that the starting process has handed to this one (see handed_over()); None where there is none."""
    number = os.environ.pop(INHERITED, "")
    if not number:
        return None
    os.set_inheritable(int(number), False)
    return os.fdopen(int(number), "rb")


def handed_over(file: BinaryIO) -> tuple[dict, dict[str, str]]:
    """Options of subprocess.Popen, and environment variables, with which the new process holds the lock from its first moment on.

    The starting process closes its own file afterwards, and the lock lives as long as the new process.  On Windows both are empty, and
    the new process takes the lock itself.
    """
    return ({}, {}) if os.name == "nt" else ({"pass_fds": (file.fileno(),)}, {INHERITED: str(file.fileno())})


def is_locked(path: str | os.PathLike) -> bool:
    """Whether a process holds the file; False where there is no such file, or no locks in its file system."""
    try:
        file = open(path, "r+b")  # noqa: SIM115
    except OSError:
        return False
    with file:
        try:
            return not _free(file)
        except OSError:
            return False


def is_at(file: BinaryIO, path: str | os.PathLike) -> bool:
    """Whether an open file is the one at a path: the process that held it may have removed it."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.stat(path))
    except FileNotFoundError:
        return False


def _lock(file: BinaryIO) -> bool:
    """Lock an open file; False where another process has locked it."""
    if os.name == "nt":
        return _windows(file, True)
    import fcntl

    return _attempt(lambda: fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB))


def _free(file: BinaryIO) -> bool:
    """Whether nobody holds an open file.  Looks do not disturb each other: they share the lock, or try again."""
    if os.name == "nt":
        for attempt in range(TRIES):
            if attempt:
                time.sleep(PAUSE)
            if _windows(file, True):
                _windows(file, False)
                return True
        return False
    import fcntl

    return _attempt(lambda: fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB))


def _windows(file: BinaryIO, lock: bool) -> bool:
    import msvcrt as system

    msvcrt: Any = system  # type checkers elsewhere than on Windows know it empty
    file.seek(PLACE)
    return _attempt(lambda: msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK if lock else msvcrt.LK_UNLCK, 1))


def _attempt(call: Callable[[], object]) -> bool:
    try:
        call()
    except OSError as error:
        if error.errno in LOCKED:
            return False
        raise NoLocks(error.errno, error.strerror) from error
    return True
