# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers of single pixels beside those of the pixels around them (shadow_edges.py)."""
from __future__ import annotations

import numpy as np

WIDEST = 8
"""Pixels to each side over which steps of a soft shadow are smoothed, at most; a power of two."""
AROUND_ONE = 16
"""Pixels to each side of a pixel that must show one surface as well, for its own to be believed."""
FEW, ENOUGH = 0.7, 0.9
"""The shares of these at which it begins to be believed, and is."""


def believed(one: np.ndarray, pixels: tuple[np.ndarray, ...]) -> np.ndarray:
    """How far pixels [P], at these rows and columns, show one surface, where those around them do as well; one: how far each does alone."""
    if not len(one):
        return one
    at, size = _framed(pixels, AROUND_ONE)
    share, there = (_box(_totals(size, at, values), at, AROUND_ONE) for values in (one, 1.0))
    return one * np.clip((share / there - FEW) / (ENOUGH - FEW), 0, 1)


def smooth(past: np.ndarray, points: np.ndarray, pixels: tuple[np.ndarray, ...]) -> np.ndarray:
    """Shares [P, L] at pixels, without the steps that lamps of so many points [P, L] make."""
    (at, size), out = _framed(pixels, WIDEST), past.copy()
    for lamp, several in enumerate(points.T > 1.5):
        rows, radius = np.flatnonzero(several), 0
        if not len(rows):
            continue
        own, step, total = at[rows], 2.001 / points[rows, lamp], _totals(size, at, 1.0)
        low, high = (_sheet(size, at, past[:, lamp], edge).astype(np.float32) for edge in (np.inf, -np.inf))
        summed = _totals(size, at, past[:, lamp])
        while radius < WIDEST:
            radius, off = max(2 * radius, 1), max(radius, 1)
            for axis in (0, 1):
                low, high = _around(np.minimum, low, off, axis), _around(np.maximum, high, off, axis)
            differ = high.reshape(-1)[own] - low.reshape(-1)[own]
            narrow = np.flatnonzero((differ > 0) & (differ <= step))
            out[rows[narrow], lamp] = _box(summed, own[narrow], radius) / _box(total, own[narrow], radius)
    return out


def _around(choose: np.ufunc, sheet: np.ndarray, off: int, axis: int) -> np.ndarray:
    """What is chosen of each number of a sheet and those so far before and after it; its edges are wider than that."""
    out, sheet = sheet.copy(), np.moveaxis(sheet, axis, 0)
    turned = np.moveaxis(out, axis, 0)
    choose(turned[off:], sheet[:-off], out=turned[off:])
    choose(turned[:-off], sheet[off:], out=turned[:-off])
    return out


def _framed(pixels: tuple[np.ndarray, ...], edge: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Where pixels lie in a sheet that just holds them and an edge around, for _box(), and its size."""
    rows, columns = (axis - (axis.min() - edge - 1) for axis in pixels)
    size = int(rows.max()) + 1 + edge, int(columns.max()) + 1 + edge
    return rows * size[1] + columns, size


def _sheet(size: tuple[int, int], at: np.ndarray, values: np.ndarray | float, others: float = 0.0) -> np.ndarray:
    """A sheet of a size with values at the places `at`, and others."""
    sheet = np.full(size, others)
    sheet.reshape(-1)[at] = values
    return sheet


def _totals(size: tuple[int, int], at: np.ndarray, values: np.ndarray | float) -> np.ndarray:
    """The running sums of such a sheet, along both axes."""
    sheet = _sheet(size, at, values)
    return np.cumsum(np.cumsum(sheet, 0, out=sheet), 1, out=sheet)


def _box(total: np.ndarray, at: np.ndarray, radius: int) -> np.ndarray:
    """Sums over squares of pixels around those places, from a sheet's running sums."""
    width, sums = total.shape[1], total.reshape(-1)
    below, above = at + radius * width, at - (radius + 1) * width
    return sums[below + radius] - sums[above + radius] - sums[below - radius - 1] + sums[above - radius - 1]
