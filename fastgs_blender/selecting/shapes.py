# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Gaussians in a shape that is drawn in the picture, or in a ball: all of them, or those that are seen."""
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at, quaternions_at
from ..rendering.api import render
from ..rendering.instances import Instance, ViewedInstance
from ..rendering.visibility import order
from ..util import rotations
from .light import light

SIDE = 480
"""Most pixels of the longer side of the picture of depths by which it is told what is seen."""
LEAST = 0.3
"""Pixels of light below which a Gaussian is not touched."""
BEHIND = 0.005
"""A Gaussian is seen if it lies behind the surface by at most its own deviation along the view.  The surface is the deepest of the pixels
around its centre, as it may be steep, but at most this share deeper than at its centre."""


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
        out = np.zeros(len(pixel), bool)
        around = np.flatnonzero(((pixel >= corners.min(0)) & (pixel <= corners.max(0))).all(1))
        order = around[np.argsort(pixel[around, 1])]
        x, y = pixel[order].T
        inside = np.zeros(len(order), bool)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
            if y0 != y1:  # a side is to the right of those pixels in its height that the way to the right crosses
                rows = slice(*np.searchsorted(y, sorted((y0, y1))))
                inside[rows] ^= x[rows] < x0 + (y[rows] - y0) * (x1 - x0) / (y1 - y0)
        out[order] = inside
        return out


@dataclass(frozen=True)
class Ball:
    """A ball in the world: its centre and its radius."""

    centre: tuple[float, float, float]
    radius: float

    @classmethod
    def on(cls, surface: np.ndarray, camera: Camera, pixel: tuple[float, float], radius: float) -> "Ball | None":
        """The ball around what is seen at a pixel of the camera's image, which looks `radius` pixels large; None where nothing is seen."""
        depth = float(_looked_up(surface, camera, np.asarray([pixel], np.float64))[0])
        if not np.isfinite(depth):
            return None
        spread = 1.0 if camera.orthographic else depth
        ray = (np.asarray(pixel) - (camera.cx, camera.cy)) / (camera.fx, camera.fy) * spread
        x, y, z = (np.linalg.pinv(camera.world_to_camera) @ [*ray, depth, 1])[:3]
        return cls((float(x), float(y), float(z)), radius * spread / abs(camera.fx))


Shape = Box | Stroke | Lasso | Ball


def seen_surface(instances: list[Instance], camera: Camera, backend: str = "auto") -> np.ndarray:
    """The depths [h, w] of what the camera sees of a scene, inf where nothing is, for under() and Ball.on(): one for many strokes.

    It is the whole image, at most SIDE pixels large: the median depth, where half of the light is stopped.
    """
    return render(instances, _small(camera), passes=["median_depth"], backend=backend)["median_depth"]


def under(instance: ViewedInstance, camera: Camera, shape: Shape, surface: np.ndarray | None = None, backend: str = "auto") -> np.ndarray:
    """Which Gaussians the camera shows and whose centres lie in a shape: [N] bool, of the instance's source (Instance.source).

    surface  what seen_surface() gave for this camera: only those that do not lie behind it; None: however deep
    """
    index = order([instance], camera, backend=backend)
    to_camera, position = instance.model_to_camera, positions_at(instance.model, instance.t, index)
    place = position @ to_camera[:3, :3].T + to_camera[:3, 3]
    pixel = camera.pixels(place)
    if isinstance(shape, Ball):
        world = position @ instance.placement[:3, :3].T + instance.placement[:3, 3]
        inside = ((world - shape.centre) ** 2).sum(1) <= shape.radius**2
    else:
        inside = shape.holds(pixel)
    index, place, pixel = index[inside], place[inside], pixel[inside]
    if surface is not None:
        turn = rotations.to_matrices(rotations.unit(quaternions_at(instance.model, instance.t, index)))
        axes = np.einsum("k,nkj->nj", to_camera[2, :3], turn) * np.exp(instance.model.scale[index].astype(np.float64))
        padded = np.pad(surface, 1, mode="edge")
        around = np.max([padded[a:a + surface.shape[0], b:b + surface.shape[1]] for a in range(3) for b in range(3)], axis=0)
        limit = np.minimum(_looked_up(around, camera, pixel), (1 + BEHIND) * _looked_up(surface, camera, pixel))
        index = index[place[:, 2] <= limit + np.linalg.norm(axes, axis=1)]
    out = np.zeros(len(instance.source), bool)
    out[index if instance.rows is None else instance.rows[index]] = True
    return out


def touched(instance: ViewedInstance, camera: Camera, shape: Box | Stroke | Lasso, own: float = 0.5) -> np.ndarray:
    """Which Gaussians make what is seen in a shape, wherever their centres are: [N] bool of the instance's source, for grow().

    own  least share of what the picture shows of a Gaussian that lies in the shape: what reaches far beyond it is not meant
    """
    small = _small(camera)
    x, y = np.meshgrid(np.arange(small.width) + 0.5, np.arange(small.height) + 0.5)
    pixel = np.stack([x * camera.width / small.width, y * camera.height / small.height], -1)
    mask = shape.holds(pixel.reshape(-1, 2)).reshape(x.shape)
    drawn = np.flatnonzero(~instance.hidden) if len(instance.hidden) else np.arange(len(instance.model))
    within, whole = light(instance.model.take(drawn), replace(small, world_to_camera=instance.model_to_camera), instance.t, mask).T
    index = drawn[(within >= LEAST) & (within >= own * whole)]
    out = np.zeros(len(instance.source), bool)
    out[index if instance.rows is None else instance.rows[index]] = True
    return out


def _small(camera: Camera) -> Camera:
    """The camera of the whole image, at most SIDE pixels large."""
    size = min(1.0, SIDE / max(camera.width, camera.height))
    return camera.stretched(*(max(1, round(size * side)) for side in (camera.width, camera.height)))


def _looked_up(surface: np.ndarray, camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """The surface's depths [M] at pixels [M, 2] of the camera's image."""
    height, width = surface.shape
    x, y = (np.clip(np.nan_to_num(pixel[:, k]) * side / full, 0, side - 1).astype(int)
            for k, side, full in ((0, width, camera.width), (1, height, camera.height)))
    return surface[y, x].astype(np.float64)
