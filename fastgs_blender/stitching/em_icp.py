# SPDX-License-Identifier: GPL-3.0-or-later
"""The coarse part of a fit: each place is drawn to all places of the other surface that are near and look alike, by how likely they are it.

As in EM-ICP (Granger and Pennec 2002), a place's partners are a cloud that shrinks; what has no partner on either side counts little.
"""
import numpy as np

from ..util.rotations import transform
from .skins import Cells, moved

COARSE = 12.0
"""Cells along a surface's spread."""
MOST = 700
"""Places of each surface."""
LAST, STEPS = 0.04, 36
"""Size of the cloud, in spreads, in the last step; and how many there are."""
COLOUR = 0.6
"""Difference of colours, in their standard deviations, that makes two places unlike."""
ALONE = 0.25
"""Likelihood that a place has no partner, by that of a surface without an edge."""


def spread(points: np.ndarray) -> float:
    """The root mean squared distance of points from their middle."""
    place = points[:, :3]
    return float(np.sqrt(((place - place.mean(0)) ** 2).sum(1).mean()))


def em_icp(start: np.ndarray, moving: np.ndarray, fixed: np.ndarray, scale: bool, first: float) -> np.ndarray:
    """The motion [4, 4] that a motion comes to, of points [P, 6] towards points [Q, 6], see skin(); first: the cloud's size in the first
    step, in spreads."""
    size = min(spread(fixed), spread(moved(moving, start)))
    edge = 2 * size / COARSE
    motion = start
    a, b = _some(Cells.of(moved(moving, start), edge)), _some(Cells.of(fixed, edge))
    y, middle = b[:, :3], b[:, :3].mean(0)
    unlike = _squares(a[:, 3:], b[:, 3:], COLOUR)
    added = np.eye(4)
    for cloud in size * np.geomspace(first, LAST, STEPS):
        x = moved(a, added)[:, :3]
        near = np.exp(-_squares(x - middle, y - middle, cloud) - unlike)
        alone = np.float32(ALONE * 2 * np.pi * (cloud / edge) ** 2 * 0.3 + 1e-9)
        one, other = (1 / np.sqrt(near.sum(axis) + alone) for axis in (1, 0))  # a pair's weight is near * one * other
        rows, columns = one * (near @ other), other * (one @ near)
        total = rows.sum()
        if total < 3:
            break
        middle_x, middle_y = rows @ x / total, columns @ y / total
        u, s, vt = np.linalg.svd((other[:, None] * (y - middle_y)).T @ (near.T @ (one[:, None] * (x - middle_x))))
        mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
        factor = (s * mirror).sum() / max((rows * ((x - middle_x) ** 2).sum(1)).sum(), 1e-30) if scale else 1.0
        turn = factor * (u * mirror) @ vt
        added = transform(turn, middle_y - turn @ middle_x) @ added
    return added @ motion


def _squares(a: np.ndarray, b: np.ndarray, unit: float) -> np.ndarray:
    """Halves of the squared distances of a [M, 3] from b [N, 3], in units: [M, N] float32."""
    a, b = ((each / (np.sqrt(2) * unit)).astype(np.float32) for each in (a, b))
    return (a * a).sum(1)[:, None] + (b * b).sum(1) - 2 * a @ b.T


def _some(cells: Cells) -> np.ndarray:
    """Places and colours [M, 6] of some cells."""
    every = np.concatenate([cells.place, cells.colour], 1)
    return every if len(every) <= MOST else every[np.random.default_rng(0).choice(len(every), MOST, replace=False)]
