# SPDX-License-Identifier: GPL-3.0-or-later
"""Which groups of eight pixels of a tile a splat reaches: one bit each, so that rasterisers visit these alone, in one loop.

A tile has 32 groups, two to a row, row by row: group g begins at pixel 8 g.
"""
from __future__ import annotations

from contextlib import contextmanager

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from . import simd

GROUPS = 32
BITS = ir.IntType(GROUPS)
LINES = 2 * GROUPS
"""Numbers that reached() leaves: u of each group's first pixel, then the row's share of each group's exponent."""
ALL = (1 << GROUPS) - 1


@intrinsic
def reached(context, lines, u, v, slopes, opacity, cut):
    """The groups in which a splat has an alpha of at least its cut, as bits.

    lines   [LINES] float32, written: log2(alpha) of the i-th pixel of group g is lines[GROUPS + g] - (lines[g] + i du/dx)^2
    u, v    at the tile's first pixel: log2(alpha) = opacity - u^2 - v^2
    slopes  (du/dx > 0, du/dy, dv/dy)
    """
    number = types.float32
    signature = types.uint32(lines, number, number, types.UniTuple(number, 3), number, number)

    def build(context, b, signature, args):
        lines = simd.Memory(context, b, signature.args[0], args[0])
        u0, v0, opacity, cut = (simd.broadcast(b, args[i]) for i in (1, 2, 4, 5))
        u_x, u_y, v_y = (simd.broadcast(b, x) for x in cgutils.unpack_tuple(b, args[3], 3))
        mask = BITS(0)
        for first in range(0, GROUPS, simd.LANES):
            here = range(first, first + simd.LANES)
            y, x = simd.numbers(b, [group // 2 for group in here]), simd.numbers(b, [group % 2 * simd.LANES for group in here])
            v = y * v_y + v0
            row, u = opacity - v * v, x * u_x + (y * u_y + u0)
            last = u_x * (simd.LANES - 1) + u
            nearest = u.max(simd.constant(b, 0.0) - last).max(0.0)  # u grows from pixel to pixel: it may pass 0 in between
            lines.store(_index(first), 0, u)
            lines.store(_index(GROUPS + first), 0, row)
            bits = b.zext(b.bitcast(row - nearest * nearest >= cut, ir.IntType(simd.LANES)), BITS)
            mask = b.or_(mask, b.shl(bits, BITS(first)))
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
