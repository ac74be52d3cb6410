# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of round spots at known places, and where a picture shows them: how tests check poses and lenses by projecting points."""
from __future__ import annotations

import numpy as np

from fastgs_blender.camera import Camera


def draw_spots(width: int, height: int, pixels, sigma: float = 2.5) -> np.ndarray:
    """A float32 picture [height, width] 0..1 with a Gaussian spot at each of pixels [P, 2] (centres of pixels at +0.5)."""
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    image = np.zeros((height, width))
    for u, v in np.asarray(pixels, np.float64).reshape(-1, 2):
        image += np.exp(-0.5 * ((y - v) / sigma) ** 2)[:, None] * np.exp(-0.5 * ((x - u) / sigma) ** 2)
    return np.clip(image, 0, 1).astype(np.float32)


def find_spots(image: np.ndarray, near, reach: int = 8) -> np.ndarray:
    """The spots' centres [P, 2] in image [h, w]: the centroid of what is brighter than a third of the spot's peak, around each guess."""
    found = []
    for u, v in np.asarray(near, np.float64).reshape(-1, 2):
        x0, y0 = max(int(u) - reach, 0), max(int(v) - reach, 0)
        part = np.asarray(image, np.float64)[y0:int(v) + reach + 1, x0:int(u) + reach + 1]
        weight = np.maximum(part - part.max() / 3, 0)
        x, y = np.arange(part.shape[1]) + x0 + 0.5, np.arange(part.shape[0]) + y0 + 0.5
        found.append([(weight.sum(0) * x).sum() / weight.sum(), (weight.sum(1) * y).sum() / weight.sum()])
    return np.array(found)


def project(camera: Camera, xyz) -> np.ndarray:
    """World points [P, 3] in the pixels [P, 2] of a pinhole camera."""
    p = np.asarray(xyz, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    assert (p[:, 2] > 0).all()
    return p[:, :2] / p[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
