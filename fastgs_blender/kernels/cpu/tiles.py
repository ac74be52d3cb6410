# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find which splats touch which tile, exactly, and list them front to back.

Splats come sorted, so a counting sort by tile that keeps their order is all it takes.  A tile is listed if the ellipse in
which alpha reaches the cut crosses the tile's pixel centres; each row of tiles gets the ellipse's exact extent there.
"""
from __future__ import annotations

import math

import numpy as np

from . import raster
from .jit import inline, kernel
from .lanes import LANES, put, room, take, where
from .simd import prefetch

MARGIN = 1e-3
"""Pixels by which an extent is widened, so that rounding never loses a pixel that the rasteriser would blend."""
ROUNDING = 1e-6
"""Pixels beyond a pixel's centre up to which what begins there still reaches that pixel."""


AHEAD = 16
"""How many splats ahead memory is asked for: sorted by depth, they lie all over it."""
LINE = 16
"""Places of a list in a line of the cache: the next line is asked for at each write, as lists of all tiles are not in the cache."""


EXACT = 4
"""(Columns - 1) (rows - 1) from which on a box of tiles is cut down to the ellipse in it; smaller ones would only lose corners."""


def which_tiles(wanted, columns: int, rows: int):
    """For spans(), which tiles of a grid are wanted [tiles] bool, or None for all: how many of them lie above and left of a tile's corner
    [rows + 1, columns + 1], and for each tile the first one from it on and the last one up to it (three int32 arrays, empty for all)."""
    if wanted is None:
        return np.empty((0, 0), np.int32), np.empty(0, np.int32), np.empty(0, np.int32)
    number = np.arange(len(wanted))
    sums = np.zeros((rows + 1, columns + 1), np.int32)
    sums[1:, 1:] = wanted.reshape(rows, columns).cumsum(0).cumsum(1)
    after = np.minimum.accumulate(np.where(wanted, number, len(wanted))[::-1])[::-1]
    return sums, after.astype(np.int32), np.maximum.accumulate(np.where(wanted, number, -1)).astype(np.int32)


@kernel
def spans(first, last, order, geometry, attributes, tile_x, tile_y, columns, rows, shift, wanted, changes, runs, n):
    """The runs of tiles within a row that the splats order[first:last] touch, in their order.

    The window's tiles begin at (tile_x, tile_y) of the image, columns x rows of them, of 2^shift pixels.  wanted: which of these get lists,
    as which_tiles() tells.  Writes splat, first tile and tile after the last of every run into runs [., 3], from row n on, until there
    might be no room for another splat's.  Returns the first splat that is left, and n.  Adds to changes [columns * rows + 1] by how much
    the number of a tile's splats differs from that of the tile before it.
    """
    sums, after, before = wanted
    tile, some = 1 << shift, len(after) > 0
    number, found = room(1), room(2)
    for lane in range(LANES):
        number[0, lane] = lane * tile
    # from here on in pixels from the centre of the first tile's first pixel
    right_most, bottom_most = columns * tile - 1.0, rows * tile - 1.0
    for k in range(first, last):
        if n + rows > len(runs):
            return k, n
        i = np.intp(order[k])
        ahead = np.intp(order[min(k + AHEAD, last - 1)])
        prefetch(geometry, ahead)
        prefetch(attributes, ahead)
        mx, my = geometry[i, raster.MEAN_X] - (tile_x * tile + 0.5), geometry[i, raster.MEAN_Y] - (tile_y * tile + 0.5)
        rx, ry = np.float64(attributes[i, raster.RADIUS_X]), np.float64(attributes[i, raster.RADIUS_Y])
        box_left, box_right, box_top, box_bottom = max(mx - rx, 0.0), min(mx + rx, right_most), max(my - ry, 0.0), min(my + ry, bottom_most)
        if not (box_left <= box_right and box_top <= box_bottom):
            continue
        left, right, top, bottom = _tile(box_left, shift), int(box_right) >> shift, _tile(box_top, shift), int(box_bottom) >> shift
        if some and sums[bottom + 1, right + 1] - sums[top, right + 1] == sums[bottom + 1, left] - sums[top, left]:
            continue
        exact = (right - left) * (bottom - top) >= EXACT
        a, b, c, square, peak = 0.0, 0.0, 0.0, 0.0, 0.0
        if exact:
            a, b, c = 1.0 / geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
            square = np.float64(attributes[i, raster.LOG2_OPACITY]) - np.float64(attributes[i, raster.LOG2_CUT])
            peak = b * math.sqrt(square) / (c * math.sqrt(b * b + c * c))
        for row in range(top, bottom + 1):
            one, other, lane = left, right, (row - top) % LANES
            if exact:
                if lane == 0:
                    _extent(number, row * tile - my, tile, (square, peak, a, b, c), mx, box_left, box_right, found)
                one, other = int(found[0, lane]), int(found[1, lane])
            one, other = row * columns + one, row * columns + other
            if some and one <= other:
                one, other = after[one], before[other]
            # written anyway, and kept where there are any: no branch, which the processor would guess wrong
            touched = one <= other
            runs[n, 0], runs[n, 1], runs[n, 2] = i, one, other + 1
            changes[one] += touched
            changes[other + 1] -= touched
            n += touched
    return last, n


@inline
def _extent(number, low, tile, ellipse, mx, box_left, box_right, found):
    """The first and the last tile that an ellipse around mx touches in eight rows of tiles, into found [2, LANES]; 0 and -1 where there
    is none, for what spans() writes there has to lie in its arrays.

    number [1, LANES]: where the rows begin from the first one, which begins `low` from the ellipse's centre.
    """
    square, peak, a, b, c = ellipse
    low = take(number, 0, 0) + low
    high = low + (tile - 1.0)
    # the ellipse's rightmost point lies at height -peak, its leftmost at +peak; else it is at the row's edge
    y, z = min(max(peak, low), high), min(max(-peak, low), high)
    x0 = max(mx - (math.sqrt(max(square - c * y * (c * y), 0.0)) + b * y) * a - MARGIN, box_left)
    x1 = min(mx + (math.sqrt(max(square - c * z * (c * z), 0.0)) - b * z) * a + MARGIN, box_right)
    put(found, 0, 0, where(x0 <= x1, (x0 + (1.0 - ROUNDING)) * (1.0 / tile), 0.0))
    put(found, 1, 0, where(x0 <= x1, x1 * (1.0 / tile), -1.0))


@inline
def _tile(x, shift):
    """The tile of the first pixel whose centre does not lie before x >= 0."""
    return math.ceil(x) >> shift


@kernel
def begins(counts, first_tile, last_tile, starts, cursors):
    """tile_lists.tile_cursors(), in starts and cursors; those of other tiles' lists are left as they are."""
    at = 0
    for tile in range(counts.shape[1]):
        starts[tile] = at
        if first_tile <= tile < last_tile:
            for segment in range(len(counts)):
                cursors[segment, tile] = at
                at += counts[segment, tile]
    starts[counts.shape[1]] = at


@kernel
def scatter(runs, first_tile, last_tile, cursor, ids):
    """Write the splats of the runs of spans() into the lists of the tiles first_tile..last_tile; cursor [tiles]: where each goes next."""
    for k in range(len(runs)):
        for tile in range(max(runs[k, 1], first_tile), min(runs[k, 2], last_tile)):
            at = cursor[np.uintp(tile)]
            prefetch(ids, np.intp(at) + LINE)
            ids[at], cursor[np.uintp(tile)] = runs[k, 0], at + np.uint32(1)
