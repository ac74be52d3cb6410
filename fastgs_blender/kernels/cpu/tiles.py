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
from .simd import prefetch

MARGIN = 1e-3
"""Pixels by which an extent is widened, so that rounding never loses a pixel that the rasteriser would blend."""


AHEAD = 16
"""How many splats ahead memory is asked for: sorted by depth, they lie all over it."""


@inline
def grown(array):
    """The array twice as long.  Copied number by number: numba takes two seconds for the messages that a slice could raise."""
    larger = np.empty(2 * len(array), array.dtype)
    for k in range(len(array)):
        larger[k] = array[k]
    return larger


@kernel
def spans(first, last, order, geometry, attributes, tile_x, tile_y, columns, rows, shift, counts):
    """The runs of tiles within a row that the splats order[first:last] touch, in their order.

    The window's tiles begin at (tile_x, tile_y) of the image, columns x rows of them, of 2^shift pixels.  counts [columns * rows] counts
    the splats of each tile.  Returns (splat, first tile, tile after the last) of every run, three int32 arrays.
    """
    splat = np.empty(2 * (last - first) + 16, np.int32)
    begin, end = np.empty_like(splat), np.empty_like(splat)
    n, tile = 0, 1 << shift
    for k in range(first, last):
        i = np.intp(order[k])
        ahead = np.intp(order[min(k + AHEAD, last - 1)])
        prefetch(geometry, ahead)
        prefetch(attributes, ahead)
        mx, my = geometry[i, raster.MEAN_X], geometry[i, raster.MEAN_Y]
        rx, ry = np.float64(attributes[i, raster.RADIUS_X]), np.float64(attributes[i, raster.RADIUS_Y])
        # pixel centres lie at + 0.5
        box_top = max(math.ceil(max(my - ry, -1e9) - 0.5), tile_y * tile)
        box_bottom = min(math.floor(min(my + ry, 1e9) - 0.5), (tile_y + rows) * tile - 1)
        box_left = max(math.ceil(max(mx - rx, -1e9) - 0.5), tile_x * tile)
        box_right = min(math.floor(min(mx + rx, 1e9) - 0.5), (tile_x + columns) * tile - 1)
        if box_top > box_bottom or box_left > box_right:
            continue
        left, right = (box_left >> shift) - tile_x, (box_right >> shift) - tile_x
        top, bottom = (box_top >> shift) - tile_y, (box_bottom >> shift) - tile_y
        exact = left < right and top < bottom  # in one row or one column of tiles the box is exact already
        a, b, c, root, peak = 0.0, 0.0, 0.0, 0.0, 0.0
        if exact:
            a, b, c = geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
            reach = np.float64(attributes[i, raster.LOG2_OPACITY]) - np.float64(attributes[i, raster.LOG2_CUT])
            root = math.sqrt(reach)
            peak = b * root / (c * math.sqrt(b * b + c * c))
        for row in range(top, bottom + 1):
            if exact:
                # the ellipse's rightmost point lies at height -peak, its leftmost at +peak; else it is at the row's edge
                low = (tile_y + row) * tile + 0.5 - my
                high = low + (tile - 1)
                y = min(max(-peak, low), high)
                right_end = (math.sqrt(max(root * root - (c * y) ** 2, 0.0)) - b * y) / a
                y = min(max(peak, low), high)
                left_end = (-math.sqrt(max(root * root - (c * y) ** 2, 0.0)) - b * y) / a
                x0 = max(math.ceil(max(mx + left_end - MARGIN, -1e9) - 0.5), box_left)
                x1 = min(math.floor(min(mx + right_end + MARGIN, 1e9) - 0.5), box_right)
                if x0 > x1:
                    continue
                left, right = (x0 >> shift) - tile_x, (x1 >> shift) - tile_x
            if n == len(splat):
                splat, begin, end = grown(splat), grown(begin), grown(end)
            splat[n], begin[n], end[n] = i, row * columns + left, row * columns + right + 1
            for touched in range(begin[n], end[n]):
                counts[touched] += 1
            n += 1
    return splat[:n], begin[:n], end[:n]


@kernel
def scatter(splat, begin, end, first_tile, last_tile, cursor, ids):
    """Write the splats of spans() into the lists of the tiles first_tile..last_tile; cursor [tiles]: where each goes next."""
    for k in range(len(splat)):
        for tile in range(max(begin[k], first_tile), min(end[k], last_tile)):
            ids[cursor[tile]] = splat[k]
            cursor[tile] += 1
