# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact occlusion: how much of the light from all around meshes keep from splats that they touch or stand close to.

From each of a few directions all around, a depth picture of the meshes says what lies before a Gaussian.  It counts the less the farther it
is, and not at all beyond a distance.  What else stands before that mesh in the same direction is not seen.
"""
from __future__ import annotations

from typing import Any

import numpy as np

from ..cameras.parallel import parallel_camera
from ..model.filmed_from import directions

DIRECTIONS = 48
PIXELS = 384
"""Of the longer side of a depth picture."""


def contact(meshes: np.ndarray | None, places: np.ndarray, normals: np.ndarray, distance: float, bias: float, backend: Any) -> np.ndarray:
    """The share of light from all around, by the cosine, that meshes leave to places [P, 3] with unit normals [P, 3]: [P], 1 is all.

    meshes    triangles [F, 3, 3] in the world, or None
    distance  beyond which a mesh takes no light
    bias      nearer than this it takes none either
    """
    out = np.ones(len(places))
    if meshes is None or not len(meshes) or not distance > 0:
        return out
    low, high = meshes.min((0, 1)) - distance, meshes.max((0, 1)) + distance
    rows = np.flatnonzero(((places > low) & (places < high)).all(1))
    if not len(rows):
        return out
    place, box = places[rows], (places[rows].min(0) - distance, places[rows].max(0) + distance)
    near = meshes[((meshes.max(1) > box[0]) & (meshes.min(1) < box[1])).all(1)]
    taken, whole = np.zeros(len(rows)), np.zeros(len(rows))
    for towards in directions(DIRECTIONS) if len(near) else ():
        share = np.maximum(normals[rows] @ towards, 0)
        whole += share
        camera = parallel_camera(towards, *box, PIXELS)
        before = camera.local(place)
        x, y = camera.pixels(before).T - 0.5
        gap = before[:, 2] - bias
        depth = backend.numpy(backend.surface(near, camera)).astype(np.float64)
        i, j = np.clip(y, 0, PIXELS - 1.001).astype(int), np.clip(x, 0, PIXELS - 1.001).astype(int)
        for row, column in ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)):  # the four pixels around
            away = gap - depth[row, column]
            weight = np.maximum(1 - np.abs(y - row), 0) * np.maximum(1 - np.abs(x - column), 0)
            taken += share * weight * np.where(away > 0, np.maximum(1 - away / distance, 0), 0)
    out[rows] = 1 - np.minimum(taken / np.maximum(whole, 1e-9), 1)
    return out
