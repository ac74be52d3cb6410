# SPDX-License-Identifier: GPL-3.0-or-later
"""Distances of points to their nearest neighbours, by several rotated k-d trees."""
import numpy as np

from ...util.backends import load_backend

LEAF = 96
"""Points among which nearest neighbours are looked for."""
TREES = 3


def neighbour_distance(xyz: np.ndarray, seed: int = 0, count: int = 3) -> np.ndarray:
    """Root mean squared distance [P] of each point of xyz [P, 3] to its `count` nearest.

    A neighbour beyond the border of a leaf of one tree is found in another, or a slightly farther one is taken instead.
    Points that have none get inf.
    """
    xyz = np.asarray(xyz, np.float64)
    trees = range(1 if len(xyz) <= LEAF else TREES)
    turns = [np.linalg.qr(np.random.default_rng([seed, 2, tree]).normal(size=(3, 3)))[0] for tree in trees]
    return load_backend("cpu").neighbour_distance(xyz, turns, min(count, LEAF // 2 - 1), LEAF)
