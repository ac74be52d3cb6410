# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of splats on meshes: how much of a light's way to each point of a surface splats leave open.

The surface that the camera's pixels see is asked, point by point, which share of the light comes past the splats (ways.py); a soft shadow
is the average over points of the light.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..cameras.camera import Camera
from ..util.errors import FastGSError
from ..util.threads import several
from .exposure import PLASTIC
from .holdout import as_triangles
from .instances import ViewedInstance
from .ways import Ways, across


@dataclass(frozen=True, eq=False)
class Light:
    """A light of equally bright points, in an order in which each run of them is spread all over it.

    points    [L, 3] in the world; of a sun unit vectors towards it
    parallel  whether it is a sun, whose rays are parallel from each of its points
    times     [L] when each of its points shines, from 0, where a shutter opens, to 1, where it closes; None: always

    Raises FastGSError for a light without points.
    """

    points: np.ndarray
    parallel: bool = False
    times: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise FastGSError(f"a light must have points of finite numbers, [L, 3], not of the shape {points.shape}.")
        object.__setattr__(self, "points", points)

    @classmethod
    def sun(cls, towards: ArrayLike, angle: float = 0.0, samples: int = 32) -> Light:
        """A sun in a direction (towards it), which is seen under an angle in radians."""
        z = np.asarray(towards, float) / max(np.linalg.norm(towards), 1e-30)
        x, y = across(z) * np.tan(min(angle, 3.0) / 2)
        points = cls.disc(z, x, y, samples if angle > 0 else 1).points
        return cls(points / np.linalg.norm(points, axis=1, keepdims=True), True)

    @classmethod
    def disc(cls, centre: ArrayLike, x: ArrayLike, y: ArrayLike, samples: int = 32) -> Light:
        """An ellipse around a centre, with the half axes x and y."""
        u, v, side = _spread(samples)
        radius, turn = side * np.sqrt(u), 2 * np.pi * v
        return cls(centre + radius * (np.cos(turn) * np.asarray(x, float) + np.sin(turn) * np.asarray(y, float)))

    @classmethod
    def ball(cls, centre: ArrayLike, radius: float, samples: int = 32) -> Light:
        """A ball around a centre: points of its surface."""
        k = mixed(samples) + 0.5
        z, turn = 1 - 2 * k / samples, np.pi * (1 + 5**0.5) * k
        flat = np.sqrt(1 - z * z)
        ball = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
        return cls(centre + radius * ball)

    @classmethod
    def rectangle(cls, centre: ArrayLike, x: ArrayLike, y: ArrayLike, samples: int = 32) -> Light:
        """A rectangle (or parallelogram) around a centre, which reaches to x and to y and as far to the other side."""
        u, v, side = _spread(samples)
        return cls(centre + side * ((2 * u - 1) * np.asarray(x, float) + (2 * v - 1) * np.asarray(y, float)))


@dataclass(frozen=True, eq=False)
class Shadow:
    """What the pass of splats' shadows depends on.

    light   Light
    meshes  triangles [F, 3, 3] in the world, on which shadows fall
    bias    how near to a surface splats cast no shadow on it, in units of the world: captured ground often lies within a mesh's own
    size    pixels of the longer side of the pictures from the light
    lamp    the name of the lamp, by which instances know that they let its light through (ObjectSettings.clear_to)
    """

    light: Light
    meshes: np.ndarray
    bias: float = 0.0
    size: int = 1024
    lamp: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", as_triangles(self.meshes))
        if self.size < 1 or not (np.isfinite(self.bias) and self.bias >= 0):
            raise FastGSError("a shadow needs a size of one pixel or more, and a bias of 0 or more.")

    def picture(self, backend: Any, instances: list[ViewedInstance], camera: Camera, progress: Callable[[float], None]) -> np.ndarray:
        """The share of the light [h, w] that splats let through to what the camera sees of the meshes; 1 where it sees none."""
        out = np.ones((camera.window[3], camera.window[2]))
        depth = backend.numpy(backend.surface(self.meshes, camera))
        seen = np.isfinite(depth)
        if not seen.any() or not instances:
            return out
        points = camera.points(np.where(seen, depth, 1))[seen].T
        total = np.zeros(points.shape[1])
        sides, count = Ways(backend, instances, None).of_lamp(self.lamp).sides(self.light, points), len(self.light.points)

        def let(number: int) -> np.ndarray:
            return sides.past(number, points[:, None], self.size, over_splats=self.bias)[1]

        for done, share in enumerate(several(let, [(number,) for number in range(count)]), 1):
            total += share
            progress(done / count)
        out[seen] = total / count
        return out


def mixed(count: int) -> np.ndarray:
    """The numbers 0..count in an order in which those of each run lie evenly among all."""
    return np.argsort(np.arange(count) / PLASTIC % 1, kind="stable")


def _spread(count: int) -> np.ndarray:
    """Points of the unit square, even for every count (Roberts' R2 sequence), each twice: for either side (1, -1) of the light's centre.
    [3, count, 1]: u, v, side; a single point is the centre."""
    k = np.arange(max(count, 1))[:, None] // 2 + 1
    side = 1.0 - 2 * (np.arange(len(k))[:, None] % 2) if len(k) > 1 else np.zeros((1, 1))
    return np.stack([(0.5 + k / PLASTIC) % 1, (0.5 + k / PLASTIC**2) % 1, side])
