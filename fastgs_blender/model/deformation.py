# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates the rotation and stretch of a deformation at each point, by least squares over the displacements of its neighbours."""
import itertools
from collections.abc import Iterator

import numpy as np

ENOUGH = 40
"""Points around one, its own and the neighbouring cells', over which a deformation counts as linear."""
LEVELS = 6
"""Of cells: where there are not enough points around, cells of twice the size are tried."""
RIGID = 3e-4
"""Where neighbours say nothing (across a surface, along a line), the map is the rotation that fits best: this much of the spread."""


def local_maps(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Linear maps [N, 3, 3] that take the surroundings of each point `before` [N, 3] to where they are `after` [N, 3].

    Least squares over the points of a cell and of its 26 neighbours, as large as it takes to hold enough of them:

        J = (C + e R) (M + e 1)^-1,    M = sum d d^T,    C = sum d' d^T

    with the points' distances d and d' from their means, the rotation R that fits C best (Kabsch), and a small e.  The identity where a
    point has no neighbours, and for points that are not finite.
    """
    maps = np.tile(np.eye(3), (len(before), 1, 1))
    good = np.flatnonzero(np.isfinite(before).all(1) & np.isfinite(after).all(1))
    if not len(good):
        return maps
    p, q = before[good].astype(np.float64), after[good].astype(np.float64)
    low, high = np.percentile(p, (2, 98), axis=0)
    size = max(float((high - low).max()), 1e-12) / np.clip(np.cbrt(len(p)), 1, 4096)
    waiting = np.arange(len(p))
    for level in range(LEVELS):
        found, done = _maps(p, q, low, size * 2**level, waiting, ENOUGH if level < LEVELS - 1 else 4)
        maps[good[waiting[done]]] = found
        waiting = waiting[~done]
        if not len(waiting):
            break
    return maps


def _maps(p: np.ndarray, q: np.ndarray, low: np.ndarray, size: float, wanted: np.ndarray, least: int) -> tuple[np.ndarray, np.ndarray]:
    """By cells of a size: (the maps at those of the points `wanted` that have `least` points around them, which these are)."""
    keys, own = _cells(p, low, size)
    count, asked = np.bincount(own, minlength=len(keys)), np.unique(own[wanted])
    asked = asked[sum(np.where(there, count[at], 0) for at, there in _around(keys, asked)) >= least]
    done = np.isin(own[wanted], asked)
    if not len(asked):
        return np.empty((0, 3, 3)), done
    middle = np.stack([np.bincount(own, column, len(keys)) for column in p.T], 1) / count[:, None]
    local = (p - middle[own]) / size  # small numbers, so that sums of squares are exact enough
    moved = (q - p) / size
    # columns: 1, p, d, p p^T, d p^T with the displacement d
    columns = np.concatenate([np.ones((len(p), 1)), local, moved, _outer(local, local), _outer(moved, local)], 1)
    sums = np.stack([np.bincount(own, column, len(keys)) for column in columns.T], 1)
    total = np.zeros((len(asked), sums.shape[1]))
    for at, there in _around(keys, asked):
        total[there] += _about(sums[at[there]], (middle[at] - middle[asked])[there] / size)
    return _fitted(total)[np.searchsorted(asked, own[wanted[done]])], done


def _around(keys: np.ndarray, cells: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each of the 27 cells at and beside some: (where it is among the filled ones, whether it is)."""
    for offset in itertools.product((-1, 0, 1), repeat=3):
        beside = keys[cells] + np.array(offset) @ _STEP
        at = np.minimum(np.searchsorted(keys, beside), len(keys) - 1)
        yield at, keys[at] == beside


_STEP = np.array([1, 1 << 21, 1 << 42])


def _cells(p: np.ndarray, low: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """(keys of the filled cells, sorted; each point's cell)."""
    place = np.clip(np.floor((p - low) / size), -2**19, 2**19).astype(np.int64) + 2**19
    keys, own = np.unique(place @ _STEP, return_inverse=True)
    return keys, own.ravel()


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), 9)


def _about(sums: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Sums of cells, their places counted from points that lie `shift` before their own."""
    n, p, d = sums[:, :1], sums[:, 1:4], sums[:, 4:7]
    pp = sums[:, 7:16] + _outer(p, shift) + _outer(shift, p) + n * _outer(shift, shift)
    return np.concatenate([n, p + n * shift, d, pp, sums[:, 16:] + _outer(d, shift)], 1)


def _fitted(sums: np.ndarray) -> np.ndarray:
    """The map [K, 3, 3] of each cell, from sums over its surroundings."""
    n = np.maximum(sums[:, :1], 1)
    p, d = sums[:, 1:4], sums[:, 4:7]
    spread = (sums[:, 7:16] - _outer(p, p) / n).reshape(-1, 3, 3)
    covariance = spread + (sums[:, 16:] - _outer(d, p) / n).reshape(-1, 3, 3)  # q = p + d
    u, _, v = np.linalg.svd(covariance)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ v))[:, None]
    turn = u @ v
    little = np.maximum(RIGID * np.trace(spread, axis1=1, axis2=2), 1e-12)[:, None, None]
    found = (covariance + little * turn) @ np.linalg.inv(spread + little * np.eye(3))
    alone = (sums[:, 0] < 4) | ~np.isfinite(found).all((1, 2))
    found[alone] = np.eye(3)
    return found
