# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenEXR pictures: red, green, blue and alpha of the first layer that has them, as large as the display window."""
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from ...util.errors import FastGSError
from ...util.reading import open_file, reading
from .limits import check_size

MOST_NUMBERS_A_BYTE = 1 << 15
"""A picture of one colour, compressed by DWAB, has some 20 000."""
MOST_NUMBERS = 1 << 30
"""Of all layers."""


def header(path: Path) -> tuple[int, int, dict[str, str]]:
    """Width and height of the display window, and which of R, G, B, A are which channels of the file; raises FastGSError."""
    with _opened(path, header_only=True) as file:
        most, claimed = path.stat().st_size * MOST_NUMBERS_A_BYTE, 0
        for part in file.parts:  # OpenEXR reads all of them
            if "deep" in str(part.header.get("type")).lower():
                raise FastGSError(f"{path}: this is a deep picture, with several values a pixel; export a flat one.")
            across, down = _size(path, part.header["dataWindow"])
            claimed += across * down * len(part.header["channels"])
        width, height = _size(path, file.header()["displayWindow"])
        if claimed > min(most, MOST_NUMBERS):
            raise FastGSError(f"{path}: its layers claim {claimed} numbers, which is more than is read, or than its file can hold.")
        check_size(path, width, height, most)
        return width, height, _choose(path, file.header()["channels"])


def read(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """rgb [H, W, 3] and alpha [H, W] or None, float32 as in the file: scene-linear and premultiplied; raises FastGSError."""
    width, height, chosen = header(path)
    with _opened(path) as file:
        left, top = (int(v) for v in np.asarray(file.header()["dataWindow"][0]) - np.asarray(file.header()["displayWindow"][0]))
        channels = file.channels()
        planes = {name: _placed(channels[channel].pixels, left, top, width, height, path) for name, channel in chosen.items()}
    rgb = np.stack([planes[name] for name in "RGB"], -1)
    np.nan_to_num(rgb, copy=False, nan=0.0, posinf=float(np.finfo(np.float32).max), neginf=0.0)
    return rgb, np.nan_to_num(np.clip(planes["A"], 0, 1)) if "A" in planes else None


def _size(path: Path, window: Any) -> tuple[int, int]:
    low, high = (np.asarray(v, np.int64) for v in window)
    width, height = (int(v) for v in high - low + 1)
    check_size(path, width, height)
    return width, height


def _choose(path: Path, channels: Iterable[Any]) -> dict[str, str]:
    """{"R": name in the file, ...}: plain names, else a layer called Combined, else the first layer with R, G and B; else one Y."""
    names = [channel.name for channel in channels]
    layers = ["", *sorted({name[:-1] for name in names if name.endswith(".R")}, key=lambda layer: (not layer.endswith("Combined."), layer))]
    for layer in layers:
        found = {letter: layer + letter for letter in "RGBA" if layer + letter in names}
        if {"R", "G", "B"} <= set(found):
            return found
    if "Y" in names:
        return dict.fromkeys("RGB", "Y") | ({"A": "A"} if "A" in names else {})
    raise FastGSError(f"{path}: the picture has no colours (R, G, B), only {', '.join(map(shortened, names[:6])) or 'nothing'}.")


def _placed(plane: np.ndarray, left: int, top: int, width: int, height: int, path: Path) -> np.ndarray:
    """The data window's plane within the display window, 0 around it."""
    plane = np.asarray(plane)
    if plane.ndim != 2:
        raise FastGSError(f"{path}: its channels have different sizes; export it without subsampling.")
    if (left, top, *plane.shape) == (0, 0, height, width):
        return plane.astype(np.float32)
    out = np.zeros((height, width), np.float32)
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + plane.shape[1], width), min(top + plane.shape[0], height)
    if x0 < x1 and y0 < y1:
        out[y0:y1, x0:x1] = plane[y0 - top:y1 - top, x0 - left:x1 - left]
    return out


@contextmanager
def _opened(path: Path, **settings: Any) -> Iterator:
    """An OpenEXR.File; raises FastGSError for whatever OpenEXR raises while it is open."""
    import OpenEXR

    open_file(path).close()  # OpenEXR opens it by name: a pipe must not get that far
    with reading(path, "copy or export the picture again"), OpenEXR.File(str(path), separate_channels=True, **settings) as file:
        yield file
