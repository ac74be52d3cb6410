# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light from one place comes to points, in plain float64 array code; the kernels are tested against it.

The place is a camera's centre; of an orthographic camera, the plane from which its rays come.  Of the splats before a point, whose centre
and whose surface on the point's ray (oracle.plane) both lie nearer by a length of its own, it gets the product of 1 - alpha.  So a flat
Gaussian does not shade its neighbours in the same surface, however the light falls.
"""
from __future__ import annotations

from typing import Any

import numpy as np

from ..cameras.camera import Camera
from .holdout import EDGE, NEAREST, before_the_camera

BEHIND = 1e-6
"""Depth up to which points lie behind the camera: all light comes to them."""


def view_box(points: np.ndarray, view: np.ndarray, parallel: bool) -> np.ndarray:
    """PictureBackend.view_box() in NumPy."""
    seen = view[:, :3] @ points + view[:, 3:]
    if not parallel:
        seen = seen[:, seen[2] > BEHIND]
        seen[:2] /= seen[2]
    return np.stack([seen.min(1, initial=np.inf), seen.max(1, initial=-np.inf)])


def past_splats(found: list[Any], planes: slice, camera: Camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """The share [P] float32 of the light that comes past splats (oracle.Splats) to points [3, P] of the world; over [P]: the lengths."""
    pixels, depth = _seen(camera, points, over)
    out = np.ones(points.shape[1])
    x, y = (pixels - np.array([camera.width, camera.height]) / 2).T
    for splats in found:
        for i in range(len(splats.depth)):
            off = pixels - splats.mean[i]
            (_, b), (_, c) = splats.covariance[i]
            distance = (off[:, 0] - b / c * off[:, 1]) ** 2 * c / splats.determinant[i] + off[:, 1] ** 2 / c
            alpha = np.minimum(splats.alpha_max[i], splats.opacity[i] * np.exp(-0.5 * distance))
            z, along_x, along_y = splats.channels[i, planes]
            before = (splats.depth[i] < depth) & (z + along_x * x + along_y * y < depth)
            out *= np.where(before & (alpha >= splats.alpha_cut[i]), 1 - alpha, 1)
    return out.astype(np.float32)


def past_triangles(triangles: np.ndarray, camera: Camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """0 for those points [3, P] of the world before which one of the triangles [F, 3, 3] lies, by over [P], else 1: [P] float32."""
    pixels, depth = _seen(camera, points, over)
    out = np.ones(points.shape[1], np.float32)
    for corners in camera.local(triangles.astype(np.float64)):
        for part in before_the_camera(corners, max(camera.near, NEAREST)):
            to = camera.pixels(part)[None] - pixels[:, None]
            edges = [(to[:, i], to[:, j]) for i, j in ((1, 2), (2, 0), (0, 1))]
            shares = np.stack([a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1] for a, b in edges], 1)
            slack = EDGE * np.stack([np.abs(a - b).sum(1) for a, b in edges], 1)
            area = shares.sum(1)
            inside = ((shares >= -slack).all(1) | (shares <= slack).all(1)) & (area != 0)
            with np.errstate(all="ignore"):
                weight = shares / area[:, None]
                z = weight @ part[:, 2] if camera.orthographic else 1 / (weight @ (1 / part[:, 2]))
            out[inside & (z < depth)] = 0
    return out


def _seen(camera: Camera, points: np.ndarray, over: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixels [P, 2] of points, and the depths [P] before which things lie that stop light; -inf behind the camera."""
    view = camera.local(points.T)
    with np.errstate(all="ignore"):
        return camera.pixels(view), np.where(view[:, 2] > BEHIND, view[:, 2] - over, -np.inf)
