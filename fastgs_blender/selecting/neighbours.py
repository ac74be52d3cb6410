# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest neighbours of points in any number of dimensions, by several rotated k-d trees."""
import numpy as np

from ..util.backends import load_backend

LEAF = 96
"""Points among which nearest neighbours are looked for."""
TREES = 3


def nearest(points: np.ndarray, count: int, seed: int = 0, trees: int = TREES, leaf: int = LEAF) -> tuple[np.ndarray, np.ndarray]:
    """The `count` nearest of each point of points [P, D]: their numbers [P, count] int32 and squared distances float32, the nearest first.

    A neighbour beyond the border of a leaf of one tree is found in another, or a slightly farther one is taken instead.  Where a point has
    no further neighbour, the number is -1 and the distance inf.
    """
    points = np.asarray(points, np.float64)
    points = points - (points.mean(0) if len(points) else 0)  # so that float32 is enough
    turns = [np.linalg.qr(np.random.default_rng([seed, 2, tree]).normal(size=(points.shape[1],) * 2))[0]
             for tree in range(1 if len(points) <= leaf else trees)]
    return load_backend("cpu").nearest(points, turns, min(count, leaf // 2 - 1), leaf)
