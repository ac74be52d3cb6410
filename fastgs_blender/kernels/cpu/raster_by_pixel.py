# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterises with the splats of each pixel in the order in which its own ray meets them (raster.py: in the order of their centres).

A splat's depth at a pixel is that of its plane (oracle.plane).  A tile takes its splats by the least depth that each has in it.  What
touches a pixel waits there, sorted, until the next splat's least depth is beyond it: then nothing that is still to come lies before it, and
it is blended.  So the order is exact, however long the lists, and pixels end as early as they can.
"""
from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import float32
from numba.core import types
from numba.extending import intrinsic

from ...rendering.holdout import SAMPLES
from ...rendering.layout import CORE, DEPTH_FROM, PROBES, REST
from ...rendering.oracle import T_STOP
from . import simd
from .jit import inline, kernel
from .occlusion import lose
from .raster import CHANNEL, L11, L21, L22, LOG2_OPACITY, MEAN_X, MEAN_Y, PIXELS, RADIUS_X, RADIUS_Y, TILE, begin, covering, deliver

WAITING = 32
"""Splats for which each pixel has room at first."""
STOP, FROM, TO, LEAST = float32(T_STOP), float32(CORE[0]), float32(CORE[1]), float32(REST)


@intrinsic
def alpha8(context, target, u, du, row, attributes, first):
    """Write a splat's alpha in eight pixels to target [8] (raster.covering); first: of its numbers in attributes, in a row of all."""
    number = types.float32
    signature = types.void(target, number, number, number, attributes, types.intp)

    def build(context, b, signature, args):
        target, attributes = (simd.Memory(context, b, signature.args[k], args[k]) for k in (0, 4))
        target.store(simd.ir.Constant(args[5].type, 0), 0, covering(
            b, lambda c: simd.broadcast(b, attributes.scalar(args[5], c)), *(simd.broadcast(b, args[i]) for i in (1, 2, 3))))
        return context.get_dummy_value()

    return signature, build


@inline
def _box(i, left, top, geometry, attributes):
    """The pixels of the tile at (left, top) that a splat may touch: first and last in x and in y; and its centre from their first."""
    mx, my = geometry[i, MEAN_X] - left - 0.5, geometry[i, MEAN_Y] - top - 0.5
    rx, ry = attributes[i, RADIUS_X], attributes[i, RADIUS_Y]
    return (max(0.0, math.ceil(mx - rx)), min(TILE - 1.0, math.floor(mx + rx)), max(0.0, math.ceil(my - ry)),
            min(TILE - 1.0, math.floor(my + ry)), mx, my)


@inline
def _least(i, box, x, y, plane, attributes):
    """A splat's least depth in its box; x, y: of the tile's first pixel centre from the middle of the image; inf where the box is empty."""
    xl, xh, yl, yh, _, _ = box
    if not (xl <= xh and yl <= yh):
        return float32(np.inf)
    dx, dy = attributes[i, plane + 1], attributes[i, plane + 2]
    return _depth(i, x + (xl if dx > 0 else xh), y + (yl if dy > 0 else yh), plane, attributes)


@inline
def _depth(i, x, y, plane, attributes):
    """A splat's depth at a place, counted from the middle of the image."""
    return float32(np.float64(attributes[i, plane]) + attributes[i, plane + 1] * x + attributes[i, plane + 2] * y)


@inline
def _hide(p, z, canvas):
    """Take the points of a pixel away that triangles cover before a depth."""
    state, _, _, _, _, _, depths, taken, left_over, stopped = canvas
    while taken[p] < SAMPLES and depths[p, taken[p]] < z:
        lose(state, left_over, stopped, p)
        taken[p] += 1


@inline
def _settle(p, bound, waiting, hides, canvas):
    """Blend the splats that wait at a pixel up to a depth.  The equations are those of raster.blend(), for one pixel: its neighbours
    blend other splats."""
    head, tail, near, alphas, who = waiting
    state, attributes, channels, core, end, probes, _, _, _, _ = canvas
    while head[p] < tail[p] and near[p, head[p]] <= bound:
        z, opacity, i = near[p, head[p]], alphas[p, head[p]], np.intp(who[p, head[p]])
        head[p] += 1
        if not state[p] > float32(0.0):
            continue
        if hides:
            _hide(p, z, canvas)
        before = state[p]
        weight = before * opacity
        after = before - weight
        if not after > STOP:
            state[p] = -before
            continue
        state[p] = after
        inner = max(min(before, TO) - max(after, FROM), float32(0.0)) + LEAST * weight
        for c in range(channels):
            state[PIXELS * (1 + c) + p] += (inner if core <= c < end else weight) * attributes[i, CHANNEL + c]
        for k in range(len(probes)):
            at = PIXELS * (1 + channels + k) + p
            if probes[k] < float32(0.0):  # the count
                state[at] += float32(1.0)
            elif before > probes[k]:
                state[at] = z


@inline
def _wait(p, z, opacity, i, waiting):
    """Insert a splat by its depth among those that wait at a pixel; there must be room."""
    head, tail, near, alphas, who = waiting
    if tail[p] == near.shape[1]:
        for h in range(head[p], tail[p]):
            near[p, h - head[p]], alphas[p, h - head[p]], who[p, h - head[p]] = near[p, h], alphas[p, h], who[p, h]
        head[p], tail[p] = 0, tail[p] - head[p]
    h = tail[p]
    while h > head[p] and near[p, h - 1] > z:
        near[p, h], alphas[p, h], who[p, h] = near[p, h - 1], alphas[p, h - 1], who[p, h - 1]
        h -= 1
    near[p, h], alphas[p, h], who[p, h] = z, opacity, i
    tail[p] += 1


@kernel
def rasterise(first, last, columns, x0, y0, right, bottom, tile_x, tile_y, starts, ids, geometry, attributes, out, alpha, extra, hiding,
              held, middle_x, middle_y, wanted, plane, core, end, probes):
    """raster.rasteriser's kernel; plane: the column of attributes with which planes begin; core, end: the channels that are summed over the
    core (layout.py); probes: of each that is wanted the transmittance from which it takes a depth, or -1 for the count."""
    channels, hides, infinite = out.shape[2], len(held) > 0, float32(np.inf)
    state = np.empty((1 + channels + len(probes)) * PIXELS, np.float32)
    left_over, stopped, taken = np.empty(PIXELS, np.int64), np.zeros(PIXELS, np.float32), np.zeros(PIXELS, np.int64)
    depths, opacities = np.empty((PIXELS, SAMPLES), np.float32), np.empty(simd.LANES, np.float32)
    canvas = (state, attributes, channels, core, end, probes, depths, taken, left_over, stopped)
    head, tail = np.empty(PIXELS, np.int64), np.empty(PIXELS, np.int64)
    near, alphas = np.empty((PIXELS, WAITING), np.float32), np.empty((PIXELS, WAITING), np.float32)
    who = np.empty((PIXELS, WAITING), np.int32)
    for tile in range(first, last):
        if not wanted[tile]:
            continue
        left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
        x_middle, y_middle = left + 0.5 - middle_x, top + 0.5 - middle_y
        begin(state, left, top, x0, y0, right, bottom)
        for p in range(PIXELS):
            head[p], tail[p], left_over[p], stopped[p], taken[p] = 0, 0, SAMPLES, float32(0.0), 0
            for k in range(len(probes)):
                state[PIXELS * (1 + channels + k) + p] = float32(0.0) if probes[k] < float32(0.0) else infinite
        if hides:
            _sort(hiding, tile - first, depths)
        count = starts[tile + 1] - starts[tile]
        least = np.empty(count, np.float32)
        for k in range(count):
            i = np.intp(ids[starts[tile] + k])
            least[k] = _least(i, _box(i, left, top, geometry, attributes), x_middle, y_middle, plane, attributes)
        order = np.argsort(least, kind="mergesort")
        for k in range(count):
            bound = least[order[k]]
            if not bound < infinite:
                break
            if k % TILE == TILE - 1:
                front = float32(-1.0)
                for p in range(PIXELS):
                    _settle(p, bound, (head, tail, near, alphas, who), hides, canvas)
                    front = max(front, state[p])
                if front <= float32(0.0):
                    break
            i = np.intp(ids[starts[tile] + order[k]])
            xl, xh, yl, yh, mx, my = _box(i, left, top, geometry, attributes)
            a, b, c = float32(geometry[i, L11]), float32(geometry[i, L21]), float32(geometry[i, L22])
            u0 = float32(-geometry[i, L11] * mx - geometry[i, L21] * my)
            v0 = float32(-geometry[i, L22] * my)
            for y in range(int(yl), int(yh) + 1):
                v = v0 + c * float32(y)
                row, u = attributes[i, LOG2_OPACITY] - v * v, u0 + b * float32(y)
                for half in range(int(xl) // simd.LANES, int(xh) // simd.LANES + 1):
                    alpha8(opacities, u + a * float32(half * simd.LANES), a, row, attributes, i * attributes.shape[1])
                    for lane in range(simd.LANES):
                        x = half * simd.LANES + lane
                        p = y * TILE + x
                        if not (opacities[lane] > float32(0.0) and state[p] > float32(0.0)):
                            continue
                        _settle(p, bound, (head, tail, near, alphas, who), hides, canvas)
                        if not state[p] > float32(0.0):
                            continue
                        if head[p] == 0 and tail[p] == near.shape[1]:
                            near, alphas, who = _wider(near), _wider(alphas), _wider(who)
                        _wait(p, _depth(i, x_middle + x, y_middle + y, plane, attributes), opacities[lane], i,
                              (head, tail, near, alphas, who))
        for p in range(PIXELS):
            _settle(p, infinite, (head, tail, near, alphas, who), hides, canvas)
            if hides:
                _hide(p, infinite, canvas)
        deliver(state, stopped, left_over, hides, left, top, x0, y0, right, bottom, channels, len(probes), out, alpha, extra, held)


@inline
def _wider(array):
    """The array with twice as many columns."""
    larger = np.empty((array.shape[0], 2 * array.shape[1]), array.dtype)
    for p in range(array.shape[0]):
        for k in range(array.shape[1]):
            larger[p, k] = array[p, k]
    return larger


@inline
def _sort(hiding, tile, depths):
    """Fill depths [PIXELS, SAMPLES] with those of a tile's points, each pixel's from the nearest on; with inf where nothing hides."""
    for p in range(PIXELS):
        for k in range(SAMPLES):
            z, h = hiding[tile, p, k] if len(hiding) else float32(np.inf), k
            while h > 0 and depths[p, h - 1] > z:
                depths[p, h] = depths[p, h - 1]
                h -= 1
            depths[p, h] = z


@cache
def rasteriser(probes: tuple[str, ...], plane: int, core: tuple[int, int]):
    """The kernel as raster.rasteriser gives it, for splats whose planes are in the channels from `plane` on."""
    wanted = np.array([DEPTH_FROM.get(name, -1.0) for name in PROBES if name in probes], np.float32)
    return lambda *given: rasterise(*given, CHANNEL + plane, *core, wanted)
