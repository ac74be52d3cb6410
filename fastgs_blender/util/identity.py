# SPDX-License-Identifier: GPL-3.0-or-later
"""Tells whether a file is still the one that was read."""
import os

from .errors import FastGSError


def status_of(path: str) -> tuple[int, int, int, int, int]:
    """Modification and change time in ns, size, inode and device of a file.  Raises FastGSError where there is none."""
    try:
        s = os.stat(path)
    except (OSError, ValueError):  # ValueError: a zero in the name
        raise FastGSError(f"{path}: there is no such file; choose it again or put it back.") from None
    return s.st_mtime_ns, s.st_ctime_ns, s.st_size, s.st_ino, s.st_dev
