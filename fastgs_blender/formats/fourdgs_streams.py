# SPDX-License-Identifier: GPL-3.0-or-later
"""The wire of `.4dgs`: a cursor over bytes, records, and the streams of integers in which attributes are stored."""
from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import packing

MAGIC = b"\x894DGS1\r\n"
POSITION, SCALE, OMITTED, ROTATION, COLOUR, OPACITY, MOTION, MU, SIGMA, FLAGS, WINDOW = range(11)
IDENTITY, OBJECT = 13, 14
CHANNELS = {POSITION: 3, SCALE: 3, OMITTED: 1, ROTATION: 3, COLOUR: 3, OPACITY: 1, MOTION: 3, MU: 1, SIGMA: 1, FLAGS: 1, WINDOW: 1,
            IDENTITY: 1, OBJECT: 1}
"""Attributes that are read, and how many numbers each has."""
NAMES = ("position", "scale", "rotation index", "rotation", "colour", "opacity", "motion", "mu_t", "sigma_t", "flags", "window index")
REQUIRED = tuple(range(11))
RAW, DELTA, CONSTANT = range(3)


class Cursor:
    """A place in bytes; every read is checked against their end."""

    def __init__(self, data: memoryview) -> None:
        self.data, self.at = data, 0

    def __bool__(self) -> bool:
        return self.at < len(self.data)

    def take(self, count: int) -> memoryview:
        """The next `count` bytes; raises EOFError where there are not so many."""
        if count > len(self.data) - self.at:
            raise EOFError
        self.at += count
        return self.data[self.at - count:self.at]

    def unpack(self, code: str) -> tuple:
        """Numbers of a struct code, little-endian without padding."""
        return struct.unpack("<" + code, self.take(struct.calcsize("<" + code)))

    def number(self, code: str) -> Any:
        """One number."""
        return self.unpack(code)[0]

    def text(self) -> str:
        """A text with its length in front."""
        return str(self.take(self.number("I")), "utf-8")

    def block(self) -> Cursor:
        """Bytes with their length in front, as a cursor of their own."""
        return Cursor(self.take(self.number("Q")))


def records(data: memoryview) -> Iterator[tuple[int, int, Cursor]]:
    """Opcode, place and content of all records between both magics; raises FastGSError."""
    if data[:8] != MAGIC or data[-8:] != MAGIC or len(data) < 16:
        raise FastGSError("the file is cut short: it does not end with the mark that every whole .4dgs file ends with; copy it again.")
    cursor = Cursor(data[:-8])
    cursor.take(8)
    while cursor:
        place = cursor.at
        opcode = cursor.number("B")
        yield opcode, place, cursor.block()


def check_room(count: int, room: int) -> None:
    """Raises FastGSError where a chunk claims more Gaussians than there can be."""
    damaged_if(count > room, f"a chunk in it claims {count} Gaussians, which the file is too small to hold")


def unpacked(block: Cursor, codec: str, size: int) -> Cursor:
    """The streams of a chunk, which may be compressed as a whole."""
    if codec in ("", "none"):
        return Cursor(block.data)
    if codec not in CODECS:
        raise FastGSError(f"its chunks are compressed with {codec[:20]!r}, which is not known; export it with deflate or zstd.")
    return Cursor(memoryview(CODECS[codec](block.data, size)))


def streams(cursor: Cursor, count: int, what: str) -> dict[int, np.ndarray]:
    """The attributes [count, channels] int64 of a run of streams; those that are not known are ignored."""
    found, seen = {}, set()
    while cursor:
        attribute, values = stream(cursor, count)
        damaged_if(attribute in seen, f"{what} has attribute {attribute} twice")
        seen.add(attribute)
        if values is not None:
            if values.shape[1] != CHANNELS[attribute]:
                raise FastGSError(f"attribute {attribute} of {what} has {values.shape[1]} channels instead of {CHANNELS[attribute]}.")
            found[attribute] = values
    return found


def stream(cursor: Cursor, count: int, band: bool = False) -> tuple[int, np.ndarray | None]:
    """An attribute and its integers [count, channels] int64; None for one that is not known.  band: spherical harmonics."""
    attribute, width, mode, codec, channels, elements, size = cursor.unpack("5BIQ")
    payload = cursor.take(size)
    if attribute not in CHANNELS and not band:
        return attribute, None
    if codec >= len(CODECS):
        raise FastGSError(f"a stream in it has the unknown codec {codec}; export it with deflate or zstd.")
    if width not in (1, 2, 4) or mode not in (RAW, DELTA, CONSTANT) or not channels:
        raise FastGSError(f"the stream of attribute {attribute} has {width} bytes a number and mode {mode}; the file is damaged.")
    if elements != count:
        raise FastGSError(f"the stream of attribute {attribute} has {elements} elements, and there are {count} Gaussians.")
    if not count:
        return attribute, np.zeros((0, channels), np.int64)
    symbols = channels if mode == CONSTANT else count * channels
    unpack = list(CODECS.values())[codec]
    values = packing.signed(packing.joined(unpack(payload, symbols * width), width)).reshape(-1, channels)
    if mode == CONSTANT:
        values = np.repeat(values, count, 0)
    return attribute, np.cumsum(values, 0) if mode == DELTA else values


def identities(values: np.ndarray) -> np.ndarray:
    """Unsigned 32-bit names [N] of signed numbers with the same bits."""
    damaged_if(values.size and (values.min() < -(2**31) or values.max() >= 2**31), "an identity in it does not fit 32 bits")
    return values.reshape(-1) % 2**32


CODECS = {"deflate": packing.inflated, "zstd": lambda data, size: packing.unzstd(data, size, "a stream in it")}
"""(data, size) -> its bytes; the order is that of their numbers."""
