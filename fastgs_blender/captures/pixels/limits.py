# SPDX-License-Identifier: GPL-3.0-or-later
"""The limit of the size of pictures that are read."""
from pathlib import Path

from ...cameras.camera import LARGEST_SIDE
from ...util.errors import FastGSError

MOST_PIXELS = 1 << 27
"""Of a picture: 134 million."""


def check_size(path: Path, width: int, height: int, most: float = MOST_PIXELS) -> None:
    """Raises FastGSError for a picture that is larger than is read, or has more pixels than its file can hold (`most`)."""
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE and width * height <= MOST_PIXELS):
        raise FastGSError(f"{path}: a picture of {width} x {height} pixels is more than is read: {LARGEST_SIDE} pixels a side, and "
                          f"{MOST_PIXELS} in all.")
    if width * height > most:
        raise FastGSError(f"{path}: the file is too short for the {width} x {height} pixels that it claims; copy it again.")
