# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterises: blends the splats of each 16 x 16 tile front to back, eight pixels at a time.

The state of a tile is one local array of planes of 256 pixels: transmittance, then the channels, then the probes or the trace.
A pixel that is finished keeps its transmittance with the sign turned.
"""
from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import float32
from numba.core import cgutils, types
from numba.extending import intrinsic

from ...rendering.holdout import SAMPLES
from ...rendering.layout import CORE, DEPTH_FROM, PROBES, REST
from ...rendering.oracle import T_STOP
from . import groups, simd
from .jit import inline, kernel
from .occlusion import farthest, lose, losses

TILE = groups.TILE
PIXELS = TILE * TILE

# columns of a splat's geometry [., 5] float64: centre in pixels, and the triangle of the scaled inverse covariance, so that
# log2(alpha) = LOG2_OPACITY - (L11 dx + L21 dy)^2 - (L22 dy)^2.  A sum of squares: long thin splats do not cancel.
MEAN_X, MEAN_Y, L11, L21, L22 = range(5)
# columns of a splat's attributes [., 6 + C] float32; RADIUS: half the size of the box in which alpha reaches the cut
LOG2_OPACITY, ALPHA_MAX, LOG2_CUT, DEPTH, RADIUS_X, RADIUS_Y, CHANNEL = range(7)

NOTHING = np.empty((0, PIXELS, SAMPLES), np.float32)
"""The depths of a picture without a holdout."""
AHEAD = 8
"""How many splats ahead memory is asked for: a tile's splats lie all over it."""
HELD = 10
"""Channels that are held in registers while a splat is blended; of splats with more, the rest is read for each group of pixels."""
SIZES = (3, 4, 6, 9, 10, 16, 24, 32, 64, 128, 256)
"""Numbers of channels for which code is made; others are padded to the next."""


def padded(channels: int) -> int:
    """The number of channels that the kernel for `channels` has."""
    return next((size for size in SIZES if size >= channels), channels)


def fade(alpha, log2_cut, band):
    """The factor by which alpha fades in over `band` above the cut, 3 s^2 - 2 s^3, and its derivative by alpha."""
    s = ((alpha - log2_cut.max(-126.0).exp2()) / band).max(0.0).min(1.0)
    return s * s * (s * -2.0 + 3.0), (s - s * s) * 6.0 / band


def covering(builder, column, u, du, row) -> simd.Floats:
    """Alpha of a splat in a group of pixels, 0 below the cut: log2(alpha) = row - (u + i du)^2; column: its attributes in all lanes."""
    u = groups.along(u, du)
    exponent = row - u * u
    return exponent.exp2().min(column(ALPHA_MAX)).where(exponent >= column(LOG2_CUT), 0.0)


@intrinsic(prefer_literal=True)
def blend(context, state, visited, lines, du, attributes, splat, place, band, surface, channels, core, end, probes, trace, smooth, hides,
          lanes):
    """Blend one splat into its groups of pixels (groups.reached, which wrote lines); returns those whose pixels are all finished.

    channels, core, end, probes, trace, smooth, hides (0 or 1) and lanes (groups.py) are constants of the kernel: code is made for them.
    core, end: from which channel to which they are summed over the core (layout.py); probes: which of layout.PROBES are computed, a bit
    each; trace: remember `place` as that of the last splat blended; smooth: let alpha fade in over `band` above the cut; hides: the splat
    shows only where its surface, of the depth (at the tile's first pixel, change in x, change in y), lies before the depths in the last
    plane.
    """
    if not all(isinstance(kind, types.IntegerLiteral) for kind in (channels, core, end, probes, trace, smooth, hides, lanes)):
        return None
    count, cored, wide = channels.literal_value, range(core.literal_value, end.literal_value), lanes.literal_value
    number = types.float32
    signature = types.uint32(
        state, types.uint32, lines, number, attributes, types.intp, number, number, types.UniTuple(types.float64, 3), channels, core, end,
        probes, trace, smooth, hides, lanes)

    def build(context, b, signature, args):
        state, lines, attributes = (simd.Memory(context, b, signature.args[i], args[i]) for i in (0, 2, 4))
        whole = args[5].type
        first = b.mul(args[5], whole(CHANNEL + count))
        kept = {i: simd.broadcast(b, attributes.scalar(first, i), wide) for i in range(CHANNEL + min(count, HELD))}
        du, place, band = (simd.broadcast(b, args[i], wide) for i in (3, 6, 7))
        finished = cgutils.alloca_once_value(b, groups.BITS(0))

        def column(i):
            return kept[i] if i in kept else simd.broadcast(b, attributes.scalar(first, i), wide)

        with groups.each(b, args[1]) as (group, bit):
            pixel = b.mul(group, whole(wide))
            u, row = (simd.broadcast(b, lines.scalar(group, begin), wide) for begin in (0, groups.ROW))
            alpha = covering(b, column, u, du, row)
            if smooth.literal_value:
                alpha = alpha * fade(alpha, column(LOG2_CUT), band)[0]
            if hides.literal_value:
                last = PIXELS * (1 + count + len(chosen(probes.literal_value)))
                alpha = alpha.where(state.floats(pixel, last, wide) >= _depths(b, cgutils.unpack_tuple(b, args[8], 3), pixel), 0.0)
            before = state.floats(pixel, 0, wide)
            weight = before * alpha
            after = before - weight
            live = after > T_STOP
            weight = weight.where(live, 0.0)
            state.store(pixel, 0, after.where(live, before.negative_magnitude()))
            over = b.zext(b.not_(simd.any_of(b, live)), groups.BITS)
            b.store(b.or_(b.load(finished), b.shl(over, bit)), finished)
            if cored:
                inner = (before.min(CORE[1]) - after.max(CORE[0])).max(0.0).where(live, 0.0) + weight * REST
            for c in range(count):
                plane = PIXELS * (1 + c)
                state.store(pixel, plane, state.floats(pixel, plane, wide) + (inner if c in cored else weight) * column(CHANNEL + c))
            plane = PIXELS * (1 + count)
            if trace.literal_value:
                state.store(pixel, plane, place.where(weight > 0.0, state.floats(pixel, plane, wide)))
            for name in chosen(probes.literal_value):
                old, drawn = state.floats(pixel, plane, wide), weight > 0.0
                if name == "count":
                    new = (old + 1.0).where(drawn, old)
                else:
                    new = column(DEPTH).where(b.and_(drawn, before > DEPTH_FROM[name]), old)
                state.store(pixel, plane, new)
                plane += PIXELS
        return b.load(finished)

    return signature, build


def _depths(builder, surface, pixel):
    """The depths in float32 of a surface (at pixel 0, change in x, change in y: float64) at the pixels of the group from `pixel` on."""
    z, dx, dy = surface
    x, y = (builder.sitofp(part, z.type) for part in (builder.and_(pixel, pixel.type(TILE - 1)), builder.lshr(pixel, pixel.type(4))))
    z = builder.fadd(z, builder.fadd(builder.fmul(dx, x), builder.fmul(dy, y)))
    z, dx = (simd.broadcast(builder, builder.fptrunc(part, simd.ir.FloatType())) for part in (z, dx))
    return simd.ramp(builder) * dx + z


def chosen(bits: int) -> list[str]:
    """The probes of a set that is given as bits, in their order."""
    return [name for i, name in enumerate(PROBES) if bits >> i & 1]


@inline
def line(geometry, i, left, top):
    """u and v of a splat at the first pixel of the tile at (left, top), and their slopes (du/dx, du/dy, dv/dy); see groups.reached."""
    # in float64 up to the tile's corner, so that splats far off the screen keep their precision
    x, y, a, b, c = geometry[i, MEAN_X] - left - 0.5, geometry[i, MEAN_Y] - top - 0.5, geometry[i, L11], geometry[i, L21], geometry[i, L22]
    return float32(-a * x - b * y), float32(-c * y), (float32(a), float32(b), float32(c))


@inline
def begin(state, left, top, x0, y0, right, bottom):
    """Empty the state of the tile at (left, top): pixels outside of the window are finished."""
    state[:PIXELS] = float32(1.0)
    state[PIXELS:] = float32(0.0)
    if left < x0 or left + TILE > right or top < y0 or top + TILE > bottom:
        for i in range(PIXELS):
            x, y = left + i % TILE, top + i // TILE
            if x < x0 or x >= right or y < y0 or y >= bottom:
                state[i] = float32(-1.0)


@inline
def deliver(state, stopped, left_over, hides, left, top, x0, y0, right, bottom, channels, number, out, alpha, extra, held):
    """Write the channels and probes of a tile's state into the window's pictures."""
    width, begin_x, end_x = right - x0, max(left, x0), min(left + TILE, right)
    number_of_pixels = np.uintp(end_x - begin_x)
    pixels, covers, more, stops = out.reshape(-1), alpha.reshape(-1), extra.reshape(-1), held.reshape(-1)
    for y in range(max(top, y0), min(top + TILE, bottom)):
        # unsigned, so that no index is looked at as one that counts from the end
        source, target = np.uintp((y - top) * TILE + begin_x - left), np.uintp((y - y0) * width + begin_x - x0)
        for x in range(number_of_pixels):
            covers[target + x] = float32(1.0) - abs(state[source + x]) - stopped[source + x]
        for x in range(number_of_pixels):
            for c in range(np.uintp(channels)):
                pixels[(target + x) * np.uintp(channels) + c] = state[np.uintp(PIXELS) * (np.uintp(1) + c) + source + x]
        for k in range(np.uintp(number)):
            beside = np.uintp((y - y0) * width * number + begin_x - x0) + k * np.uintp(width)
            for x in range(number_of_pixels):
                more[beside + x] = state[np.uintp(PIXELS) * (np.uintp(1 + channels) + k) + source + x]
        if hides:
            beside = np.uintp((y - y0) * 2 * width + begin_x - x0)
            for x in range(number_of_pixels):
                stops[beside + x] = stopped[source + x]
                stops[beside + np.uintp(width) + x] = float32(SAMPLES - left_over[source + x]) / float32(SAMPLES)


@cache
def rasteriser(channels: int, probes: tuple[str, ...] = (), trace: int = 0, band: float = 0.0, plane: int | None = None,
               core: Any = (0, 0)):
    """The kernel for a number of channels, and the probes (layout.PROBES, in their order).

    core: from which to which channel they are summed over the core of each pixel.

    trace: write what the backward pass starts from (raster_backward.py) instead of probes.  band: alpha fades in over
    this much above the cut instead of beginning there, so that pictures are smooth functions of the splats.  plane: for pictures
    with a holdout, the first of the channels of the splats' planes.
    """
    assert not (trace and (probes or plane is not None))
    trace, smooth, band, hides = int(trace), int(band > 0), float(band), int(plane is not None)
    plane_at, (core, end) = CHANNEL + (plane or 0), core
    bits, number, depths = sum(1 << PROBES.index(name) for name in probes), len(probes), sum(name in DEPTH_FROM for name in probes)
    planes = 1 + channels + (number or trace) + hides
    lanes = simd.LANES if hides else simd.WIDE
    every = groups.every(lanes)
    limit = PIXELS * (planes - 1)

    def rasterise(first, last, columns, x0, y0, right, bottom, tile_x, tile_y, starts, ids, geometry, attributes, out, alpha, extra,
                  hiding, held, middle_x, middle_y, wanted):
        """Tiles first..last of `columns` a row, the first of them at tile (tile_x, tile_y) of the image.

        The window is x0..right, y0..bottom in pixels of the image; out [h, w, C] and alpha [h, w] are the window's.
        starts [tiles + 1]: each tile's run in ids, which lists splats front to back.  extra [h, P w]: the pictures of the P probes,
        side by side; with trace [h, 2 w]: the final transmittance, and beside it the place in the tile's list of the last splat
        blended, or -1.  hiding: of a holdout, the depths of the tiles first..last (holdout.Occluder), or NOTHING; held [h, 2 w]: the light
        that it stops, and beside it which share of the pixel it covers; middle_x, middle_y: of the image, where planes begin.
        wanted [tiles] bool: the tiles that are drawn; the pictures keep what they have in the others.
        """
        lines, state = groups.scratch(planes)
        left_over, stopped = np.empty(PIXELS, np.int64), np.zeros(PIXELS, np.float32)
        when, where = np.empty(0, np.int64), np.empty(0, np.int64)
        for tile in range(first, last):
            if not wanted[tile]:
                continue
            left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
            begin(state, left, top, x0, y0, right, bottom)
            if depths:
                state[PIXELS * (1 + channels):PIXELS * (1 + channels + depths)] = float32(np.inf)
            if trace:
                state[PIXELS * (1 + channels):] = float32(-1.0)
            event, upcoming, live = 0, -1, np.uint32(every)
            surface = 0.0, 0.0, 0.0
            if hides:
                state[limit:] = float32(np.inf)
                left_over[:], stopped[:] = SAMPLES, float32(0.0)
                if len(hiding):
                    when, where = losses(hiding[tile - first], DEPTH, starts[tile], starts[tile + 1], ids, attributes)
                    farthest(hiding[tile - first], state[limit:])
                upcoming = when[0] if len(when) else -1
            for k in range(starts[tile], starts[tile + 1]):
                if hides and k == upcoming:
                    while event < len(when) and when[event] == k:
                        lose(state, left_over, stopped, where[event])
                        event += 1
                    upcoming = when[event] if event < len(when) else -1
                i = np.intp(ids[k])
                ahead = np.intp(ids[min(k + AHEAD, starts[tile + 1] - 1)])
                simd.prefetch(geometry, ahead)
                simd.prefetch(attributes, ahead)
                u, v, slopes = line(geometry, i, left, top)
                if hides:
                    dx, dy = np.float64(attributes[i, plane_at + 1]), np.float64(attributes[i, plane_at + 2])
                    surface = attributes[i, plane_at] + dx * (left + 0.5 - middle_x) + dy * (top + 0.5 - middle_y), dx, dy
                reached = groups.reached(lines, u, v, slopes, attributes[i, LOG2_OPACITY], attributes[i, LOG2_CUT], lanes)
                live &= ~blend(state, reached & live, lines, slopes[0], attributes, i, float32(k - starts[tile]), float32(band), surface,
                               channels, core, end, bits, trace, smooth, hides, lanes)
                if live == 0:
                    break
            if hides:
                for k in range(event, len(when)):
                    lose(state, left_over, stopped, where[k])
            deliver(state, stopped, left_over, hides, left, top, x0, y0, right, bottom, channels, number, out, alpha, extra, held)
            if trace:
                for y in range(max(top, y0), min(top + TILE, bottom)):
                    for x in range(max(left, x0), min(left + TILE, right)):
                        p = (y - top) * TILE + x - left
                        extra[y - y0, x - x0] = abs(state[p])
                        extra[y - y0, x - 2 * x0 + right] = state[PIXELS * (1 + channels) + p]

    return kernel(rasterise)
