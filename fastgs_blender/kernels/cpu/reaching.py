# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians a picture may show, and which may lie before points in it, before they are projected.

Of those that a picture from a lamp shows, most stand beside all points that ask it for light, or behind them.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from ...rendering.oracle import REACH
from .jit import inline, kernel
from .lanes import put

ROUNDING = 1.001
"""Factor to the square of a reach, so that what is culled early is nothing that the window shows."""
CELLS = 64
"""Cells along a picture's longer side, about."""
FEW = 16
"""Cells up to which they are looked at one by one; what covers more is kept."""


@inline
def rows_of(view):
    """The rows of view [5, 3] as numbers: arrays would be read again after every write."""
    return ((view[0, 0], view[0, 1], view[0, 2]), (view[1, 0], view[1, 1], view[1, 2]), (view[2, 0], view[2, 1], view[2, 2]),
            (view[3, 0], view[3, 1], view[3, 2]), (view[4, 0], view[4, 1], view[4, 2]))


@inline
def in_camera(px, py, pz, row0, row1, row2, shift):
    """A position in the camera's space."""
    return (row0[0] * px + row0[1] * py + row0[2] * pz + shift[0], row1[0] * px + row1[1] * py + row1[2] * pz + shift[1],
            row2[0] * px + row2[1] * py + row2[2] * pz + shift[2])


@inline
def extent(x, y, z, largest, coarse, view, lens, bounds):
    """Where Gaussians are seen in pixels, the squares of how far they reach there at most, whatever their shape, and which reach anywhere.

    largest  standard deviation, coarse  at least the square of the coarsest pixel of the capture
    bounds   square of how many standard deviations they reach, blur, 1 / Sampling.pixel or 0, orthographic, ObjectSettings.bends
    """
    row0, row1, row2, _, _ = view
    fx, fy, cx, cy, _, _, low_x, high_x, low_y, high_y, _, _, _, _ = lens
    reach, blur, finer, orthographic, bends = bounds
    per_depth = 1.0 if orthographic else 1.0 / z
    x, y, size, pixels = x * per_depth, y * per_depth, largest * per_depth, finer * per_depth
    a02, a12 = 0.0 if orthographic else min(max(x, low_x), high_x), 0.0 if orthographic else min(max(y, low_y), high_y)
    u0, u1, u2 = row0[0] - a02 * row2[0], row0[1] - a02 * row2[1], row0[2] - a02 * row2[2]
    v0, v1, v2 = row1[0] - a12 * row2[0], row1[1] - a12 * row2[1], row1[2] - a12 * row2[2]
    size, blur = size * size, blur * max(coarse * pixels * pixels, 1.0)
    wide = reach * (fx * fx * (u0 * u0 + u1 * u1 + u2 * u2) * size + blur)
    high = reach * (fy * fy * (v0 * v0 + v1 * v1 + v2 * v2) * size + blur)
    # what is linearised nearer than at its centre is larger
    near = REACH * REACH * (row2[0] * row2[0] + row2[1] * row2[1] + row2[2] * row2[2]) * (largest * largest)
    return fx * x + cx, fy * y + cy, wide, high, z * z <= (near if bends and not orthographic else -1.0 * near)


NOWHERE = np.empty((0, 0), np.float32), 0.0, 0.0, 1.0
"""The cells of no points."""


def cells_of(window: tuple[int, int, int, int], seen: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, float, float, float]:
    """How deep points lie in a picture, by squares of a camera's window: the depth of the farthest point of each [rows, columns] float32,
    -inf where there is none; the corner of the first in pixels of the image, and cells by pixel.

    The points are those `asked` of seen [3, P], x, y and depth.  Those beside the window are in the nearest cell.
    """
    x, y, width, height = window
    side = -(-max(width, height) // CELLS)
    place = float(x), float(y), 1 / side
    return farthest(seen, asked, *place, -(-width // side), -(-height // side)), *place


@kernel
def farthest(seen, asked, x, y, per_pixel, columns, rows):
    """The depths of cells_of()."""
    out = np.full((rows, columns), -np.inf, np.float32)
    for p in asked:
        column, row = cell((seen[0, p] - x) * per_pixel, columns), cell((seen[1, p] - y) * per_pixel, rows)
        out[row, column] = max(out[row, column], float32(seen[2, p]))
    return out


@inline
def cell(at, count):
    """In which of so many cells a place in cells lies, or the nearest."""
    return int(min(at, count - 1.0)) if at > 0.0 else 0  # what is no number, too


@inline
def put_boxes(made, mx, my, wide, high, z, cells):
    """Write what before() reads of Gaussians: extent() in cells, and their depths."""
    _, x, y, per_pixel = cells
    wide, high = math.sqrt(wide), math.sqrt(high)
    put(made, 0, 0, (mx - wide - x) * per_pixel)
    put(made, 1, 0, (mx + wide - x) * per_pixel)
    put(made, 2, 0, (my - high - y) * per_pixel)
    put(made, 3, 0, (my + high - y) * per_pixel)
    put(made, 4, 0, z)


@inline
def before(made, lane, deepest):
    """Whether one of them may lie before a point."""
    rows, columns = deepest.shape
    left, right = cell(made[0, lane], columns), cell(made[1, lane], columns)
    top, bottom = cell(made[2, lane], rows), cell(made[3, lane], rows)
    if (right + 1 - left) * (bottom + 1 - top) > FEW:
        return True
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if made[4, lane] < deepest[row, column]:
                return True
    return False
