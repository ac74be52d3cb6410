# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Gaussians under a brush, a shape that is drawn in the picture."""
from dataclasses import dataclass

import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at
from .instances import ViewedInstance
from .visibility import order


@dataclass(frozen=True)
class Box:
    """A rectangle in the picture, from low to high, in pixels."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie in it: [M] bool."""
        return ((pixel >= self.low) & (pixel <= self.high)).all(1)


@dataclass(frozen=True)
class Stroke:
    """What a round brush went over: middles, (x, y) in pixels, between which it moved straight, and its radius."""

    middles: tuple[tuple[float, float], ...]
    radius: float

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie under it: [M] bool."""
        out = np.zeros(len(pixel), bool)
        for start, end in zip(self.middles, self.middles[1:] or self.middles, strict=False):
            along, offset = np.subtract(end, start), pixel - start
            share = np.clip(offset @ along / max(along @ along, 1e-12), 0, 1)
            out |= ((offset - share[:, None] * along) ** 2).sum(1) <= self.radius**2
        return out


@dataclass(frozen=True)
class Lasso:
    """The inside of a line that was drawn around something: points (x, y) in pixels, the last of which is joined to the first.

    What the line encloses twice is outside, as in Blender's lassos.
    """

    points: tuple[tuple[float, float], ...]

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie in it: [M] bool."""
        pixel, corners = np.asarray(pixel, np.float64), np.asarray(self.points, np.float64)
        order = np.argsort(pixel[:, 1], kind="stable")
        x, y = pixel[order].T
        inside = np.zeros(len(pixel), bool)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
            if y0 != y1:  # a side is to the right of those pixels in its height that the way to the right crosses
                rows = slice(*np.searchsorted(y, sorted((y0, y1))))
                inside[rows] ^= x[rows] < x0 + (y[rows] - y0) * (x1 - x0) / (y1 - y0)
        out = np.empty_like(inside)
        out[order] = inside
        return out


Shape = Box | Stroke | Lasso


def under(instance: ViewedInstance, camera: Camera, shape: Shape, backend: str = "auto") -> np.ndarray:
    """Indices of an instance's Gaussians that the camera shows and whose centres lie in a shape, however deep."""
    index = order([instance], camera, backend=backend)
    to_camera = instance.model_to_camera
    pixel = camera.pixels(positions_at(instance.model, instance.t, index) @ to_camera[:3, :3].T + to_camera[:3, 3])
    return np.sort(index[shape.holds(pixel)])
