# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene light: lamps and shadows on splats.

A capture's colours are what its cameras saw, light included.  So light is a factor on them, one for each Gaussian and channel:

    gain = captured (1 - s (1 - m)) + lamps E / pi,     E = mean of irradiance x (1 - s (1 - v))

captured, lamps, s   the object's settings: how much of the captured light stays, how much lamps add, and how dark shadows are
m                    which share of the lamps' light meshes let through; what the capture has of its own shadows is in its colours
v                    which share meshes and splats let through

The factor is on scene-linear colour.  It is put into the Gaussians' own colours, as seen from the camera, before they are blended: so every
backend, pass and exposure has it, and nothing is random.  Shadows are looked up in depth pictures from points of each lamp (shadow.py).
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import SH, SH_C0, Features, decode, features_at, momentary
from ..model.slicing import positions_at
from .colour import linear_to_srgb, srgb_to_linear
from .holdout import as_triangles
from .instances import Instance, ViewedInstance
from .lamps import Lamp
from .layout import Layout
from .quantities import Shown
from .shadow import Light, corners, view_from

REACH = 3.0
"""Standard deviations along a lamp's rays by which a Gaussian may lie behind what the lamp sees and still be lit: it is a part of that."""
NARROW = 0.5
"""Cosine of the angle around its middle up to which one picture is taken from a lamp; six are where it shines farther around."""
CELLS = 1 << 21
"""Cells over which normals are averaged, at the most."""
SMOOTH = 2.0
"""Edge of the cells over which normals are averaged, in median sizes of the Gaussians."""


@dataclass(frozen=True, eq=False)
class SceneLight:
    """What lights splats.

    lamps   of the scene, each with the names of the instances that it lights; None: all
    meshes  triangles [F, 3, 3] in the world that cast shadows on splats, or None
    bias    how near to a surface nothing casts shadows on it, in units of the world
    size    pixels of the longer side of the pictures from a lamp; of one with many points each has fewer
    """

    lamps: tuple[tuple[Lamp, frozenset[str] | None], ...]
    meshes: np.ndarray | None = None
    bias: float = 0.02
    size: int = 1024

    def __post_init__(self) -> None:
        object.__setattr__(self, "lamps", tuple(self.lamps))
        object.__setattr__(self, "meshes", as_triangles(self.meshes))

    def lit(self, instances: Sequence[Instance], camera: Camera, backend: Any,
            progress: Callable[[float], None] = lambda share: None) -> list[Instance]:
        """The instances with the colours that they have in this light before a camera; those that take none are as they were.

        backend  a loaded backend (util/backends.py)
        """
        wanted = [number for number, each in enumerate(instances) if each.settings.takes_light and len(each.model)]
        if not wanted:
            return list(instances)
        out = list(instances)
        surfaces = [_Surface(instances[number].viewed(camera), backend) for number in wanted]
        points, normal, axes = (np.concatenate([getattr(each, name) for each in surfaces]) for name in ("position", "normal", "axes"))
        casting = [each for each in instances if len(each.model)]
        names = np.repeat([each.instance.name for each in surfaces], [len(each.index) for each in surfaces])
        arriving = self._arriving(points, normal, axes, names, casting, backend, progress)
        ends = np.cumsum([len(each.index) for each in surfaces])[:-1]
        for number, surface, *light in zip(wanted, surfaces, *(np.split(each, ends) for each in arriving)):
            bare, meshes, all_ = light
            settings = instances[number].settings
            past = np.divide(meshes, bare, out=np.ones_like(bare), where=bare > 1e-12)
            captured = settings.captured_light * (1 - settings.shadows * (1 - past))
            lamps = settings.lamp_light / np.pi * (bare - settings.shadows * (bare - all_))
            out[number] = surface.painted(instances[number], captured + lamps)
        return out

    def _arriving(self, points, normal, axes, names, casting, backend, progress) -> list[np.ndarray]:
        """The irradiance [P, 3] of points [P, 3] with unit normals [P, 3]: with nothing in the way, with meshes, with meshes and splats."""
        total = [np.zeros((len(points), 3)) for _ in range(3)]
        meshes = np.zeros((0, 3)) if self.meshes is None else self.meshes.reshape(-1, 3)
        around = np.concatenate([corners(casting), meshes[np.unique([*meshes.argmin(0), *meshes.argmax(0)])] if len(meshes) else meshes])
        for number, (lamp, lights) in enumerate(self.lamps):
            count = len(lamp.light.points)
            linked = np.ones(len(points), bool) if lights is None else np.isin(names, list(lights))
            for k, place in enumerate(lamp.light.points):
                share = lamp.share(k, points, normal) * linked / count
                facing = np.flatnonzero(share)
                past_meshes, past_splats = self._through(backend, casting, around, lamp.light, place, points[facing], axes[facing])
                total[0] += np.outer(share, lamp.colour[k])
                share[facing] *= past_meshes
                total[1] += np.outer(share, lamp.colour[k])
                share[facing] *= past_splats
                total[2] += np.outer(share, lamp.colour[k])
                progress((number + (k + 1) / count) / len(self.lamps))
        return total

    def _through(self, backend, casting, around, light, place, points, axes) -> tuple[np.ndarray, np.ndarray]:
        """Which share [P] of the light from one of its points comes past the meshes, and past the splats, to points [P, 3]."""
        meshes, splats = np.ones(len(points)), np.ones(len(points))
        side = max(self.size // max(1, int(len(light.points) ** 0.25)), 64)
        for rows in _directions(light, place, points):
            eye, before = view_from(light, place, points[rows], around, side)
            if eye is None:
                continue
            at, z = eye.pixels(before) - 0.5, before[:, 2] - self.bias
            if self.meshes is not None:
                meshes[rows] = 1 - _behind(backend.numpy(backend.surface(self.meshes, eye)), None, at, z)
            if casting:
                viewed = [each.viewed(eye) for each in casting]
                buffers = backend.draw(viewed, eye, Layout(viewed, False), ("median",), lambda share: None)
                depth, alpha = backend.numpy(buffers.probes["median"]), backend.numpy(buffers.alpha)
                along = np.einsum("k,mkj->mj", eye.world_to_camera[2, :3], axes[rows])
                splats[rows] = 1 - _behind(depth, alpha, at, z - REACH * np.sqrt(np.einsum("mj,mj->m", along, along)))
        return meshes, splats


def _directions(light: Light, place: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Indices of those of the points [P, 3] that one picture from a place shows well: all of them, or those through each side of a cube."""
    if light.parallel or not len(points):
        return [np.arange(len(points))] if len(points) else []
    towards = points - place
    middle = (points.min(0) + points.max(0)) / 2 - place
    if (towards @ middle >= NARROW * np.sqrt(np.einsum("pk,pk->p", towards, towards) * (middle @ middle))).all():
        return [np.arange(len(points))]
    axis = np.abs(towards).argmax(1)
    side = 2 * axis + (towards[np.arange(len(points)), axis] > 0)
    return [np.flatnonzero(side == number) for number in np.unique(side)]


def _behind(depth: np.ndarray, alpha: np.ndarray | None, at: np.ndarray, z: np.ndarray) -> np.ndarray:
    """How much of what a depth picture [h, w] shows, of its opacity [h, w], lies before depths z [P] at pixels [P, 2]: [P], 0..1.

    Compared are the four pixels around, whose answers are mixed (percentage-closer filtering, Reeves 1987).
    """
    height, width = depth.shape
    with np.errstate(invalid="ignore"):
        x, y = np.clip(np.nan_to_num(at), 0, (width - 1.001, height - 1.001)).T
    i, j = y.astype(int), x.astype(int)
    v, u = y - i, x - j
    out = np.zeros(len(z))
    for row, column, weight in ((i, j, (1 - v) * (1 - u)), (i, j + 1, (1 - v) * u), (i + 1, j, v * (1 - u)), (i + 1, j + 1, v * u)):
        out += weight * (depth[row, column] < z) * (1.0 if alpha is None else alpha[row, column])
    return out


class _Surface:
    """The Gaussians of an instance that its camera shows, as a surface in the world.

    index     [M]     which of the model's
    position  [M, 3]
    normal    [M, 3]  unit vectors, turned to the camera, smoothed
    axes      [M, 3, 3]  as columns, each as long as its standard deviation
    """

    def __init__(self, instance: ViewedInstance, backend: Any):
        self.instance = instance
        self.index = np.sort(backend.front_to_back([instance], instance.camera)).astype(np.int64)
        shown = Shown(instance, self.index)
        self.position = shown.world
        self.axes = shown.spread
        size = np.sqrt((self.axes * self.axes).sum(1).max(1))
        self.normal = _smoothed(shown.normal, shown.facing, self.position, SMOOTH * float(np.median(size)) if len(size) else 1.0)

    def painted(self, instance: Instance, gain: np.ndarray) -> Instance:
        """The instance with its colours times gains [M, 3], scene linear, as the camera sees them."""
        viewed, model, index = self.instance, instance.model, self.index
        look = momentary(model.appearance)
        mu_tau = model.mu_tau[index].astype(np.float64)
        features = features_at(model.appearance, model.features[index], instance.t, mu_tau)
        ray = positions_at(model, instance.t, index) - viewed.camera_to_model[:3, 3]
        ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-30)
        unit = 1.0
        if isinstance(look, Features):
            now = features.copy()
            now[:, 6:9] *= (instance.t - mu_tau)[:, None]
            colour = decode(now, viewed.camera_to_model[:3, 3], ray, look)
            plain = replace(look, activation="none")
            change = _times(colour, gain, model.colour_space) - decode(now, viewed.camera_to_model[:3, 3], ray, plain)
            look = plain
        else:
            colour = look.seen(features, ray)
            change = _times(colour, gain, model.colour_space) - colour
            unit = SH_C0 if isinstance(look, SH) else 1.0
        features[:, :3] += change / unit
        every = np.zeros((len(model), features.shape[1]), np.float32)
        every[index] = features
        return replace(instance, model=replace(model, features=every, appearance=look), origin=instance.source)


def _times(colour: np.ndarray, gain: np.ndarray, space: str) -> np.ndarray:
    """Colours [M, 3] of a colour space times scene-linear gains [M, 3]."""
    return colour * gain if space == "linear" else linear_to_srgb(srgb_to_linear(np.maximum(colour, 0)) * gain)


def _smoothed(normal: np.ndarray, facing: np.ndarray, position: np.ndarray, cell: float) -> np.ndarray:
    """Unit normals [M, 3] averaged over neighbours: those in a grid of cells, mixed between the middles of the eight cells around.

    facing  [M] cosines of their angles to the camera, by which they count: which way a surface looks that is seen edge-on is not known
    """
    if not len(position):
        return normal
    low, high = np.percentile(position, (1, 99), axis=0)
    extent = np.maximum(high - low, 1e-9)
    cell = max(cell, float(np.cbrt(np.prod(extent + cell) / CELLS)))
    count = np.ceil(extent / cell).astype(np.int64) + 2
    at = np.clip((position - low) / cell + 0.5, 0, count - 1.001)  # what lies far outside joins the cells at the border
    first = at.astype(np.int64)
    share, place = at - first, first @ np.array([count[1] * count[2], count[2], 1])
    counted, total = (normal * facing[:, None]).T, np.zeros((3, int(np.prod(count))))
    corners = [(np.prod(np.where(corner, share, 1 - share), 1), place + (corner[0] * count[1] + corner[1]) * count[2] + corner[2])
               for corner in np.ndindex(2, 2, 2)]
    for weight, where in corners:
        for axis in range(3):
            total[axis] += np.bincount(where, weight * counted[axis], total.shape[1])
    mean = sum(weight * total[:, where] for weight, where in corners).T
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-30)
