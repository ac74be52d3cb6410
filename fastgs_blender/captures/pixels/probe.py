# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the size and depth of a picture or video, and whether it has alpha, from its header, and whether the file has its end."""
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from ...util.errors import FastGSError
from ...util.reading import open_file, reading
from ..sources import Source
from . import exr
from .pictures import check_end, opened
from .video import index


class Facts(NamedTuple):
    """width and height in pixels as shown; alpha: it has an alpha channel; deep: more than 8 bits a channel."""

    width: int
    height: int
    alpha: bool
    deep: bool


def facts(source: Source) -> Facts:
    """The facts of a source's file; raises FastGSError where it cannot be read, or is a PNG or JPEG that was cut short."""
    if source.frame is not None:
        found = index(source.path)
        return Facts(found.width, found.height, False, False)
    with reading(source.path):
        stat = source.path.stat()
    return _facts(source.path, stat.st_size, (stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino))


def picture_size(source: Source) -> tuple[int, int]:
    """Width and height of a source's file in pixels."""
    return facts(source)[:2]


@lru_cache(maxsize=65_536)
def _facts(path: Path, size: int, _version: tuple) -> Facts:
    if not size:
        open_file(path).close()  # a pipe has no size either
        raise FastGSError(f"{path}: the picture is empty; copy or export it again.")
    return _exr(path) if path.suffix.lower() == ".exr" else _pillow(path)


def _exr(path: Path) -> Facts:
    width, height, channels = exr.header(path)
    return Facts(width, height, "A" in channels, True)


def _pillow(path: Path) -> Facts:
    with opened(path) as picture:
        check_end(path, picture)
        alpha = "A" in picture.getbands() or "transparency" in picture.info
        return Facts(picture.width, picture.height, alpha, picture.mode.startswith(("I", "F")))
