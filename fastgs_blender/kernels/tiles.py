# SPDX-License-Identifier: GPL-3.0-or-later
"""Tile lists: which splats touch which 16 x 16 tile, exactly, front to back.

Splats come sorted, so a counting sort by tile that keeps their order is all it takes.  A tile is listed if the ellipse in
which alpha reaches the cut crosses the tile's pixel centres; each row of tiles gets the ellipse's exact extent there.
"""
from __future__ import annotations

import math

import numpy as np

from . import raster
from .jit import inline, kernel

TILE = raster.TILE
MARGIN = 1e-3
"""Pixels by which an extent is widened, so that rounding never loses a pixel that the rasteriser would blend."""


@inline
def _row_extent(geometry, reach, row):
    """First and last pixel (x) that the splat's ellipse covers between the first and last pixel of a row of tiles.

    geometry [5] of a splat, reach = log2(opacity / cut) > 0: the ellipse is (L11 dx + L21 dy)^2 + (L22 dy)^2 <= reach.
    """
    mx, my = geometry[raster.MEAN_X], geometry[raster.MEAN_Y]
    a, b, c = geometry[raster.L11], geometry[raster.L21], geometry[raster.L22]
    half = math.sqrt(reach) / c + MARGIN
    low, high = max(row * TILE + 0.5 - my, -half), min(row * TILE + TILE - 0.5 - my, half)
    if low > high:
        return 1.0, 0.0
    # the ellipse's rightmost point lies at height -peak, its leftmost at +peak; else the extreme is at the row's edge
    peak = b * math.sqrt(reach) / (c * math.sqrt(b * b + c * c))
    y = min(max(-peak, low), high)
    right = (math.sqrt(max(reach - (c * y) ** 2, 0.0)) - b * y) / a
    y = min(max(peak, low), high)
    left = (-math.sqrt(max(reach - (c * y) ** 2, 0.0)) - b * y) / a
    return math.ceil(mx + left - MARGIN - 0.5), math.floor(mx + right + MARGIN - 0.5)


@kernel
def visit(first, last, order, geometry, shade, tile_x, tile_y, columns, rows, row_first, row_last, cursor, ids):
    """Go through the tiles of the splats order[first:last] within rows row_first..row_last of the window's tiles.

    cursor [columns * rows] counts them; where ids is not empty, ids[cursor] is set to the splat.
    """
    writing = len(ids) > 0
    for k in range(first, last):
        i = np.intp(order[k])
        my, ry = geometry[i, raster.MEAN_Y], np.float64(shade[i, raster.RADIUS_Y])
        reach = np.float64(shade[i, raster.LOG2_OPACITY]) - np.float64(shade[i, raster.LOG2_CUT])
        top = max(math.floor((my - ry) / TILE) - tile_y, np.float64(row_first))
        bottom = min(math.floor((my + ry) / TILE) - tile_y, row_last - 1.0)
        if not (top <= bottom):
            continue
        for row in range(int(top), int(bottom) + 1):
            xl, xh = _row_extent(geometry[i], reach, row + tile_y)
            if not (xl <= xh):
                continue
            left = max(math.floor(xl / TILE) - tile_x, 0.0)
            right = min(math.floor(xh / TILE) - tile_x, columns - 1.0)
            if not (left <= right):
                continue
            for tile in range(row * columns + int(left), row * columns + int(right) + 1):
                at = cursor[tile]
                cursor[tile] = at + 1
                if writing:
                    ids[at] = i
