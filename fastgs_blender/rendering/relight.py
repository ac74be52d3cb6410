# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene light: lamps and shadows on splats.

A capture's colours are what its cameras saw, light included.  So light is a factor on them, one for each Gaussian and channel:

    gain = captured (1 - s (1 - m)) + lamps (1 - u + u a) E / pi,     E = mean of irradiance x (1 - s (1 - v))

captured, lamps, s   the object's settings: how much of the captured light stays, how much lamps add, and how dark shadows are
u, a                 how much of the estimated unlit colour lamps light in place of the captured one, and the factor to it (unlit.py)
m                    which share of the lamps' light meshes let through; what the capture has of its own shadows is in its colours
v                    which share meshes and splats let through

The factor is on scene-linear colour.  It is put into the Gaussians' own colours, as seen from the camera, before they are blended: so every
backend, pass and exposure has it, and nothing is random.  Shadows are looked up from points of each lamp (ways.py).
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from .contact import contact
from .exposure import PLASTIC
from .holdout import as_triangles
from .instances import Instance, ViewedInstance
from .lamps import Lamp
from .normals import smooth_normals
from .painting import painted
from .quantities import Shown
from .shading import shading_of
from .unlit import captured_light
from .ways import Side, Ways

REACH = 3.0
"""Standard deviations along a lamp's rays by which a Gaussian may lie behind another and still be lit: it is a part of the same surface."""
SPREAD = 4
"""Places of a Gaussian that are looked at from a lamp, all its points together."""


@dataclass(frozen=True, eq=False)
class SceneLight:
    """What lights splats.

    lamps   of the scene, each with the names of the instances that it lights; None: all
    meshes  triangles [F, 3, 3] in the world that cast shadows on splats, or None
    bias    how near to a surface nothing casts shadows on it, in units of the world
    size    pixels of the longer side of the pictures from a lamp, which its blur is measured in; a point with little of its light has fewer
    levels  the number of each lamp's passes, from 0; lamps may share one.  Empty: they are numbered in their order
    reach   distance from meshes up to which they take light from all around, for the pass of contact occlusion
    """

    lamps: tuple[tuple[Lamp, frozenset[str] | None], ...]
    meshes: np.ndarray | None = None
    bias: float = 0.02
    size: int = 1024
    levels: tuple[int, ...] = ()
    reach: float = 0.3

    def __post_init__(self) -> None:
        object.__setattr__(self, "lamps", tuple(self.lamps))
        object.__setattr__(self, "meshes", as_triangles(self.meshes))
        object.__setattr__(self, "levels", tuple(self.levels) or tuple(range(len(self.lamps))))

    def lit(self, instances: Sequence[Instance], camera: Camera, backend: Any,
            progress: Callable[[float], None] = lambda share: None, passes: bool = False) -> list[Instance]:
        """The instances with the colours that they have in this light before a camera; those that take none are as they were.

        backend  a loaded backend (util/backends.py)
        passes   whether all of them get a Shading, too, which the passes of lamps read (shading.py)
        """
        wanted = [number for number, each in enumerate(instances) if (passes or each.settings.takes_light) and len(each.model)]
        if not wanted:
            return list(instances)
        out = list(instances)
        surfaces = [_Surface(instances[number].viewed(camera), backend) for number in wanted]
        casting = [each for each in instances if len(each.model) and each.settings.casts]
        arriving = self._arriving(_Spots(surfaces), casting, backend, progress)
        ends = np.cumsum([len(each.index) for each in surfaces])[:-1]
        for number, surface, light in zip(wanted, surfaces, np.split(arriving, ends, axis=2)):
            settings = instances[number].settings
            if settings.takes_light:
                bare, meshes, all_ = light.sum(0)
                past = np.divide(meshes, bare, out=np.ones_like(bare), where=bare > 1e-12)
                captured = settings.captured_light * (1 - settings.shadows * (1 - past))
                lamps = settings.lamp_light / np.pi * (bare - settings.shadows * (bare - all_))
                gain = captured + lamps * surface.unlit(settings.unlit, backend)
                out[number] = painted(instances[number], surface.instance, surface.index, gain, surface.local)
            if passes:
                near = contact(self.meshes, surface.position, surface.normal, self.reach, self.bias, backend)
                out[number] = replace(out[number], shading=shading_of(len(instances[number].model), surface.index, light, near))
        return out

    def _arriving(self, spots: _Spots, casting: list[Instance], backend: Any, progress: Callable[[float], None]) -> np.ndarray:
        """The irradiance of the spots, by the lamps' levels [L, 3, P, 3]: with nothing in the way, with meshes, with meshes and splats."""
        total = np.zeros((max(self.levels, default=-1) + 1, 3, len(spots.position), 3))
        ways = Ways(backend, casting, self.meshes)
        for number, (lamp, lights) in enumerate(self.lamps):
            count = len(lamp.light.points)
            shares = np.stack([lamp.share(k, spots.position, spots.normal) for k in range(count)]) * spots.among(lights) / count
            rows = np.flatnonzero(shares.any(0))
            sides = [replace(side, rows=rows[side.rows]) for side in ways.sides(lamp.light, spots.position[rows])]
            for k, share in enumerate(shares):
                bare, *blocked = total[self.levels[number]]
                bare += np.outer(share, lamp.colour[k])
                past = [share.copy(), share]
                for side in sides:
                    for factor, through in zip(past, self._through(ways, lamp, k, side, spots), strict=True):
                        factor[side.rows] *= through
                for sums, factor in zip(blocked, past, strict=True):
                    sums += np.outer(factor, lamp.colour[k])
                progress((number + (k + 1) / count) / len(self.lamps))
        return total

    def _through(self, ways: Ways, lamp: Lamp, number: int, side: Side, spots: _Spots) -> tuple[np.ndarray, np.ndarray]:
        """Which share of the light of a lamp's point comes past the meshes, and past all, to a side's spots: [M] each."""
        light, rows, part = lamp.light, side.rows, np.abs(lamp.colour).sum(1)
        share = part[number] / max(part.sum(), 1e-30)
        towards = np.broadcast_to(light.points[number], (len(rows), 3)) if light.parallel else light.points[number] - spots.position[rows]
        over, size = self.bias + REACH * spots.thickness(rows, towards), max(int(self.size * min(share**0.25, 1)), 64)
        meshes, splats = ways.past(light, number, side, spots.spread(rows, number, share), size, self.bias, over)
        return meshes, meshes * splats


class _Spots:
    """The Gaussians of some surfaces as spots that light falls on: position, normal and axes, as _Surface has them."""

    def __init__(self, surfaces: list[_Surface]):
        self.position, self.normal, self.axes = (np.concatenate([getattr(each, name) for each in surfaces]) for name in
                                                 ("position", "normal", "axes"))
        self._names = np.repeat([each.instance.name for each in surfaces], [len(each.index) for each in surfaces])
        square = (self.axes * self.axes).sum(1)
        self._inverse = self.axes / np.maximum(square, 1e-30)[:, None]
        order = square.argsort(1)
        self._wide = np.take_along_axis(self.axes, order[:, None, 1:], 2)

    def among(self, names: frozenset[str] | None) -> np.ndarray:
        """Which spots are of instances with these names [P] bool; None: all."""
        return np.ones(len(self.position), bool) if names is None else np.isin(self._names, list(names))

    def thickness(self, rows: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """The standard deviation [M] of the spots `rows` along lines through their middles with directions [M, 3]."""
        along = np.einsum("mkj,mk->mj", self._inverse[rows], towards)
        return np.linalg.norm(towards, axis=1) / np.maximum(np.linalg.norm(along, axis=1), 1e-30)

    def spread(self, rows: np.ndarray, number: int, share: float) -> np.ndarray:
        """Places [S, M, 3] all over the spots `rows`, from which the point `number` of a lamp is looked at: if much of its light, a share,
        comes from there several, so that a shadow's edge crosses a spot little by little."""
        each = max(round(SPREAD * share), 1)
        k = number * each + np.arange(each)
        radius, turn = np.sqrt(k / PLASTIC % 1), 2 * np.pi * (k / PLASTIC**2 % 1)
        u, v = (radius * side(turn) for side in (np.cos, np.sin))
        wide = self._wide[rows]
        return self.position[rows] + u[:, None, None] * wide[..., 0] + v[:, None, None] * wide[..., 1]


class _Surface:
    """The Gaussians of an instance that its camera shows, as a surface in the world.

    index     [M]     which of the model's
    local     [M, 3]  their places in the model's space
    position  [M, 3]
    normal    [M, 3]  unit vectors, turned to the camera, smooth (normals.py)
    axes      [M, 3, 3]  as columns, each as long as its standard deviation
    """

    def __init__(self, instance: ViewedInstance, backend: Any):
        self.instance = instance
        self.index = np.sort(backend.front_to_back([instance], instance.camera)).astype(np.int64)
        shown = Shown(instance, self.index)
        self.local, self.position, self.axes = shown.position, shown.world, shown.spread
        self.normal = smooth_normals(shown, backend)

    def unlit(self, share: float, backend: Any) -> np.ndarray:
        """Factors [M, 3] from captured colour to a mixture of it and the estimated unlit one."""
        if not share:
            return np.ones((len(self.index), 3))
        normal = self.normal @ self.instance.placement[:3, :3]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return 1 + share * (captured_light(self.instance.source, backend).unlit(normal) - 1)
