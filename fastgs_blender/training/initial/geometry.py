# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels and world points of pinhole cameras, for what comes before training."""
from __future__ import annotations

import numpy as np

from ...kernels.cpu.jit import kernel


def project(camera, xyz) -> tuple[np.ndarray, np.ndarray]:
    """Pixels [n, 2] and depths [n] of world points [n, 3]."""
    places, depths = np.empty((len(xyz), 2)), np.empty(len(xyz))
    lens = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    projected(np.asarray(xyz, np.float64), np.asarray(camera.world_to_camera, np.float64), *lens, places, depths)
    return places, depths


@kernel
def projected(xyz, matrix, fx, fy, cx, cy, places, depths):
    """project() of points [n, 3] by a world-to-camera matrix, into places [n, 2] and depths [n]."""
    for i in range(len(xyz)):
        x = matrix[0, 0] * xyz[i, 0] + matrix[0, 1] * xyz[i, 1] + matrix[0, 2] * xyz[i, 2] + matrix[0, 3]
        y = matrix[1, 0] * xyz[i, 0] + matrix[1, 1] * xyz[i, 1] + matrix[1, 2] * xyz[i, 2] + matrix[1, 3]
        z = matrix[2, 0] * xyz[i, 0] + matrix[2, 1] * xyz[i, 1] + matrix[2, 2] * xyz[i, 2] + matrix[2, 3]
        depths[i] = z
        if abs(z) < 1e-9:
            z = 1e-9
        places[i, 0] = fx * x / z + cx
        places[i, 1] = fy * y / z + cy


def unproject(camera, places, depth) -> np.ndarray:
    """World points [n, 3] behind pixels [n, 2] at depths [n]."""
    local = np.stack([(places[:, 0] - camera.cx) / camera.fx * depth, (places[:, 1] - camera.cy) / camera.fy * depth, depth], 1)
    return (local - camera.world_to_camera[:3, 3]) @ np.linalg.inv(camera.world_to_camera[:3, :3]).T


def visible(camera, xyz) -> np.ndarray:
    """Which world points [n] are within the picture."""
    places, depth = project(camera, xyz)
    return (depth > 0) & (places > 0).all(1) & (places < (camera.width, camera.height)).all(1)


def sample(image, places) -> np.ndarray:
    """Values [n, C] of an image [h, w, C] at the pixels nearest to places [n, 2]."""
    column, row = (np.clip(places[:, k].astype(int), 0, image.shape[1 - k] - 1) for k in (0, 1))
    return image[row, column]
