# SPDX-License-Identifier: GPL-3.0-or-later
"""Packs columns of integers with zlib, which every browser can unpack too, and unpacks them.

The column's centre is subtracted from each number, and the difference is zigzag coded (0, -1, 1, -2, ...) to z >= 0.  z becomes a symbol of
one byte: below DIRECT the symbol is z itself; above, with 2^e the leading bit of z, it is 128 + 4 (e - 7) + the two bits after the leading
one, and the other e - 2 bits are stored uncoded.  The Gaussians may first be sorted by their values in a column that the reader has already
(the context): Gaussians with different statistics then lie in different groups, and each has a code of its own.  The packed column holds,
one after another,

    map      a bit for each number: whether its symbol is not 0; omitted where the file would be larger with it
    symbols  a byte for each number; with a map only for those whose symbol is not 0
    rest     for each e from 7 on, the uncoded bits: first the lowest bit of all numbers with that e, then the next bit
"""
from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util.errors import FastGSError

DIRECT = 128
FIRST, LAST = 7, 31
"""Powers of two of the numbers beyond DIRECT."""
MOST = 1 << 29
"""Numbers lie within +- MOST of 0."""
MAPPED = 0.3
"""Share of zeros from which on a map is tried: a code spends a bit at least on every byte."""
TABLE = 500
"""Bits that the code of another group takes."""
MOST_VALUES = 64
"""Different numbers that a context may have."""
BEFORE, TOGETHER = "before", "together"


@dataclass(frozen=True)
class Block:
    """What a header says of a packed column."""

    name: str
    size: int
    crc: int
    centre: int
    mapped: int
    context: str

    def listed(self) -> list:
        """As a list for JSON."""
        return [self.name, self.size, self.crc, self.centre, self.mapped, self.context]

    @classmethod
    def checked(cls, listed: Any, name: str, order: Order) -> Block:
        """The block of a list from outside, of this column; raises FastGSError unless it makes sense."""
        good = isinstance(listed, list) and len(listed) == 6 and listed[0] == name and all(type(v) is int for v in listed[1:5])
        good = good and 0 <= listed[1] < 1 << 40 and abs(listed[3]) <= MOST and listed[4] in (0, 1)
        if not good or not (listed[5] == "" or listed[5] in order.columns):
            raise FastGSError(f"its header does not say how the column {name} of a segment is packed; copy the file again.")
        return cls(*listed)


class Order:
    """The orders of a segment's Gaussians by their contexts, small whole numbers by name.

    Beside columns that are contexts, there are BEFORE, the length in bits of the number in the array's column before, and TOGETHER, the sum
    of these lengths over the array's columns so far.
    """

    def __init__(self) -> None:
        self.columns: dict[str, np.ndarray] = {}
        self.orders: dict[str, np.ndarray] = {}

    def follow(self, codes: np.ndarray | None) -> None:
        """Numbers [N] have become known: the next column of their array follows; None: another array begins."""
        before = self.columns.pop(TOGETHER, 0)
        for name in (BEFORE, TOGETHER):
            self.orders.pop(name, None)
            self.columns.pop(name, None)
        if codes is not None:
            length = np.frexp(np.abs(codes).astype(np.float32))[1].astype(np.int32)
            self.columns[BEFORE], self.columns[TOGETHER] = length, np.minimum(before + length, MOST_VALUES - 1)

    def by(self, name: str) -> np.ndarray:
        """Indices [N] that sort the Gaussians by a column."""
        if name not in self.orders:
            column = self.columns[name]
            low = int(column.min()) if len(column) else 0
            span = int(column.max()) - low if len(column) else 0
            key = np.minimum(column.astype(np.int64) - low, 65535).astype(np.uint8 if span < 256 else np.uint16)
            self.orders[name] = np.argsort(key, kind="stable")
        return self.orders[name]


def packed(name: str, codes: np.ndarray, order: Order) -> tuple[bytes, Block]:
    """A column of whole numbers [N] packed, in the order of that context which promises the fewest bytes."""
    codes = np.clip(codes, -MOST, MOST)
    centre = int(np.median(codes)) if len(codes) else 0
    zigzag = _zigzag(codes - centre)
    symbols = symbols_of(zigzag)
    context, ends = groups(symbols, order)
    if context:
        index = order.by(context)
        symbols, zigzag = symbols[index], zigzag[index]
    rest = []
    for e in range(FIRST, LAST + 1):
        own = zigzag[(symbols >= DIRECT) & ((symbols - DIRECT) >> 2 == e - FIRST)] if symbols.max(initial=0) >= DIRECT else zigzag[:0]
        rest.append(np.packbits(((own >> np.arange(e - 2)[:, None]) & 1).astype(np.uint8)))
    data, mapped = _stream(np.split(symbols, ends) + rest), 0
    if len(codes) and (symbols == 0).mean() > MAPPED:
        shown = symbols != 0
        parts = np.split(np.packbits(shown), [end // 8 for end in ends]) + np.split(symbols[shown], np.cumsum(shown)[np.array(ends) - 1])
        other = _stream(parts + rest)
        if len(other) < len(data):
            data, mapped = other, 1
    return data, Block(name, len(data), zlib.crc32(data), centre, mapped, context)


def symbols_of(zigzag: np.ndarray) -> np.ndarray:
    """The symbols u8 [N] of whole numbers from 0 on."""
    e = np.frexp(np.maximum(zigzag, 1).astype(np.float64))[1] - 1
    beyond = DIRECT + 4 * (e - FIRST) + ((zigzag >> np.maximum(e - 2, 0)) & 3)
    return np.where(zigzag < DIRECT, zigzag, beyond).astype(np.uint8)


def _stream(parts: list[np.ndarray]) -> bytes:
    """A zlib stream of all parts, each in blocks of its own: the shorter of one with repetitions and one with runs of equal bytes alone.

    Symbols repeat by chance only, and short repetitions often cost more than the codes of their symbols.
    """
    streams = []
    for strategy in (zlib.Z_DEFAULT_STRATEGY, zlib.Z_RLE):
        packer = zlib.compressobj(9, memLevel=9, strategy=strategy)
        streams.append(b"".join([packer.compress(part.tobytes()) + packer.flush(zlib.Z_BLOCK) for part in parts if len(part)])
                       + packer.flush())
    return min(streams, key=len)


def promised(codes: np.ndarray) -> float:
    """Bits that a column of whole numbers [N] needs, about: without contexts, and with the best code."""
    zigzag = _zigzag(np.clip(codes, -MOST, MOST) - (int(np.median(codes)) if len(codes) else 0))
    symbols = symbols_of(zigzag).astype(np.int64)
    rest = np.where(symbols >= DIRECT, (symbols - DIRECT) // 4 + FIRST - 2, 0).sum()
    return float(entropies(np.bincount(symbols, minlength=256)[None])[0] + rest)


def groups(symbols: np.ndarray, order: Order) -> tuple[str, list[int]]:
    """The context that promises the fewest bits for symbols u8 [N] ("": none), and where groups of them end in its order."""
    best, cost, ends = "", entropies(np.bincount(symbols, minlength=256)[None])[0], [len(symbols)]
    for name, column in order.columns.items():
        key = column - column.min() if len(column) else column
        if not len(column) or not 0 < key.max() < MOST_VALUES:
            continue
        values = int(key.max()) + 1
        table = np.bincount(key.astype(np.int64) * 256 + symbols, minlength=256 * values).reshape(values, 256)
        sums = np.concatenate([np.zeros((1, 256), np.int64), np.cumsum(table, axis=0)])
        least, before = np.zeros(values + 1), np.zeros(values + 1, int)
        for last in range(1, values + 1):
            whole = least[:last] + entropies(sums[last] - sums[:last]) + TABLE
            before[last] = whole.argmin()
            least[last] = whole[before[last]]
        if least[-1] - TABLE < cost - NAMED:
            best, cost, ends, last = name, least[-1] - TABLE + NAMED, [], values
            while last:
                ends.insert(0, int(sums[last].sum()))
                last = before[last]
    return best, ends


NAMED = 64
"""Bits that a context must save at least."""


def entropies(counts: np.ndarray) -> np.ndarray:
    """Bits [M] of symbols that occur so often [M, 256], in the best code of whole bits or less."""
    total = counts.sum(1, keepdims=True)
    with np.errstate(all="ignore"):
        share = counts / total
        return -np.where(counts > 0, counts * np.log2(share), 0).sum(1)


def unpacked(data: bytes | memoryview, block: Block, count: int, order: Order) -> np.ndarray:
    """The whole numbers int32 [count] of a packed column; nothing is allocated on the word of the packed bytes.

    Raises FastGSError for damage."""
    if zlib.crc32(data) != block.crc:
        raise FastGSError(f"the column {block.name} of a segment is damaged (its checksum is another); copy the file again.")
    unpacker, most = zlib.decompressobj(), count * 5 + 64
    try:
        raw = np.frombuffer(unpacker.decompress(data, most), np.uint8)
    except zlib.error as error:
        raise FastGSError(f"the column {block.name} of a segment cannot be unpacked; copy the file again.") from error
    if not unpacker.eof:
        raise FastGSError(f"the column {block.name} of a segment would be longer than its Gaussians need; copy the file again.")
    take = _Taker(raw, block.name)
    if block.mapped:
        symbols = np.unpackbits(take(-(-count // 8)), count=count)
        places = np.flatnonzero(symbols)
        symbols[places] = take(len(places))
    else:
        symbols = take(count)
    zigzag = symbols.astype(np.uint32)
    beyond = np.flatnonzero(symbols >= DIRECT)
    if len(beyond):
        own = symbols[beyond].astype(np.uint32) - DIRECT
        power = own >> 2
        zigzag[beyond] = ((own & 3) | 4) << (power + (FIRST - 2))
        for e in range(FIRST, LAST + 1):
            places = beyond[power == e - FIRST]
            bits = np.unpackbits(take(-(-len(places) * (e - 2) // 8)), count=len(places) * (e - 2)).reshape(e - 2, len(places))
            for k in range(e - 2 if len(places) else 0):
                zigzag[places] |= bits[k].astype(np.uint32) << np.uint32(k)
    if take.left:
        raise FastGSError(f"the column {block.name} of a segment is longer than its Gaussians need; copy the file again.")
    codes = ((zigzag >> np.uint32(1)) ^ (np.uint32(0) - (zigzag & np.uint32(1)))).view(np.int32)
    codes += np.int32(block.centre)
    if not block.context:
        return codes
    out = np.empty_like(codes)
    out[order.by(block.context)] = codes
    return out


class _Taker:
    """Takes bytes from the front of an array."""

    def __init__(self, raw: np.ndarray, name: str) -> None:
        self.raw, self.name, self.at = raw, name, 0

    @property
    def left(self) -> int:
        return len(self.raw) - self.at

    def __call__(self, size: int) -> np.ndarray:
        if size > self.left:
            raise FastGSError(f"the column {self.name} of a segment is cut short; copy the file again.")
        self.at += size
        return self.raw[self.at - size:self.at]


def _zigzag(codes: np.ndarray) -> np.ndarray:
    codes = codes.astype(np.int64)
    return (codes << 1) ^ (codes >> 63)
