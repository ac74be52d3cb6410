# SPDX-License-Identifier: GPL-3.0-or-later
"""Resamples pictures at a map of positions: cubic where pixels keep their size, area means where they shrink."""
from __future__ import annotations

import math

import numpy as np

from ...util.threads import ranges, run
from .. import asserts
from .jit import inline, kernel

MOST = 64
"""Samples per pixel and axis at most; a stronger shrinking skips source pixels."""


@inline
def _step(positions, row, column, down):
    """Source pixels from this output pixel to the next one, along rows or columns: (dx, dy); 0 where a neighbour has no place."""
    last = positions.shape[0] - 1 if down else positions.shape[1] - 1
    at = row if down else column
    before, after = max(at - 1, 0), min(at + 1, last)
    share = np.float32(1) / np.float32(max(after - before, 1))
    if down:
        dx = (positions[after, column, 0] - positions[before, column, 0]) * share
        dy = (positions[after, column, 1] - positions[before, column, 1]) * share
    else:
        dx = (positions[row, after, 0] - positions[row, before, 0]) * share
        dy = (positions[row, after, 1] - positions[row, before, 1]) * share
    if not (abs(dx) < 1e6 and abs(dy) < 1e6):
        return np.float32(0), np.float32(0)
    return dx, dy


@inline
def _samples(dx, dy):
    """Number of samples that a step of that length needs."""
    return min(max(int(math.sqrt(dx * dx + dy * dy) + 0.5), 1), MOST)


@inline
def _cubic(image, x, y, row, column, out):
    height, width, channels = image.shape
    x0, y0 = math.floor(x), math.floor(y)
    tx, ty = np.float32(x - x0), np.float32(y - y0)
    wx0, wx1, wx2, wx3 = _weights(tx)
    wy0, wy1, wy2, wy3 = _weights(ty)
    i, j = int(y0), int(x0)
    a, b, c, d = min(max(j - 1, 0), width - 1), min(max(j, 0), width - 1), min(max(j + 1, 0), width - 1), min(max(j + 2, 0), width - 1)
    for k in range(channels):
        total, low, high = np.float32(0), np.float32(np.inf), np.float32(-np.inf)
        for n in range(4):
            line = min(max(i - 1 + n, 0), height - 1)
            p, q = np.float32(image[line, a, k]), np.float32(image[line, b, k])
            r, s = np.float32(image[line, c, k]), np.float32(image[line, d, k])
            weight = wy0 if n == 0 else wy1 if n == 1 else wy2 if n == 2 else wy3
            total += weight * (wx0 * p + wx1 * q + wx2 * r + wx3 * s)
            low, high = min(low, p, q, r, s), max(high, p, q, r, s)
        out[row, column, k] = min(max(total, low), high)


@inline
def _weights(t):
    """Catmull-Rom's four weights at t of the way from the second to the third."""
    half = np.float32(0.5)
    s = t * t
    c = s * t
    return (half * (-t + 2 * s - c), half * (2 - 5 * s + 3 * c), half * (t + 4 * s - 3 * c), half * (c - s))


@inline
def _add_linear(image, x, y, share, row, column, out):
    height, width, channels = image.shape
    x0, y0 = math.floor(x), math.floor(y)
    tx, ty = np.float32(x - x0), np.float32(y - y0)
    i, j = min(max(int(y0), 0), height - 1), min(max(int(x0), 0), width - 1)
    i1, j1 = min(max(int(y0) + 1, 0), height - 1), min(max(int(x0) + 1, 0), width - 1)
    one = np.float32(1)
    for k in range(channels):
        upper = (one - tx) * np.float32(image[i, j, k]) + tx * np.float32(image[i, j1, k])
        lower = (one - tx) * np.float32(image[i1, j, k]) + tx * np.float32(image[i1, j1, k])
        out[row, column, k] += share * ((one - ty) * upper + ty * lower)


@kernel
def resample_rows(image, positions, first, last, out):
    """Fill the rows first..last of out [h, w, C] float32, zeroed, with image [H, W, C] at positions [h, w, 2] (centres at +0.5).

    Positions outside the image, and NaN, leave 0.
    """
    height, width = image.shape[:2]
    for row in range(first, last):
        for column in range(positions.shape[1]):
            x, y = positions[row, column, 0], positions[row, column, 1]
            if not (x >= 0 and y >= 0 and x <= width and y <= height):
                continue
            ax, ay = _step(positions, row, column, False)
            bx, by = _step(positions, row, column, True)
            across, down = _samples(ax, ay), _samples(bx, by)
            x, y = x - np.float32(0.5), y - np.float32(0.5)
            if across == 1 and down == 1:
                _cubic(image, x, y, row, column, out)
                continue
            share = np.float32(1.0 / (across * down))
            for m in range(down):
                v = np.float32((m + 0.5) / down - 0.5)
                for n in range(across):
                    u = np.float32((n + 0.5) / across - 0.5)
                    _add_linear(image, x + u * ax + v * bx, y + u * ay + v * by, share, row, column, out)


def resample(image: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """TrainingBackend.resample()."""
    asserts.resample(image, positions)
    out = np.zeros((*positions.shape[:2], image.shape[2]), np.float32)
    run(lambda first, last: resample_rows(image, positions, first, last, out), ranges(len(positions), 32))
    return out
