# SPDX-License-Identifier: GPL-3.0-or-later
"""Backward pass of raster.py: the gradient of the loss with respect to each splat.

Each tile goes through its list back to front and writes one row of sums for every entry; then the rows of a splat, one per
tile, are added up in the order of the tiles.  Nothing is shared between threads, so the gradients have the same bytes for any
number of them.

A pixel holds the transmittance T behind the splats still to come and B, the light that arrives from there.  With
dot = g . c + g_alpha (alpha is a channel in which every splat is 1) a splat of opacity a has d loss / d a = T (dot - B), and
then B becomes B + a (dot - B): no differences of large sums, whatever lies in front.
"""
from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import float32
from numba.core import cgutils, types
from numba.extending import intrinsic

from . import groups, raster, simd
from .jit import kernel

TILE, PIXELS = raster.TILE, raster.PIXELS

# columns of an entry's sums over pixels; e: d loss / d log2(alpha) / ln 2, u and v as in raster.py, dx and dy from the centre
E, EU, EU_X, EU_Y, E_Y, E_YY, ABS_X, ABS_Y, CHANNEL = range(9)
# planes of a tile's state
WIDE = simd.WIDE
LEFT, BEHIND, LAST, GRADIENT = range(4)
AHEAD = 8
"""How many entries ahead memory is asked for."""


def columns(channels: int) -> int:
    """Floats in an entry's row: whole vectors."""
    return CHANNEL + -(-channels // simd.LANES) * simd.LANES


@intrinsic(prefer_literal=True)
def gather_splat(context, state, visited, place, lines, centre, slopes, attributes, splat, band, rows, entry, channels, smooth):
    """One splat over its groups of pixels (groups.reached, which wrote lines): take it off their state and write its sums into rows[entry].

    place    the splat's place in the tile's list
    centre   (v, dx, dy) at the tile's first pixel
    slopes   (du/dx, du/dy, dv/dy)
    channels and smooth (0 or 1) are constants of the kernel.
    """
    if not isinstance(channels, types.IntegerLiteral) or not isinstance(smooth, types.IntegerLiteral):
        return None
    count = channels.literal_value
    signature = types.void(state, types.uint32, types.float32, lines, types.UniTuple(types.float32, 3), types.UniTuple(types.float32, 3),
                           attributes, types.intp, types.float32, rows, types.intp, channels, smooth)

    def build(context, b, signature, args):
        state, lines, attributes, rows = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 3, 6, 9))
        def spread(scalar):
            return simd.broadcast(b, scalar, WIDE)

        place, one = spread(args[2]), simd.constant(b, 1.0, WIDE)
        v0, dx0, dy0 = (spread(x) for x in cgutils.unpack_tuple(b, args[4], 3))
        u_x, u_y, v_y = (spread(x) for x in cgutils.unpack_tuple(b, args[5], 3))
        whole = args[7].type
        first = b.mul(args[7], whole(raster.CHANNEL + count))

        def floats(pixel, plane):
            return state.floats(pixel, plane * PIXELS, WIDE)

        def column(i):
            return spread(attributes.scalar(first, i))

        def number(index):
            return spread(b.sitofp(index, simd.ir.FloatType()))

        highest, cut = column(raster.ALPHA_MAX), column(raster.LOG2_CUT)
        colour = [column(raster.CHANNEL + c) for c in range(count)]
        sums = [simd.Sum(b, WIDE) for _ in range(CHANNEL + count)]
        with groups.each(b, args[1]) as (group, _):
            u_row, row = (spread(lines.scalar(group, begin)) for begin in (0, groups.ROW))
            pixel = b.mul(group, whole(WIDE))
            y, x = number(b.udiv(pixel, whole(TILE))), number(b.and_(pixel, whole(TILE - 1)))
            v, dy = v_y * y + v0, y + dy0
            u, dx = groups.along(u_row, u_x), simd.ramp(b, WIDE) + x + dx0
            exponent = row - u * u
            free = exponent.exp2()
            clamped = free.min(highest)
            drawn = b.and_(exponent >= cut, floats(pixel, LAST) >= place)
            with b.if_then(simd.any_of(b, drawn)):
                alpha = slope = clamped.where(drawn, 0.0)
                if smooth.literal_value:
                    factor, rate = raster.fade(alpha, cut, spread(args[8]))
                    alpha, slope = alpha * factor, alpha * factor + alpha * alpha * rate
                left = floats(pixel, LEFT) / (one - alpha)
                state.store(pixel, LEFT * PIXELS, left)
                gradient = [floats(pixel, GRADIENT + c) for c in range(count + 1)]
                dot = gradient[count]
                for g, c in zip(gradient, colour):
                    dot = dot + g * c
                behind = floats(pixel, BEHIND)
                more = dot - behind
                state.store(pixel, BEHIND * PIXELS, behind + alpha * more)
                weight = alpha * left
                for c in range(count):
                    sums[CHANNEL + c].add(weight * gradient[c])
                e = (slope * left * more).where(free < highest, 0.0)
                eu, ey = e * u, e * dy
                sums[E].add(e)
                sums[EU].add(eu)
                sums[EU_X].add(eu * dx)
                sums[EU_Y].add(eu * dy)
                sums[E_Y].add(ey)
                sums[E_YY].add(ey * dy)
                emphasis = floats(pixel, GRADIENT + count + 1)
                sums[ABS_X].add(eu.magnitude() * emphasis)
                sums[ABS_Y].add((eu * u_y + e * (v * v_y)).magnitude() * emphasis)
        begin, width = b.mul(args[10], whole(columns(count))), columns(count)
        values = [s.value() for s in sums] + [simd.constant(b, 0.0)] * (width - len(sums))
        for i in range(0, width, simd.LANES):
            rows.store(begin, i, simd.totals(b, values[i:i + simd.LANES]))
        return context.get_dummy_value()

    return signature, build


@cache
def rasteriser_backward(channels: int, band: float = 0.0):
    """The kernel for a number of channels; band as in raster.rasteriser."""
    smooth, band = int(band > 0), float(band)
    planes = GRADIENT + channels + 2

    def rasterise_backward(first, last, columns, x0, y0, right, bottom, tile_x, tile_y, starts, ids, geometry, attributes, trace,
                           grad_out, grad_alpha, emphasis, ends, rows):
        """Tiles first..last as in raster.py.

        trace [h, 2 w]: what the forward pass left; grad_out [h, w, C], grad_alpha [h, w]: d loss / d what it drew.
        emphasis [h, w]: by which absolute values are multiplied.
        rows [entries, columns()]: the sums of each entry of ids, written for each tile's first ends[tile] entries; the others'
        splats lie behind all that the tile shows.
        """
        lines, state = groups.scratch(planes)
        for tile in range(first, last):
            left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
            state[:PIXELS] = float32(1.0)
            state[PIXELS:] = float32(0.0)
            state[LAST * PIXELS:GRADIENT * PIXELS] = float32(-1.0)
            farthest = float32(-1.0)
            for y in range(max(top, y0), min(top + TILE, bottom)):
                for x in range(max(left, x0), min(left + TILE, right)):
                    p, i, j = (y - top) * TILE + x - left, y - y0, x - x0
                    own = grad_alpha[i, j] != 0.0
                    for c in range(channels):
                        own |= grad_out[i, j, c] != 0.0
                    if not own:  # nor do its splats get any
                        continue
                    state[p] = trace[i, j]
                    final = trace[i, j + right - x0]
                    state[LAST * PIXELS + p] = final
                    farthest = final if final > farthest else farthest
                    for c in range(channels):
                        state[(GRADIENT + c) * PIXELS + p] = grad_out[i, j, c]
                    state[(GRADIENT + channels) * PIXELS + p] = grad_alpha[i, j]
                    state[(GRADIENT + channels + 1) * PIXELS + p] = emphasis[i, j]
            ends[tile] = int(farthest) + 1
            for k in range(starts[tile] + ends[tile] - 1, starts[tile] - 1, -1):
                i = np.intp(ids[k])
                ahead = np.intp(ids[max(k - AHEAD, starts[tile])])
                simd.prefetch(geometry, ahead)
                simd.prefetch(attributes, ahead)
                u, v, slopes = raster.line(geometry, i, left, top)
                reached = groups.reached(lines, u, v, slopes, attributes[i, raster.LOG2_OPACITY], attributes[i, raster.LOG2_CUT], WIDE)
                centre = v, float32(left + 0.5 - geometry[i, raster.MEAN_X]), float32(top + 0.5 - geometry[i, raster.MEAN_Y])
                place = float32(k - starts[tile])
                gather_splat(state, reached, place, lines, centre, slopes, attributes, i, float32(band), rows, k, channels, smooth)

    return kernel(rasterise_backward)


@kernel
def collect(runs, first_tile, last_tile, cursor, starts, ends, rows, sums):
    """Add each splat's rows to sums [M, columns()], in the order of the tiles.

    The first four are those of tiles.scatter, and a splat's entries are found as they were written: by walking the same runs.
    """
    for k in range(len(runs)):
        i = np.intp(runs[k, 0])
        for tile in range(max(runs[k, 1], first_tile), min(runs[k, 2], last_tile)):
            entry = cursor[tile]
            cursor[tile] += 1
            if entry - starts[tile] < ends[tile]:
                simd.prefetch(rows, min(entry + AHEAD, len(rows) - 1))
                for c in range(rows.shape[1]):
                    sums[i, c] += rows[entry, c]


@kernel
def finish(first, last, order, geometry, sums, grad_geometry, grad_opacity, grad_channels, absolute):
    """From the sums of the splats order[first:last] to the gradients of their geometry, log2 opacity and channels."""
    ln2 = math.log(2.0)
    for k in range(first, last):
        i = np.intp(order[k])
        a, b, c = geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
        eu, ey = ln2 * sums[i, EU], ln2 * sums[i, E_Y]
        grad_geometry[i, raster.MEAN_X] = 2 * a * eu
        grad_geometry[i, raster.MEAN_Y] = 2 * (b * eu + c * c * ey)
        grad_geometry[i, raster.L11] = -2 * ln2 * sums[i, EU_X]
        grad_geometry[i, raster.L21] = -2 * ln2 * sums[i, EU_Y]
        grad_geometry[i, raster.L22] = -2 * c * ln2 * sums[i, E_YY]
        grad_opacity[i] = ln2 * sums[i, E]
        absolute[i, 0] = 2 * abs(a) * ln2 * sums[i, ABS_X]
        absolute[i, 1] = 2 * ln2 * sums[i, ABS_Y]
        for channel in range(grad_channels.shape[1]):
            grad_channels[i, channel] = sums[i, CHANNEL + channel]
