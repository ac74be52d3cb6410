# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and uncompressed EXR with NumPy alone, for Blender's Python, which has no Pillow and no OpenEXR.

EXR as its specification has it (openexr.com, "OpenEXR File Layout"): scan lines, no compression, one part or several.
"""
from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from .errors import FastGSError

MAGIC, MULTIPART, TILED_OR_DEEP = 20000630, 0x1000, 0xA00
TYPES = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}


def write_png(path, pixels: np.ndarray) -> None:
    """pixels [h, w] or [h, w, 3 or 4] uint8 as a PNG."""
    pixels = np.ascontiguousarray(pixels, np.uint8)
    height, width = pixels.shape[:2]
    colour = {1: 0, 3: 2, 4: 6}[1 if pixels.ndim == 2 else pixels.shape[2]]
    rows = np.zeros((height, 1 + pixels[0].size), np.uint8)  # each row begins with the number of its filter, 0
    rows[:, 1:] = pixels.reshape(height, -1)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 4)) + chunk(b"IEND", b"")
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def write_exr(path, planes: dict[str, np.ndarray]) -> None:
    """planes {channel's name: [h, w]} as an EXR of 32-bit floats."""
    names = sorted(planes)
    height, width = planes[names[0]].shape

    def attribute(name, kind, data):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = struct.pack("<ii", MAGIC, 2) + b"".join((
        attribute("channels", "chlist", channels), attribute("compression", "compression", b"\0"),
        attribute("dataWindow", "box2i", window), attribute("displayWindow", "box2i", window),
        attribute("lineOrder", "lineOrder", b"\0"), attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1)), b"\0"))
    line = 4 * width * len(names)
    lines = np.zeros(height, [("y", "<i4"), ("size", "<i4"), ("data", "<f4", (len(names), width))])
    lines["y"], lines["size"] = np.arange(height), line
    lines["data"] = np.stack([planes[name] for name in names], 1)
    offsets = len(header) + 8 * height + (8 + line) * np.arange(height, dtype="<u8")
    Path(path).write_bytes(header + offsets.tobytes() + lines.tobytes())


def read_exr(path) -> tuple[dict[str, np.ndarray], dict[str, bytes]]:
    """(planes {"Part.Channel" or "Channel": [h, w]}, attributes of all parts) of an uncompressed EXR, the top row first.

    Raises FastGSError for another kind of EXR, and for a file that is cut short.
    """
    try:
        return _read_exr(Path(path).read_bytes())
    except (ValueError, KeyError, IndexError, struct.error, TypeError) as error:
        raise FastGSError(f"{path}: this is no uncompressed EXR picture, or it is damaged ({error}); render it again.") from error
    except OSError as error:
        raise FastGSError(f"{path}: it cannot be read ({error.strerror}).") from error


def _read_exr(data):
    magic, version = struct.unpack_from("<ii", data)
    if magic != MAGIC or version & TILED_OR_DEEP:
        raise ValueError("not scan lines")
    several = bool(version & MULTIPART)
    parts, at = [], 8
    while True:
        header, at = _header(data, at)
        if not header:
            break
        parts.append(header)
        if not several:
            break
    planes, attributes = {}, {}
    for header in parts:
        if header["compression"] != b"\0":
            raise ValueError("compressed")
        x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
        width, height = x1 - x0 + 1, y1 - y0 + 1
        channels = _channels(header["channels"])
        line = np.dtype([(name, dtype, (width,)) for name, dtype in channels])
        offsets = np.frombuffer(data, "<u8", height, at)
        at += 8 * height
        skip = 12 if several else 8  # the number of the part, of the line, and its size
        lines = np.concatenate([np.frombuffer(data, line, 1, int(offset) + skip) for offset in offsets])
        prefix = header["name"].decode() + "." if several else ""
        for name, _ in channels:
            planes[name if name.startswith(prefix) else prefix + name] = np.ascontiguousarray(lines[name])
        attributes |= header
    return planes, attributes


def _header(data, at):
    found = {}
    while data[at]:
        end = data.index(b"\0", at)
        name = data[at:end].decode()
        at = data.index(b"\0", end + 1) + 1
        size, = struct.unpack_from("<i", data, at)
        if size < 0 or at + 4 + size > len(data):
            raise ValueError("cut short")
        found[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    return found, at + 1


def _channels(data):
    found, at = [], 0
    while data[at]:
        end = data.index(b"\0", at)
        kind, = struct.unpack_from("<i", data, end + 1)
        found.append((data[at:end].decode(), TYPES[kind]))
        at = end + 17
    return found
