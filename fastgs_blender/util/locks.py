# SPDX-License-Identifier: GPL-3.0-or-later
"""A file that a running process holds: others can tell whether it lives, whatever became of its number, and after any end of it."""
from __future__ import annotations

import os
import time

PLACE = 1 << 30
"""The byte that is locked: beyond what a file says, so that it can still be read."""


def hold(path, patience: float = 0.0):
    """Hold the file until this process ends; returns the open file, None where another process holds it.

    patience  seconds to try: is_held() itself holds a file for a moment
    """
    until = time.monotonic() + patience
    file = open(path, "a+b")  # noqa: SIM115 (it stays open)
    while not _try(file, True):
        if time.monotonic() > until:
            file.close()
            return None
        time.sleep(0.02)
    return file


def is_held(path) -> bool:
    """Whether a process holds the file; False where there is none."""
    try:
        file = open(path, "r+b")  # noqa: SIM115
    except OSError:
        return False
    with file:
        if not _try(file, True):
            return True
        _try(file, False)
    return False


def _try(file, lock: bool) -> bool:
    """Lock or unlock an open file; False where another process has locked it."""
    try:
        if os.name == "nt":
            import msvcrt

            file.seek(PLACE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK if lock else msvcrt.LK_UNLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB if lock else fcntl.LOCK_UN)
    except OSError:
        return False
    return True
