# SPDX-License-Identifier: GPL-3.0-or-later
"""Random cameras and hostile sizes, for comparing the kernels with the oracle."""
from __future__ import annotations

import numpy as np

import fastgs_blender as fg
from fastgs_blender.util import rotations


def random_pose(rng: np.random.Generator, distance: float) -> np.ndarray:
    """World-to-camera [4, 4]: a random rotation, the origin `distance` in front of the camera and a little off axis."""
    pose = np.eye(4)
    pose[:3, :3] = rotations.to_matrices(rotations.unit(rng.normal(size=(1, 4))))[0]
    pose[:3, 3] = rng.normal(0, 0.3, 3) + (0, 0, distance)
    return pose


def random_camera(rng: np.random.Generator, width: int = 48, height: int = 40, distance: float | None = None) -> fg.Camera:
    """Wide and long lenses, off-centre principal points, unequal focal lengths, one in three orthographic."""
    distance = rng.uniform(0.0, 5.0) if distance is None else distance
    orthographic = rng.random() < 0.33
    focal = width * (10 ** rng.uniform(-1.3, -0.2) if orthographic else 10 ** rng.uniform(-0.4, 0.8))
    return fg.Camera(width, height, focal, focal * rng.uniform(0.8, 1.25), width * rng.uniform(-0.3, 1.3), height * rng.uniform(-0.3, 1.3),
                     random_pose(rng, distance), orthographic=orthographic, near=rng.choice([0.0, 0.0, 0.5]))


def hostile_scales(rng: np.random.Generator, n: int) -> np.ndarray:
    """ln scale [n, 3]: ordinary, needles, discs, huge and tiny Gaussians."""
    scale = rng.normal(-2.3, 0.7, (n, 3))
    kind = rng.integers(0, 6, n)
    scale[kind == 1, 0] += rng.uniform(2, 5)
    scale[kind == 1, 1:] -= rng.uniform(2, 6)
    scale[kind == 2, 2] -= 6
    scale[kind == 3] += 4
    scale[kind == 4] -= 6
    return scale
