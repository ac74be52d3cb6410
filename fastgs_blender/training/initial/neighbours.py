# SPDX-License-Identifier: GPL-3.0-or-later
"""How far apart points stand: the distance to the nearest others, by k-d trees turned against each other."""
from __future__ import annotations

import numpy as np

from ...kernels.cpu.jit import kernel

LEAF = 96
"""Points among which nearest neighbours are looked for."""
TREES = 3


def neighbour_distance(xyz: np.ndarray, seed: int = 0, count: int = 3) -> np.ndarray:
    """Root mean squared distance [P] of each point of xyz [P, 3] to its `count` nearest.

    A neighbour beyond the border of a leaf of one tree is found in another, or a slightly farther one is taken instead.
    Points that have none get inf.
    """
    xyz = np.asarray(xyz, np.float64)
    best = np.full(len(xyz), np.inf)
    for tree in range(1 if len(xyz) <= LEAF else TREES):
        turn = np.linalg.qr(np.random.default_rng([seed, 2, tree]).normal(size=(3, 3)))[0]
        among_leaves(np.ascontiguousarray(xyz @ turn), min(count, LEAF // 2 - 1), best)
    return best


@kernel
def among_leaves(points, count, best):
    """Lower best [P] to the distances of points [P, 3] within the leaves of one k-d tree."""
    order = np.arange(len(points))
    near = np.empty(count)
    stack = [(0, len(points))]
    while stack:
        first, last = stack.pop()
        inside = points[order[first:last]]
        if last - first > LEAF:
            axis, widest = 0, -1.0
            for k in range(3):
                width = inside[:, k].max() - inside[:, k].min()
                if width > widest:
                    axis, widest = k, width
            order[first:last] = order[first:last][np.argsort(inside[:, axis])]
            middle = first + (last - first) // 2
            stack.append((first, middle))
            stack.append((middle, last))
            continue
        found = min(count, last - first - 1)
        if found < 1:
            continue
        for i in range(last - first):
            near[:] = np.inf
            for j in range(last - first):
                if i == j:
                    continue
                squared = 0.0
                for k in range(3):
                    squared += (inside[i, k] - inside[j, k]) ** 2
                place = count - 1
                if squared >= near[place]:
                    continue
                while place > 0 and near[place - 1] > squared:
                    near[place] = near[place - 1]
                    place -= 1
                near[place] = squared
            row = order[first + i]
            best[row] = min(best[row], np.sqrt(near[:found].mean()))
