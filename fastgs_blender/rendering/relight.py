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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..util.threads import product, run, several, taken
from .contact import contact
from .holdout import as_triangles
from .instances import Instance, ViewedInstance
from .lamps import Lamp
from .normals import smooth_normals
from .painting import bare
from .quantities import Shown
from .shading import shading_of
from .shadow_edges import Taken, on_edge
from .spots import Spots, evenly
from .unlit import captured_light
from .ways import Sides, Ways

REACH = 3.0
"""Standard deviations along a lamp's rays by which a Gaussian may lie behind another and still be lit: it is a part of the same surface."""
LEAST = np.float32(1e-30)
"""Light that is none."""
SPREAD = 4
"""Places of a Gaussian that are looked at from a lamp, all its points together."""


@dataclass(frozen=True, eq=False)
class SceneLight:
    """What lights splats.

    lamps   of the scene
    meshes  triangles [F, 3, 3] in the world that cast shadows on splats, or None
    bias    how near to a surface nothing casts shadows on it, in units of the world
    size    pixels of the longer side of the pictures from a lamp; a point with little of its light has fewer
    levels  the number of each lamp's passes, from 0; lamps may share one.  Empty: they are numbered in their order
    clear   by the names of lamps, which of the meshes' triangles let their light through: masks [F]
    reach   distance from meshes up to which they take light from all around, for the pass of contact occlusion
    moments  the meshes at times evenly spread over an exposure, which the lamps' points throw shadows of; empty: they stand still
    """

    lamps: tuple[Lamp, ...]
    meshes: np.ndarray | None = None
    bias: float = 0.02
    size: int = 1024
    levels: tuple[int, ...] = ()
    reach: float = 0.3
    clear: Mapping[str, np.ndarray] = field(default_factory=dict)
    moments: tuple[np.ndarray, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "lamps", tuple(self.lamps))
        object.__setattr__(self, "meshes", as_triangles(self.meshes))
        object.__setattr__(self, "levels", tuple(self.levels) or tuple(range(len(self.lamps))))

    def exposed(self, moments: Sequence[SceneLight], curve: Sequence[float] = (1.0,)) -> SceneLight:
        """This light while a shutter is open: lamps and meshes that move blur the shadows.

        moments  itself at times evenly spread over the exposure.  What is not the same there stands still: other lamps, other triangles
        curve    how far the shutter is open, likewise
        """
        if len(moments) < 2:
            return self
        meshes, lamps = tuple(each.meshes for each in moments if each.meshes is not None), []
        same = self.meshes is not None and all(each.shape == self.meshes.shape for each in meshes) and len(meshes) == len(moments)
        meshes = meshes if same and not all(np.array_equal(each, meshes[0]) for each in meshes) else ()
        for number, lamp in enumerate(self.lamps):
            there = [each.lamps[number] for each in moments if len(each.lamps) == len(self.lamps)]
            alike = [each for each in there if each.name == lamp.name and each.colour.shape == lamp.colour.shape]
            there = alike if len(alike) == len(moments) else [lamp] * len(moments)
            moves = meshes or not all(each.like(there[0]) for each in there)
            lamps.append(lamp.exposed(there, curve) if moves else lamp)
        return replace(self, lamps=tuple(lamps), moments=meshes)

    def lit(self, instances: Sequence[Instance], camera: Camera, backend: Any,
            progress: Callable[[float], None] = lambda share: None, passes: bool = False, still: bool = False) -> list[Instance]:
        """The instances with the colours that they have in this light before a camera, those that take none with their own.

        backend  a loaded backend (util/backends.py)
        passes   whether all of them get a Shading, too, which the passes of lamps read (shading.py)
        still    whether the picture shows them at their own time through the middle of the lens alone: Gaussians that it does not show
                 are then left out of those that take light
        """
        wanted = [number for number, each in enumerate(instances) if (passes or each.settings.takes_light) and len(each.model)]
        if not wanted:
            return list(instances)
        out = list(instances)
        viewed = {number: each.viewed(camera) for number, each in enumerate(instances) if len(each.model)}
        shows = backend.contributing(list(viewed.values()), camera) if still else [None] * len(viewed)
        shown = {number: show if instances[number].settings.takes_light else None for number, show in zip(viewed, shows, strict=True)}
        surfaces = [_Surface(viewed[number], backend, shown[number]) for number in wanted]
        casting = [each for each in instances if len(each.model) and each.settings.casts]
        arriving = self._arriving(Spots.of(surfaces), casting, backend, progress)
        ends = np.cumsum([len(each.index) for each in surfaces])[:-1]
        drops = bool((arriving[:, 1] < arriving[:, 0]).any())
        for number, surface, light in zip(wanted, surfaces, np.split(arriving, ends, axis=3)):
            whole = len(surface.index) == len(instances[number].model)
            out[number] = instances[number] if whole else instances[number].part(surface.index)
            if out[number].settings.takes_light or drops:
                out[number] = _lit(out[number], surface, light, drops, backend)
            if passes:
                near = contact(self.meshes, surface.position.T, surface.normal.T, self.reach, self.bias, backend)
                out[number] = replace(out[number], shading=shading_of(light, near))
        return out

    def _arriving(self, spots: Spots, casting: list[Instance], backend: Any, progress: Callable[[float], None]) -> np.ndarray:
        """The irradiance of the spots, by the lamps' levels [L, 4, 3, P], by channel: with nothing in the way, with meshes, with meshes and
        splats, with splats."""
        total = np.zeros((max(self.levels, default=-1) + 1, 4, 3, len(spots)), np.float32)
        once = [lamp.light.parallel for lamp in self.lamps for _ in lamp.light.points] == [True]
        scene = Ways(backend, casting, self.meshes, once, self.moments)
        for number, lamp in enumerate(self.lamps):
            def done(share: float, number: int = number) -> None:
                progress((number + share) / len(self.lamps))

            total[self.levels[number]] += self._of_lamp(lamp, spots, scene, backend, done)
        return total

    def _of_lamp(self, lamp: Lamp, spots: Spots, scene: Ways, backend: Any, progress: Callable[[float], None]) -> np.ndarray:
        """What arrives from a lamp [4, 3, P], as _arriving() says."""
        shares, lit = _shares(lamp, spots)
        spots, every = spots.part(lit), taken([shares], lit, -1)[0]
        sides = scene.of_lamp(lamp.name, self.clear.get(lamp.name)).sides(lamp.light, spots.position, spots.sizes())
        tints = lamp.colour.astype(np.float32) / len(lamp.colour)
        alike = (tints == tints[0]).all()  # what is summed is then one number for all channels
        factors = np.ones((len(tints), 1), np.float32) if alike else tints
        whole = np.zeros((factors.shape[1], len(lit)), np.float32)
        sums = np.zeros((4, *whole.shape), np.float32)
        for points, rows in spots.asking(len(tints)):
            asked = spots.part(rows)
            part = np.zeros((4, len(whole), len(rows)), np.float32)
            through = several(partial(self._through, lamp, sides, asked, backend), [(k,) for k in points])
            for k, (meshes, splats) in zip(points, through, strict=True):
                whole += factors[k][:, None] * every[k]
                arrived = factors[k][:, None] * every[k, rows]
                for row, let in zip(part, (1, meshes, meshes * splats, splats), strict=True):
                    row += arrived * let
                progress((k + 1) / len(tints))
            sums[..., rows] += part
        sums *= whole / np.maximum(sums[0], LEAST)  # spots that asked some of the points know of those which share comes through
        out = np.zeros((4, 3, shares.shape[1]), np.float32)
        out[..., lit] = sums * tints[0][:, None] if alike else sums
        return out

    def _through(self, lamp: Lamp, sides: Sides, spots: Spots, backend: Any, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Which share of the light of a lamp's point of that number comes past the meshes, and past the splats to spots: [M] each."""
        part = np.abs(lamp.colour).sum(1)
        share = part[number] / max(part.sum(), 1e-30)
        size, each = max(int(self.size * min(share**0.25, 1)), 64), max(round(SPREAD * share), 1)
        thickness, places = backend.spread(spots.position, spots.axes, lamp.light.points[number], lamp.light.parallel,
                                           evenly(number * each + np.arange(each)))
        return sides.past(number, places, size, self.bias, self.bias + REACH * thickness)


def _shares(lamp: Lamp, spots: Spots) -> tuple[np.ndarray, np.ndarray]:
    """Which share of its colour each of a lamp's points sends to spots: [L, P], and which of these it lights [R]."""
    shares, among = np.empty((len(lamp.light.points), len(spots)), np.float32), spots.lit_by(lamp.name)
    run(lambda number, row: np.multiply(lamp.share(number, spots.position, spots.normal), among, out=row), enumerate(shares))
    return shares, np.flatnonzero((shares > 0).any(0))


def _lit(instance: Instance, surface: _Surface, light: np.ndarray, drops: bool, backend: Any) -> Instance:
    """An instance with the colours that its surface has in a light [L, 4, 3, M] (SceneLight._arriving), if it takes light; drops: whether
    meshes throw shadows."""
    colours, numbers = backend.painted(surface.instance, surface.index, surface.local, light,
                                       surface.unlit(instance.settings.unlit, backend), drops)
    out = bright = instance
    if instance.settings.takes_light:
        out, *rest = (replace(instance, model=replace(instance.model, features=each, appearance=bare(instance.model.appearance)),
                              origin=instance.source, painted=True)
                      for each in colours)
        bright = rest[0] if drops else out
    if not drops:
        return out
    along = product(surface.instance.camera.world_to_camera[2, :3], surface.axes.reshape(3, -1)).reshape(3, -1)
    wide = np.sqrt((along * along).sum(0))
    return replace(out, taken=Taken(bright, numbers, surface.normal.T, wide, bool(on_edge(numbers[:, 3]).any())))


class _Surface:
    """The M Gaussians of an instance that its camera shows, as a surface in the world: arrays as Spots has them.

    index  [M] which of the model's
    shares [M] the largest share that each has of a pixel
    local  [M, 3] their places in the model's space
    """

    def __init__(self, instance: ViewedInstance, backend: Any, shows: tuple[np.ndarray, np.ndarray] | None):
        every = np.arange(len(instance.model))
        index, shares = (every, np.ones(len(every), np.float32)) if shows is None else shows
        shown, rows = Shown(instance, index, backend), np.flatnonzero(shares)
        self.instance, self.index, self.shares = instance, shown.index[rows], shares[rows]
        local, self.position, axes = taken((shown.position.T, shown.world.T, shown.axes), rows, -1)
        self.local = local.T
        self.axes = product(instance.placement[:3, :3], axes.reshape(3, -1)).reshape(axes.shape)
        self.normal = smooth_normals(shown, backend, rows).T.astype(np.float32)

    def unlit(self, share: float, backend: Any) -> np.ndarray | None:
        """Factors [M, 3] from captured colour to a mixture of it and the estimated unlit one, of which it has a share; None: 1."""
        if not share:
            return None
        normal = self.normal.T @ self.instance.placement[:3, :3]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return 1 + share * (captured_light(self.instance.source, backend).unlit(normal) - 1)
