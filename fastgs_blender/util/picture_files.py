# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and EXR pictures, written with NumPy and zlib alone, because Blender's Python has neither Pillow nor OpenEXR.

EXR as its specification has it (openexr.com, "OpenEXR File Layout"): scan lines, one part or several; written with ZIP compression
(blocks of 16 lines), read with ZIP, ZIPS or none.
"""
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .reading import read_bytes, reading
from .threads import ranges, run

MAGIC, MULTIPART, LONG_NAMES, TILED_OR_DEEP = 20000630, 0x1000, 0x400, 0xA00
TYPES: dict[int, np.dtype] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
LINES = {0: 1, 2: 1, 3: 16}
"""Lines of a block by the number of the compression: none, ZIPS, ZIP."""
ZIP = 3
LEVEL = 4
"""zlib's: higher ones take twice the time for a few percent."""
SLAB = 64
"""Rows of a PNG that are filtered and compressed as one piece."""
DENSEST = 1032
"""How many times its packed size data can have that zlib packed."""
LARGEST = 2 << 30
"""Bytes of an EXR that is read."""


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
    blocks = run(lambda start, stop: _zipped(lines[start:stop].tobytes()), ranges(height, LINES[ZIP]))
    sizes = np.array([8 + len(block) for block in blocks])
    offsets = len(header) + 8 * len(blocks) + np.cumsum(sizes) - sizes
    with open(path, "wb") as stream:
        stream.write(header + offsets.astype("<u8").tobytes())
        for i, block in enumerate(blocks):
            stream.write(struct.pack("<ii", i * LINES[ZIP], len(block)) + block)


def _zipped(data: bytes) -> bytes:
    """EXR's ZIP: bytes at even places before those at odd ones, differences of neighbours plus 128, deflated; as is if not smaller."""
    values = np.frombuffer(data, np.uint8)
    values = np.concatenate([values[::2], values[1::2]])
    values[1:] -= values[:-1] - np.uint8(128)
    packed = zlib.compress(values.data, LEVEL)
    return packed if len(packed) < len(data) else data


def _unzipped(data: bytes, size: int) -> bytes:
    """The inverse of _zipped(): `size` bytes; raises ValueError where there are others."""
    if len(data) == size:
        return data
    unpacker = zlib.decompressobj()
    values = np.frombuffer(unpacker.decompress(data, size + 1), np.uint8)
    if len(values) != size:
        raise ValueError("a block has another size than its lines")
    values = values.copy()
    values[1:] -= np.uint8(128)
    values = np.cumsum(values, dtype=np.uint8)
    out = np.empty(size, np.uint8)
    half = (size + 1) // 2
    out[::2], out[1::2] = values[:half], values[half:]
    return out.tobytes()


def read_exr(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, bytes]]:
    """(planes {"Part.Channel" or "Channel": [h, w]}, attributes of all parts) of an EXR without compression or with ZIP, top row first.

    Raises FastGSError for another kind of EXR, and for a damaged one.
    """
    with reading(path, "this is no EXR picture of scan lines without compression or with ZIP, or it is damaged, so render it again"):
        return _read_exr(read_bytes(path, LARGEST))


def _read_exr(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, bytes]]:
    magic, version = struct.unpack_from("<ii", data)
    if magic != MAGIC or version & TILED_OR_DEEP:
        raise ValueError("it has no scan lines")
    several = bool(version & MULTIPART)
    parts, at = [], 8
    while True:
        header, at = _header(data, at)
        if not header:
            break
        parts.append(header)
        if not several:
            break
    planes: dict[str, np.ndarray] = {}
    attributes: dict[str, bytes] = {}
    left = DENSEST * len(data)
    for header in parts:
        compression = header["compression"][0]
        if compression not in LINES:
            raise ValueError("it is compressed in another way")
        x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
        width, height = x1 - x0 + 1, y1 - y0 + 1
        channels = _channels(header["channels"])
        line = np.dtype([(name, dtype, (width,)) for name, dtype in channels])
        count = -(-height // LINES[compression])
        left -= height * line.itemsize * (1 if compression else DENSEST)
        if min(width, height, line.itemsize) <= 0 or left < 0 or 8 * count > len(data) - at:
            raise ValueError(f"it says {width} x {height} pixels, more than the file holds")
        offsets = struct.unpack_from(f"<{count}Q", data, at)
        at += 8 * count
        lines = _lines(data, offsets, compression, line, height, 4 if several else 0)
        prefix = header["name"].decode() + "." if several else ""
        for name, _ in channels:
            planes[name if name.startswith(prefix) else prefix + name] = np.ascontiguousarray(lines[name])
        attributes |= header
    return planes, attributes


def _lines(data: bytes, offsets: Sequence[int], compression: int, line: np.dtype, height: int, skip: int) -> np.ndarray:
    """The lines [h] of one part; skip: bytes of the part's number in front of each block."""
    pieces = []
    for i, offset in enumerate(offsets):
        if not 0 <= offset <= len(data) - 8 - skip:
            raise ValueError("a line lies beyond its end")
        size, = struct.unpack_from("<i", data, offset + skip + 4)
        begin = offset + skip + 8
        if not 0 <= size <= len(data) - begin:
            raise ValueError("it is cut short")
        rows = min(LINES[compression], height - i * LINES[compression])
        block = data[begin:begin + size]
        block = _unzipped(block, rows * line.itemsize) if compression else block
        pieces.append(np.frombuffer(block, line, rows))
    return np.concatenate(pieces)


def _header(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    found: dict[str, bytes] = {}
    while data[at]:
        end = data.index(b"\0", at)
        name = data[at:end].decode()
        at = data.index(b"\0", end + 1) + 1
        size, = struct.unpack_from("<i", data, at)
        if size < 0 or at + 4 + size > len(data):
            raise ValueError("it is cut short")
        found[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    return found, at + 1


def _channels(data: bytes) -> list[tuple[str, np.dtype]]:
    found: list[tuple[str, np.dtype]] = []
    at = 0
    while data[at]:
        end = data.index(b"\0", at)
        kind, = struct.unpack_from("<i", data, end + 1)
        found.append((data[at:end].decode(), TYPES[kind]))
        at = end + 17
    return found
