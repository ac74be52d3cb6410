# SPDX-License-Identifier: GPL-3.0-or-later
"""Which groups of pixels of a tile a splat reaches: one bit each, so that rasterisers visit these alone, in one loop.

A group has as many pixels of a row as vectors have lanes, eight or sixteen.  Groups are counted row by row: group g begins at pixel
g lanes.  Both sizes give the same bytes.
"""
from __future__ import annotations

from contextlib import contextmanager

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from . import simd
from .jit import inline

TILE = 16
BITS = ir.IntType(32)
ROW = TILE * TILE // simd.LANES
LINES = 2 * ROW
"""Numbers that reached() leaves: u of each group's first pixel, then from ROW on the row's share of each group's exponent."""
CACHE_LINE = 64
"""Bytes of a line of the cache, at least."""
MARGIN = 1e-4
"""By how much log2(alpha) may stay below the cut: rounding never leaves out a group that has a pixel above it."""


def every(lanes: int) -> int:
    """The bits of all groups."""
    return (1 << TILE * TILE // lanes) - 1


@inline
def scratch(planes):
    """Memory for a tile: lines [LINES] and so many planes of its pixels [planes TILE^2], float32.

    It begins at a line of the cache, as vectors that lie in two lines take twice the time.  The lines come first: 4096 bytes behind a
    plane, reading them would wait for what was written to that plane, since processors compare the last 12 bits of addresses.
    """
    block = np.empty(LINES + planes * TILE * TILE + CACHE_LINE // 4, np.float32)
    first = -np.intp(block.ctypes.data) % CACHE_LINE // 4
    end = first + LINES
    return block[first:end], block[end:end + planes * TILE * TILE]


def along(u, du):
    """u of a group's pixels, from that of its first one and the change by pixel, as vectors: rounded alike in groups of both sizes."""
    for begin in range(simd.LANES, u.lanes, simd.LANES):
        u = u + simd.numbers(u.builder, [begin * (lane >= begin) for lane in range(u.lanes)]) * du
    return u + simd.numbers(u.builder, [lane % simd.LANES for lane in range(u.lanes)]) * du


@intrinsic(prefer_literal=True)
def reached(context, lines, u, v, slopes, opacity, cut, lanes):
    """The groups in which a splat has an alpha of at least its cut, as bits.

    lines   [LINES] float32, written: log2(alpha) of the i-th pixel of group g is lines[ROW + g] - (lines[g] + i du/dx)^2
    u, v    at the tile's first pixel: log2(alpha) = opacity - u^2 - v^2
    slopes  (du/dx > 0, du/dy, dv/dy)
    lanes   pixels of a group, a constant of the kernel
    """
    if not isinstance(lanes, types.IntegerLiteral):
        return None
    number, count = types.float32, lanes.literal_value
    signature = types.uint32(lines, number, number, types.UniTuple(number, 3), number, number, lanes)

    def build(context, b, signature, args):
        lines = simd.Memory(context, b, signature.args[0], args[0])
        u0, v0, opacity, cut = (simd.broadcast(b, args[i], count) for i in (1, 2, 4, 5))
        u_x, u_y, v_y = (simd.broadcast(b, x, count) for x in cgutils.unpack_tuple(b, args[3], 3))
        mask = BITS(0)
        for first in range(0, TILE * TILE // count, count):
            begins = [group * count for group in range(first, first + count)]
            y, x = simd.numbers(b, [pixel // TILE for pixel in begins]), simd.numbers(b, [pixel % TILE for pixel in begins])
            v = y * v_y + v0
            row, u = opacity - v * v, x * u_x + (y * u_y + u0)
            last = u_x * (count - 1) + u
            nearest = u.max(simd.constant(b, 0.0, count) - last).max(0.0)  # u grows from pixel to pixel: it may pass 0 in between
            lines.store(_index(first), 0, u)
            lines.store(_index(ROW + first), 0, row)
            bits = b.bitcast(row - nearest * nearest >= cut - MARGIN, ir.IntType(count))
            mask = b.or_(mask, b.shl(b.zext(bits, BITS), BITS(first)))
        return mask

    return signature, build


def _index(number: int):
    """A constant index."""
    return ir.Constant(ir.IntType(64), number)


@contextmanager
def each(builder, mask):
    """Generate a loop over the set bits of a mask, from the lowest on; gives the bit's number, as an index and as BITS."""
    rest = cgutils.alloca_once_value(builder, mask)
    head, body, after = (builder.append_basic_block(name) for name in ("groups", "group", "done"))
    builder.branch(head)
    builder.position_at_end(head)
    left = builder.load(rest)
    builder.cbranch(builder.icmp_unsigned("!=", left, BITS(0)), body, after)
    builder.position_at_end(body)
    bit = builder.cttz(left, ir.IntType(1)(1))
    builder.store(builder.and_(left, builder.sub(left, BITS(1))), rest)
    yield builder.zext(bit, ir.IntType(64)), bit
    builder.branch(head)
    builder.position_at_end(after)
