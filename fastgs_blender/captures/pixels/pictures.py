# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture files as display-referred colours with straight alpha: PNG and JPEG through pillow, EXR through OpenEXR."""
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...rendering import colour
from ...util.errors import FastGSError
from ...util.reading import open_file, reading
from ..sources import Source
from . import exr
from .limits import check_size

BRIGHTEST = np.float32(65504)
"""Linear values beyond it are cut: they are white with any gain, and larger ones would overflow on their way there."""
ENDS = {"PNG": b"IEND\xaeB`\x82", "JPEG": b"\xff\xd9"}
"""What stands at the end of a whole file: PNG's last chunk with its checksum, JPEG's EOI."""
LAST = 4096
"""Bytes at the end of a file in which it is looked for: some cameras and programs append their own."""
MOST_PIXELS_A_BYTE = 8 * 1032
"""Deflate, which compresses PNG best, makes at most 1032 bytes of one, and a byte holds at most 8 pixels."""


def read(source: Source) -> tuple[np.ndarray, np.ndarray | None]:
    """rgb [H, W, 3] and alpha [H, W] or None of a picture file, both uint8 (0..255), or float32 (0..1) where the file has more.

    Display sRGB, straight alpha; brighter than white is white.  Raises FastGSError.
    """
    is_exr = source.path.suffix.lower() == ".exr"
    rgb, alpha = _exr(source.path) if is_exr else _pillow(source.path)
    return graded(rgb, source, linear=is_exr), alpha


def graded(rgb: np.ndarray, source: Source, linear: bool = False) -> np.ndarray:
    """A source's colours [H, W, 3] as display sRGB with its gain; linear: what "auto" means."""
    is_linear = linear if source.colour == "auto" else source.colour == "linear"
    if not is_linear and source.gain == 1:
        return np.clip(rgb, 0, 1) if rgb.dtype == np.float32 else rgb
    values = rgb.astype(np.float32) / 255 if rgb.dtype == np.uint8 else rgb
    values = colour.linear_to_srgb(values) if is_linear else values
    values = np.clip(values * np.float32(source.gain), 0, 1)
    return values if rgb.dtype != np.uint8 else np.floor(values * 255 + 0.5).astype(np.uint8)


def read_grey(source: Source) -> np.ndarray:
    """A mask [H, W] as read() gives colours: its red times the source's gain, times its alpha where it has any."""
    rgb, alpha = _exr(source.path) if source.path.suffix.lower() == ".exr" else _pillow(source.path)
    most = 1 if rgb.dtype == np.float32 else 255
    grey = np.clip(rgb[..., 0] * np.float32(source.gain), 0, most).astype(rgb.dtype)
    if alpha is None:
        return grey
    return grey * alpha if grey.dtype == np.float32 else (grey.astype(np.uint16) * alpha // 255).astype(np.uint8)


def _exr(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    rgb, alpha = exr.read(path)
    with np.errstate(over="ignore"):  # colours of what is nearly transparent
        rgb = rgb if alpha is None else colour.straight(rgb, alpha)
    return np.clip(rgb, -BRIGHTEST, BRIGHTEST), alpha


def _pillow(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    with opened(path) as picture:
        if picture.mode.startswith(("I", "F")):  # 16 bits of grey
            plane = np.asarray(picture, np.float32) / (65535 if picture.mode.startswith("I") else 1)
            return np.repeat(plane[..., None], 3, 2), None
        alpha = "A" in picture.getbands() or "transparency" in picture.info
        picture.load()
        if not alpha:  # one that stands behind the pixels, where probe does not look
            picture.info.pop("transparency", None)
        pixels = np.asarray(picture.convert("RGBA" if alpha else "RGB"))
    return pixels[..., :3], pixels[..., 3] if alpha else None


class _Bounded(io.BufferedReader):
    """A file whose read() makes room for no more bytes than it still has: pillow believes the lengths that a PNG states."""

    def __init__(self, raw: io.RawIOBase) -> None:
        super().__init__(raw)
        self.size = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1) -> bytes:
        left = max(self.size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def opened(path: Path) -> Iterator:
    """A pillow Image of a PNG or JPEG file; raises FastGSError for whatever pillow raises while it is open."""
    from PIL import JpegImagePlugin, PngImagePlugin  # Image.open() would try every format, and has a limit and a warning of its own

    with reading(path, "copy or export the picture again"), _Bounded(open_file(path).detach()) as file:
        head = file.peek(3)
        if head.startswith(b"\x89PNG"):
            picture = PngImagePlugin.PngImageFile(file)
        elif head.startswith(b"\xff\xd8\xff"):
            picture = JpegImagePlugin.jpeg_factory(file)
        else:
            raise FastGSError(f"{path}: the picture cannot be read (it is no PNG or JPEG); copy or export it again.")
        with picture:
            check_size(path, picture.width, picture.height, file.size * MOST_PIXELS_A_BYTE)
            yield picture


def check_end(path: Path, picture: Any) -> None:
    """Raise FastGSError where an opened() picture's file was cut short, without decoding it."""
    file = picture.fp
    file.seek(max(file.size - LAST, 0))
    if ENDS[picture.format] not in file.read():
        raise FastGSError(f"{path}: the picture was cut short, for its end is missing; copy or export it again.")
