# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of splats on meshes: how much of a light's way to each point of a surface splats leave open.

From a point of the light, the meshes are a holdout: the light that they stop there is what the splats before them let through.  So a
shadow is a picture of that, looked up where the camera's pixels see the surface; a soft one is the average over points of the light.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..util.errors import FastGSError
from .exposure import PLASTIC
from .holdout import as_triangles
from .instances import Instance, ViewedInstance
from .layout import Layout
from .lookup import between_pixels

WIDEST = 8.0
"""Tangent up to which a picture from a point of the light reaches to each side."""


@dataclass(frozen=True, eq=False)
class Light:
    """A light of equally bright points.

    points    [L, 3] in the world; of a sun unit vectors towards it
    parallel  whether it is a sun, whose rays are parallel from each of its points

    Raises FastGSError for a light without points.
    """

    points: np.ndarray
    parallel: bool = False

    def __post_init__(self) -> None:
        points = np.asarray(self.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise FastGSError(f"a light must have points of finite numbers, [L, 3], not of the shape {points.shape}.")
        object.__setattr__(self, "points", points)

    @classmethod
    def sun(cls, towards, angle: float = 0.0, samples: int = 32) -> Light:
        """A sun in a direction (towards it), which is seen under an angle in radians."""
        z = np.asarray(towards, float) / max(np.linalg.norm(towards), 1e-30)
        x, y = _across(z) * np.tan(min(angle, 3.0) / 2)
        points = cls.disc(z, x, y, samples if angle > 0 else 1).points
        return cls(points / np.linalg.norm(points, axis=1, keepdims=True), True)

    @classmethod
    def disc(cls, centre, x, y, samples: int = 32) -> Light:
        """An ellipse around a centre, with the half axes x and y."""
        u, v, side = _spread(samples)
        radius, turn = side * np.sqrt(u), 2 * np.pi * v
        return cls(centre + radius * (np.cos(turn) * np.asarray(x, float) + np.sin(turn) * np.asarray(y, float)))

    @classmethod
    def ball(cls, centre, radius: float, samples: int = 32) -> Light:
        """A ball around a centre: points of its surface."""
        k = np.arange(samples) + 0.5
        z, turn = 1 - 2 * k / samples, np.pi * (1 + 5**0.5) * k
        flat = np.sqrt(1 - z * z)
        ball = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
        return cls(centre + radius * ball)

    @classmethod
    def rectangle(cls, centre, x, y, samples: int = 32) -> Light:
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
    """

    light: Light
    meshes: np.ndarray
    bias: float = 0.0
    size: int = 1024

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
        points = camera.points(np.where(seen, depth, 1))[seen]
        total = np.zeros(len(points))
        for i, place in enumerate(self.light.points):
            total += self._through(backend, instances, points, place)
            progress((i + 1) / len(self.light.points))
        out[seen] = total / len(self.light.points)
        return out

    def _through(self, backend, instances, points, place) -> np.ndarray:
        """Which share [P] of the light from one of its points arrives at points [P, 3]."""
        eye, before = view_from(self.light, place, points, corners(instances), self.size)
        if eye is None:
            return np.ones(len(points))
        towards = place if self.light.parallel else place - self.meshes
        towards = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-30)
        nearer = (self.meshes + self.bias * towards).astype(np.float32)
        viewed = [instance.viewed(eye) for instance in instances]
        buffers = backend.draw(viewed, eye, Layout(viewed, False, plane=True), (), lambda fraction: None, holdout=nearer)
        x, y = eye.pixels(before).T - 0.5
        with np.errstate(invalid="ignore"):
            there = (x > -1) & (y > -1) & (x < eye.width) & (y < eye.height)
        x, y = np.where(there, x, 0), np.where(there, y, 0)
        held, covered = (between_pixels(backend.numpy(image), x, y) for image in (buffers.held, buffers.covered))
        return np.where(there & (covered > 0), held / np.maximum(covered, 1e-6), 1)


def view_from(light: Light, place: np.ndarray, points: np.ndarray, around: np.ndarray,
              size: int) -> tuple[Camera | None, np.ndarray]:
    """The camera at a point of a light that sees all points [P, 3], None where they all lie behind it; the points in its axes.

    around  [Q, 3] points around what may throw shadows on them: the rays of a sun begin before these
    size    pixels of the picture's longer side
    """
    middle = (points.min(0) + points.max(0)) / 2
    forward = -place if light.parallel else middle - place
    forward = forward / max(np.linalg.norm(forward), 1e-30)
    right, down = _across(forward)
    axes = np.stack([right, down, forward])
    if light.parallel:  # from before everything
        reach = np.concatenate([points, around])
        place = middle - 4 * np.linalg.norm(reach - middle, axis=1).max() * forward
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ place
    before = (points - place) @ axes.T
    front = before[before[:, 2] > 1e-6]
    if not len(front):
        return None, before
    flat = front[:, :2] if light.parallel else np.clip(front[:, :2] / front[:, 2:], -WIDEST, WIDEST)
    low, high = flat.min(0), flat.max(0)
    focal = size / max((high - low).max(), 1e-9 * max(np.abs(flat).max(), 1))
    width, height = np.ceil((high - low) * focal).astype(int) + 3
    cx, cy = 1.5 - low * focal
    return Camera(int(width), int(height), focal, focal, cx, cy, pose, orthographic=light.parallel, near=0.0), before


def _spread(count: int) -> np.ndarray:
    """Points of the unit square, even for every count (Roberts' R2 sequence), each twice: for either side (1, -1) of the light's centre.
    [3, count, 1]: u, v, side; a single point is the centre."""
    k = np.arange(max(count, 1))[:, None] // 2 + 1
    side = 1.0 - 2 * (np.arange(len(k))[:, None] % 2) if len(k) > 1 else np.zeros((1, 1))
    return np.stack([(0.5 + k / PLASTIC) % 1, (0.5 + k / PLASTIC**2) % 1, side])


def _across(direction: np.ndarray) -> np.ndarray:
    """Two unit vectors [2, 3] that make a right-handed system with a unit vector."""
    first = np.cross(np.eye(3)[np.abs(direction).argmin()], direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def corners(instances: Sequence[Instance]) -> np.ndarray:
    """The corners [8 K, 3] of the boxes around the Gaussians of K instances, twice as large for their motion, in the world."""
    found = [np.zeros((0, 3))]
    for instance in instances:
        low, high = (bound.astype(np.float64) for bound in (instance.model.position.min(0), instance.model.position.max(0)))
        middle, half = (low + high) / 2, high - low
        found.append((middle + _SIGNS * half) @ instance.placement[:3, :3].T + instance.placement[:3, 3])
    return np.concatenate(found)


_SIGNS = np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3)
