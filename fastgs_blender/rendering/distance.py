# SPDX-License-Identifier: GPL-3.0-or-later
"""Antialiases far views: lowers the opacity of splats that are seen from farther away than the capture's cameras saw them.

The rasteriser's blur gives every splat a smallest size of about a pixel.  Training adapts the Gaussians to that blur, at the distances of
the capture's cameras.  From k times farther away the Gaussian shrinks in the picture, but the blur does not: the splat covers too many
pixels, edges grow thick, and fine detail flickers.  Therefore its opacity, and the cut of its opacity, are multiplied by

    sqrt(det(S + b / k^2) / det(S + b)),    S: the splat's covariance without the blur b,

which is what Mip-Splatting (Yu et al. 2024) does with its two filters, for models that were trained without them.  From the places of the
capture's cameras k is at most 1 and nothing changes.  Their places count as the smallest ball around them, and their sharpness as the
shortest of their focal lengths: k is how many times larger a pixel is at the Gaussian than at the farthest point of the ball.
"""
from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..model.surroundings import Viewpoint

MARGIN = 1.01
"""How many times larger a pixel must be before anything changes: a camera's numbers are rounded on their way through files and Blender."""
STEPS = 200
"""Steps towards the centre of the ball, which is found to about one part in as many."""


@lru_cache(maxsize=64)
def camera_ball(cameras: tuple[Viewpoint, ...]) -> tuple[float, float, float, float, float]:
    """A ball that holds all cameras: its centre and its radius in the model's space, and the shortest focal length in pixels.

    The ball is the smallest but for about 1 % (Badoiu and Clarkson 2003: step towards the farthest point, each time by less).
    """
    places = np.array([camera.position for camera in cameras])
    centre = places.mean(0)
    for step in range(STEPS):
        centre = centre + (places[np.linalg.norm(places - centre, axis=1).argmax()] - centre) / (step + 2)
    radius = float(np.linalg.norm(places - centre, axis=1).max())
    return (*map(float, centre), radius, min(float(np.sqrt(camera.fx * camera.fy)) for camera in cameras))


def share(k: np.ndarray, sharp: np.ndarray, trace: np.ndarray, blur: float) -> np.ndarray:
    """What an opacity is multiplied by at k times the distance; sharp, trace: determinant and trace of the covariance without the blur."""
    small = blur / np.maximum(k, 1) ** 2
    before, after = (sharp + b * trace + b**2 for b in (small, blur))
    return np.where(k > 1, np.sqrt(np.divide(before, after, out=np.ones_like(after), where=after > 0)), 1.0)
