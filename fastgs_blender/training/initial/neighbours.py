# SPDX-License-Identifier: GPL-3.0-or-later
"""Distances of points to their nearest neighbours."""
import numpy as np

from ...selecting.neighbours import nearest


def neighbour_distance(xyz: np.ndarray, seed: int = 0, count: int = 3) -> np.ndarray:
    """Root mean squared distance [P] of each point of xyz [P, 3] to its `count` nearest (selecting/neighbours.py).

    Points that have none get inf.
    """
    squared = nearest(xyz, count, seed)[1].astype(np.float64)
    there = np.isfinite(squared)
    return np.sqrt(np.divide(np.where(there, squared, 0).sum(1), there.sum(1), out=np.full(len(squared), np.inf), where=there.any(1)))
