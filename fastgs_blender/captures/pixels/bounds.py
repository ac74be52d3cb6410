# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the cache of decoded frames small: at most $FASTGS_CACHE_GB for all captures together.

Where a capture needs room, what was not used for longest is removed: other frames of its own, such as those of the segment of a long
clip that was trained before, and caches of other captures, but none that was opened within a day: its training may still run.  Shots for
which there is no room are decoded whenever they are needed.
"""
import contextlib
import os
import shutil
import stat
import time
from pathlib import Path

from ...util.errors import FastGSError

DEFAULT = 20.0
"""GB (1e9 bytes)."""
IN_USE = 86400
"""Seconds after its opening in which a capture's cache is not removed."""
UNUSED = 30 * 86400
"""Seconds after which another capture's cache that nobody opened is removed anyway."""


def most_bytes() -> float:
    """Bytes that all caches may have together: $FASTGS_CACHE_GB in GB, else DEFAULT.  Raises FastGSError."""
    text = os.environ.get("FASTGS_CACHE_GB", "")
    try:
        size = float(text) if text.strip() else DEFAULT
        good = size >= 0
    except ValueError:
        good = False
    if not good:
        raise FastGSError(f"FASTGS_CACHE_GB is the size of the cache in GB, such as {DEFAULT:g}, not {text!r}.")
    return size * 1e9


def remove_unused(own: Path) -> None:
    """Remove the other captures' caches that have not been opened for 30 days."""
    for opened, other in _others(own):
        if time.time() - opened > UNUSED:
            shutil.rmtree(other, ignore_errors=True)


def room(own: Path, need: int, names: set[str], spare: set[str], reserve: int = 0) -> float:
    """Bytes that a capture's cache may still take, after what is not used has been removed where it needs more.

    reserve      bytes that stay free on the disk
    names, spare  files of its own that are wanted now, and those that are not; others are of other scales, or of changed pictures
    """
    old = [(opened, size, path) for opened, size, path in _files(own) if path.name not in names]
    old += [(opened, size_of(other), other) for opened, other in _others(own)]
    left = most_bytes() - size_of(own) - sum(size for _, size, path in old if path.parent != own)
    lacking = need + reserve - shutil.disk_usage(own).free
    for opened, size, path in sorted(old):
        if (need > left or lacking > 0) and (path.name in spare or time.time() - opened > IN_USE):
            _remove(path)
            left, lacking = left + size, lacking - size
    return left


def size_of(folder: Path) -> int:
    """Bytes of the files in a folder; 0 where there is none."""
    return sum(size for _, size, _ in _files(folder))


def _files(folder: Path) -> list[tuple[float, int, Path]]:
    """When each file of a folder was written, its bytes, and its path."""
    return [(status.st_mtime, status.st_size, path) for status, path in _entries(folder) if not stat.S_ISDIR(status.st_mode)]


def _others(own: Path) -> list[tuple[float, Path]]:
    """The other captures' caches, with the times at which they were last opened."""
    return [(status.st_mtime, path) for status, path in _entries(own.parent) if stat.S_ISDIR(status.st_mode) and path != own]


def _entries(folder: Path) -> list[tuple[os.stat_result, Path]]:
    found = []
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):  # another process may remove it at this moment
                found.append((entry.stat(), Path(entry.path)))
    return found


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):  # Windows: another process reads it
            path.unlink(missing_ok=True)
