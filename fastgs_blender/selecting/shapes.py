# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Gaussians in a shape that is drawn in the picture, or in a ball: all of them, or those that are seen."""
from dataclasses import dataclass, replace

import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at
from ..rendering.api import render
from ..rendering.instances import Instance, ViewedInstance
from ..rendering.visibility import order
from ..util.rotations import transformed
from .light import Light, small

SEEN, SHARE = 0.3, 0.1
"""A Gaussian is seen in a shape if it gives so many pixels of light there, or this share of what it would give with nothing before it."""
CORE, MIDDLE, FEW = 0.5, 0.35, 3
"""Within the first share of a brush's radius a Gaussian must give the second share of its light, or the stroke does not mean it: a hand
leads the middle of a brush along a thing, and its rim over what lies beside.  Where fewer are left, what the rim touches counts too."""


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

    @property
    def low(self) -> np.ndarray:
        """The least x and y of its pixels."""
        return np.min(self.middles, 0) - self.radius

    @property
    def high(self) -> np.ndarray:
        """Their largest x and y."""
        return np.max(self.middles, 0) + self.radius

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie under it: [M] bool."""
        pixel, path = np.asarray(pixel, np.float64), np.asarray(self.middles, np.float64)
        order = _around(pixel, self.low, self.high)
        near = pixel[order]
        inside = np.zeros(len(order), bool)
        for start, end in zip(path, path[1:] if len(path) > 1 else path, strict=False):
            low, high = np.minimum(start, end) - self.radius, np.maximum(start, end) + self.radius
            first, last = np.searchsorted(near[:, 1], (low[1], high[1]))
            x = near[first:last, 0]
            rows = first + np.flatnonzero((x >= low[0]) & (x <= high[0]) & ~inside[first:last])
            along, offset = end - start, near[rows] - start
            share = np.clip(offset @ along / max(along @ along, 1e-12), 0, 1)
            inside[rows] = ((offset - share[:, None] * along) ** 2).sum(1) <= self.radius**2
        out = np.zeros(len(pixel), bool)
        out[order] = inside
        return out


@dataclass(frozen=True)
class Lasso:
    """The inside of a line that was drawn around something: points (x, y) in pixels, the last of which is joined to the first.

    What the line encloses twice is outside, as in Blender's lassos.
    """

    points: tuple[tuple[float, float], ...]

    @property
    def low(self) -> np.ndarray:
        """The least x and y of its pixels."""
        return np.min(self.points, 0)

    @property
    def high(self) -> np.ndarray:
        """Their largest x and y."""
        return np.max(self.points, 0)

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie in it: [M] bool."""
        pixel, corners = np.asarray(pixel, np.float64), np.asarray(self.points, np.float64)
        order = _around(pixel, self.low, self.high)
        x, y = pixel[order].T
        inside = np.zeros(len(order), bool)
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0), strict=True):
            if y0 != y1:  # a side is to the right of those pixels in its height that the way to the right crosses
                rows = slice(*np.searchsorted(y, sorted((y0, y1))))
                inside[rows] ^= x[rows] < x0 + (y[rows] - y0) * (x1 - x0) / (y1 - y0)
        out = np.zeros(len(pixel), bool)
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
        depth = float(_sampled(surface, camera, np.asarray([pixel], np.float64))[0])
        if not np.isfinite(depth):
            return None
        spread = 1.0 if camera.orthographic else depth
        ray = (np.asarray(pixel) - (camera.cx, camera.cy)) / (camera.fx, camera.fy) * spread
        x, y, z = (np.linalg.pinv(camera.world_to_camera) @ [*ray, depth, 1])[:3]
        return cls((float(x), float(y), float(z)), radius * spread / abs(camera.fx))


Shape = Box | Stroke | Lasso | Ball


def seen_surface(instances: list[Instance], camera: Camera, backend: str = "auto") -> np.ndarray:
    """The depths [h, w] of what the camera sees of a scene, inf where nothing is, for Ball.on(): one for many balls.

    It is the whole image, made small: the median depth, where half of the light is stopped.
    """
    return render(instances, small(camera), passes=["median_depth"], backend=backend)["median_depth"]


def under(instance: ViewedInstance, camera: Camera, shape: Shape, backend: str = "auto") -> np.ndarray:
    """Which Gaussians the camera shows and whose centres lie in a shape, however deep: [N] bool, of the instance's source."""
    index = np.sort(order([instance], _framed(camera, shape), backend=backend))  # in memory's order they are read in half of the time
    return _as_source(instance, index[_holds(instance, camera, shape, index)])


def seen_under(instances: list[ViewedInstance], camera: Camera, shape: Shape, light: Light | None = None) -> list[np.ndarray]:
    """Of each of the instances that a camera sees together, which Gaussians under() a shape are seen there: [N] bool.

    light  theirs, for further strokes in one view; None: it is made
    """
    light, found = light or Light(instances, camera), []
    for instance, within, alone in zip(instances, light.within(_mask(shape, camera, light)), light.alone, strict=True):
        index = np.flatnonzero((within > 0) & (within >= np.minimum(SEEN, SHARE * alone)))
        found.append(_as_source(instance, index[_holds(instance, camera, shape, index)]))
    return found


def touched(instances: list[ViewedInstance], camera: Camera, shape: Shape, light: Light | None = None,
            own: float = 0.5) -> list[np.ndarray]:
    """Of each of the instances, which Gaussians make what is seen in a shape, wherever their centres are: [N] bool, for grow().

    own  least share of what the picture shows of a Gaussian that lies in the shape: what reaches far beyond it is not meant

    Of a stroke with a brush it is what makes its middle (CORE, MIDDLE).
    """
    light = light or Light(instances, camera)
    within = light.within(_mask(shape, camera, light))
    found = [(lit >= SEEN) & (lit >= own * whole) for lit, whole in zip(within, light.whole, strict=True)]
    if isinstance(shape, Stroke):
        middle = light.within(_mask(replace(shape, radius=CORE * shape.radius), camera, light))
        sure = [bits & (lit >= MIDDLE * whole) for bits, lit, whole in zip(found, middle, light.whole, strict=True)]
        found = sure if sum(map(np.count_nonzero, sure)) >= FEW else found
    return [_as_source(instance, np.flatnonzero(bits)) for instance, bits in zip(instances, found, strict=True)]


def _framed(camera: Camera, shape: Shape) -> Camera:
    """The camera of that part of the picture which a shape lies in; of a ball the whole."""
    if isinstance(shape, Ball):
        return camera
    most = camera.width - 1, camera.height - 1
    low = np.clip(np.floor(shape.low), 0, most)
    width, height = (int(n) for n in np.clip(np.ceil(shape.high), low + 1, (camera.width, camera.height)) - low)
    return replace(camera, width=width, height=height, cx=camera.cx - low[0], cy=camera.cy - low[1],
                   window=(0, 0, width, height))


def _around(pixel: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which of the pixels [M, 2] lie in a rectangle: their numbers, by their heights."""
    inside = np.flatnonzero(((pixel >= low) & (pixel <= high)).all(1))
    return inside[np.argsort(pixel[inside, 1])]


def _holds(instance: ViewedInstance, camera: Camera, shape: Shape, index: np.ndarray) -> np.ndarray:
    """Which of the Gaussians of an instance have their centres in a shape: [len(index)] bool."""
    position = positions_at(instance.model, instance.t, index)
    if isinstance(shape, Ball):
        world = transformed(position, instance.placement)
        return ((world - shape.centre) ** 2).sum(1) <= shape.radius**2
    to_camera = instance.model_to_camera
    return shape.holds(camera.pixels(transformed(position, to_camera)))


def _mask(shape: Shape, camera: Camera, light: Light) -> np.ndarray:
    """Which pixels [h, w] of the light's picture lie in a shape that is drawn in the camera's; of a ball all."""
    width, height = light.camera.width, light.camera.height
    if isinstance(shape, Ball):
        return np.ones((height, width), bool)
    x, y = np.meshgrid((np.arange(width) + 0.5) * camera.width / width, (np.arange(height) + 0.5) * camera.height / height)
    return shape.holds(np.stack([x, y], -1).reshape(-1, 2)).reshape(height, width)


def _as_source(instance: ViewedInstance, index: np.ndarray) -> np.ndarray:
    """Gaussians of an instance's model as [N] bool of its source."""
    out = np.zeros(len(instance.source), bool)
    out[index if instance.rows is None else instance.rows[index]] = True
    return out


def _sampled(surface: np.ndarray, camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """The surface's depths [M] at pixels [M, 2] of the camera's image."""
    height, width = surface.shape
    x, y = (np.clip(np.nan_to_num(pixel[:, k]) * side / full, 0, side - 1).astype(int)
            for k, side, full in ((0, width, camera.width), (1, height, camera.height)))
    return surface[y, x].astype(np.float64)
