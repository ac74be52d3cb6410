# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and EXR pictures, written with NumPy and zlib alone: the same bytes in every Python, without Pillow and OpenEXR.

EXR as its specification has it (openexr.com, "OpenEXR File Layout"): scan lines with ZIP compression, in blocks of 16.  OpenEXR reads them.
"""
from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .reading import open_file, reading
from .threads import ranges, run

MAGIC, LONG_NAMES, ZIP = 20000630, 0x400, 3
BLOCK = 16
"""Lines that are compressed together."""
LEVEL = 4
"""zlib's: higher ones take twice the time for a few percent."""
SLAB = 64
"""Rows of a PNG that are filtered and compressed as one piece."""


def write_png(path: str | os.PathLike, pixels: np.ndarray) -> None:
    """Write pixels [h, w] or [h, w, 3 or 4] uint8 as a PNG; raises OSError."""
    Path(path).write_bytes(png(pixels))


def png(pixels: np.ndarray) -> bytes:
    """The bytes of that file."""
    pixels = np.ascontiguousarray(pixels, np.uint8)
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    rows = pixels.reshape(height, width * channels)
    pieces = run(lambda start, stop: _deflated(rows, start, stop, channels, stop == height), ranges(height, SLAB))
    checksum = zlib.adler32(b"")
    for _, values in pieces:
        checksum = zlib.adler32(values, checksum)
    stream = b"".join((b"\x78\x5e", *(data for data, _ in pieces), struct.pack(">I", checksum)))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", stream) + chunk(b"IEND", b"")


def _deflated(rows: np.ndarray, start: int, stop: int, channels: int, last: bool) -> tuple[bytes, np.ndarray]:
    """A piece of a deflate stream that stands for rows [stop - start, n] of `rows`, and the filtered bytes that it stands for.

    Each row begins with the number of its filter: 1 (less the pixel before) or 2 (less the pixel above), by the smaller sum of
    absolute differences, as libpng chooses.
    """
    part = rows[start:stop]
    above = np.concatenate([rows[start - 1:start] if start else np.zeros_like(rows[:1]), part[:-1]])
    before = np.zeros_like(part)
    before[:, channels:] = part[:, :-channels]
    choices = [part - before, part - above]
    sums = [np.abs(values.view(np.int8).astype(np.int16)).sum(1, dtype=np.int64) for values in choices]
    out = np.empty((len(part), 1 + part.shape[1]), np.uint8)
    out[:, 0] = np.where(sums[0] <= sums[1], 1, 2)
    out[:, 1:] = np.where((out[:, :1] == 1), *choices)
    packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -15)
    return packer.compress(out.data) + packer.flush(zlib.Z_FINISH if last else zlib.Z_FULL_FLUSH), out


def write_exr(path: str | os.PathLike, planes: Mapping[str, np.ndarray], texts: Mapping[str, str] | None = None) -> None:
    """Write planes {channel's name: [h, w]} as an EXR of 32-bit floats; texts become attributes.  Raises OSError."""
    names = sorted(planes)
    height, width = planes[names[0]].shape

    def attribute(name: str, kind: str, data: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    long_names = any(len(name.encode()) > 31 for name in (*names, *(texts or {})))
    header = struct.pack("<ii", MAGIC, 2 | LONG_NAMES * long_names) + b"".join((
        attribute("channels", "chlist", channels), attribute("compression", "compression", bytes([ZIP])),
        attribute("dataWindow", "box2i", window), attribute("displayWindow", "box2i", window),
        attribute("lineOrder", "lineOrder", b"\0"), attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
        *(attribute(name, "string", text.encode()) for name, text in (texts or {}).items()), b"\0"))
    lines = np.empty((height, len(names), width), "<f4")
    for i, name in enumerate(names):
        lines[:, i] = planes[name]
    blocks = run(lambda start, stop: _zipped(lines[start:stop].tobytes()), ranges(height, BLOCK))
    sizes = np.array([8 + len(block) for block in blocks])
    offsets = len(header) + 8 * len(blocks) + np.cumsum(sizes) - sizes
    with open(path, "wb") as stream:
        stream.write(header + offsets.astype("<u8").tobytes())
        for i, block in enumerate(blocks):
            stream.write(struct.pack("<ii", i * BLOCK, len(block)) + block)


def _zipped(data: bytes) -> bytes:
    """EXR's ZIP: bytes at even places before those at odd ones, differences of neighbours plus 128, deflated; as is if not smaller."""
    values = np.frombuffer(data, np.uint8)
    values = np.concatenate([values[::2], values[1::2]])
    values[1:] -= values[:-1] - np.uint8(128)
    packed = zlib.compress(values.data, LEVEL)
    return packed if len(packed) < len(data) else data


def read_exr(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """(planes {"Part.Channel" or "Channel": [h, w]}, attributes of all parts) of an EXR, top row first.  Raises FastGSError."""
    import OpenEXR

    open_file(path).close()  # OpenEXR opens it by name: a pipe must not get that far
    with reading(path, "this is no EXR picture, or it is damaged, so render it again"), OpenEXR.File(str(path), True) as file:
        planes: dict[str, np.ndarray] = {}
        attributes: dict[str, Any] = {}
        for part in file.parts:
            prefix = f"{part.name()}." if len(file.parts) > 1 else ""
            planes |= {prefix + name.removeprefix(prefix): np.ascontiguousarray(channel.pixels) for name, channel in part.channels.items()}
            attributes |= part.header
        if not planes:  # OpenEXR leaves out parts that it cannot read
            raise ValueError("it is cut short")
    return planes, attributes
