# SPDX-License-Identifier: GPL-3.0-or-later
"""Large planes, such as floors and walls, and the depths of what lies on them.

A plane sweep compares windows that face the camera, and a floor that is seen at a grazing angle looks different in each of them.  So the
planes on which many points were found are swept too, in their own direction (Gallup et al. 2007): there windows lie in the surface.
"""
from collections.abc import Sequence

import numpy as np

from ..core.schedule import POINTS, generator
from . import sweep
from .features import matrix

MOST, DRAWN, POINTS_USED = 5, 400, 6000
"""Planes that are looked for; three points are drawn so often for each, of so many."""
SHARE = 0.03
"""Share of the points that a plane holds at least."""
THICK = 0.01
"""Distance from a plane within which points lie on it, and between it and the ones beside it that are swept, in the points' median
distance from their middle."""
BESIDE = 3
"""Planes to each side of a large one that are swept."""
BETTER = 0.005
"""Difference of colours by which pictures are more alike on such a plane, for it to be where the surface is."""


def large(xyz: np.ndarray, seed: int) -> np.ndarray:
    """Planes [P, 4], n . x = e as rows (n, e), on which many of the points [N, 3] lie, and those beside them (RANSAC, then least
    squares; Fischler and Bolles 1981)."""
    rng = generator(seed, POINTS, 4)
    rest = np.asarray(xyz, np.float64)[rng.permutation(len(xyz))[:POINTS_USED]]
    found: list[np.ndarray] = []
    if len(rest) < 3 / SHARE:
        return np.zeros((0, 4))
    thick, least = THICK * float(np.median(np.linalg.norm(rest - np.median(rest, 0), axis=1))), max(SHARE * len(rest), 3)
    while len(found) < MOST and len(rest) >= least:
        corners = rest[rng.integers(len(rest), size=(DRAWN, 3))]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        on = np.abs(rest @ normals.T - (normals * corners[:, 0]).sum(1)) < thick
        on = on[:, (on.sum(0) * (np.linalg.norm(normals, axis=1) > 0.5)).argmax()]
        for _ in range(3):
            if on.sum() < least:
                break
            middle = rest[on].mean(0)
            normal = np.linalg.svd(rest[on] - middle, full_matrices=False)[2][2]
            away = np.abs((rest - middle) @ normal)
            on = away < thick
        if on.sum() < least:
            break
        beside = normal @ middle + thick * np.arange(-BESIDE, BESIDE + 1)
        found.append(np.column_stack([np.tile(normal, (len(beside), 1)), beside]))
        rest = rest[away >= 3 * thick]
    return np.concatenate(found) if found else np.zeros((0, 4))


def laid(pictures: Sequence[tuple], depths: list[sweep.Depths | None], planes: np.ndarray, near: float,
         far: float, neighbours: tuple[int, float] = sweep.NEIGHBOURS) -> list[sweep.Depths | None]:
    """The depths of a moment's pictures, as sweep.swept() gives them, on the planes [P, 4] wherever pictures are clearly more alike so."""
    if not len(planes):
        return depths

    def one(k: int, others: Sequence[tuple]) -> sweep.Depths | None:
        its, camera, pose = depths[k], pictures[k][1], pictures[k][1].world_to_camera
        normals = planes[:, :3] @ pose[:3, :3].T
        away = planes[:, 3] + normals @ pose[:3, 3]
        seen = np.abs(away) > 1e-9 * far  # not edge-on
        inverse = (normals[seen] / away[seen, None]) @ np.linalg.inv(matrix(camera))
        if its is None or not len(inverse):
            return its
        cost = sweep.differences(pictures[k], others, inverse)
        best, least = cost.argmin(0), cost.min(0)
        row, column = np.indices(best.shape) + 0.5
        depth = 1 / np.maximum((inverse[best] * np.stack([column, row, np.ones_like(row)], -1)).sum(-1), 1e-12 / far)
        on = (least < its.cost - BETTER) & (near < depth) & (depth < far)
        return sweep.Depths(np.where(on, depth, its.depth), np.where(on, least, its.cost), np.where(on, 1.0, its.range))

    return sweep.for_each(pictures, near, far, one, neighbours)
