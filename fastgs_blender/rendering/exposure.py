# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures: pictures that are averages, over the time in which a shutter is open and over the points of a lens.

An exposure is a set of samples.  Each sample is a picture that render() makes, at one time and through one point of the lens; the result is
their average in linear light.  With more samples it converges to the average over all times and all points.
"""
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.chapters import one_clip
from ..model.edits import mixed
from ..model.slicing import slice_model, still
from ..util.errors import FastGSError
from . import colour
from .crops import crops_between
from .holdout import between
from .instances import Instance, Moment, ViewedInstance

PLASTIC = 1.32471795724474602596
"""The real root of x^3 = x + 1, which the R2 sequence is made of."""


@dataclass(frozen=True)
class Aperture:
    """The opening of a lens.

    radius    of it, in units of the world
    distance  along the view axis at which everything is sharp
    blades    edges of the opening, 0 for a round one; rotation of these, in radians
    ratio     height over width of the opening (Blender: 2 is an anamorphic lens)
    samples   points of the lens through which the scene is seen at the most; a power of two, and one more, is used

    Example:
        lens = fg.Aperture(radius=0.02, distance=3.0, samples=4)
    """

    radius: float
    distance: float
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0
    samples: int = 64

    def points(self, count: int) -> np.ndarray:
        """The first points [count, 2] of a sequence over the opening, in units of the world; any beginning of it is spread evenly.

        Eight points at a time have the opening's middle and extent: at the radii sqrt(u) and sqrt(1 - u), four quarters of a turn
        apart, with u and the turn from Roberts' R2 sequence.  Polygons are filled by triangles, equal areas by equal shares.
        """
        k = np.arange(1, -(-count // 8) + 1)[:, None]
        u, v = (0.5 + k / PLASTIC) % 1, (0.5 + k / PLASTIC**2) % 1 / 4
        r = np.sqrt(np.where([False, False, True, True, False, False, True, True], 1 - u, u)).ravel()[:count]
        turn = ((v + np.array([0, 2, 1, 3, 1, 3, 0, 2]) / 4) % 1).ravel()[:count]
        if self.blades >= 3:
            half = np.pi / self.blades
            edge = turn * self.blades
            middle, side = (2 * np.floor(edge) + 1) * half + self.rotation, np.sin(half) * (2 * (edge % 1) - 1)
            xy = np.stack([np.cos(half) * np.cos(middle) - side * np.sin(middle), np.cos(half) * np.sin(middle) + side * np.cos(middle)], 1)
        else:
            xy = np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], 1)
        return r[:, None] * xy * (self.radius / self.ratio, self.radius)

    def through(self, camera: Camera, point: tuple[float, float]) -> Camera:
        """The pinhole camera at a point of the lens: what lies in the plane of focus stays where it is."""
        x, y = point
        shift = np.eye(4)
        shift[:2, 3] = -x, -y
        if camera.orthographic:
            shift[:2, 2] = x / self.distance, y / self.distance
            return replace(camera, world_to_camera=shift @ camera.world_to_camera)
        return replace(camera, world_to_camera=shift @ camera.world_to_camera,
                       cx=camera.cx + camera.fx * x / self.distance, cy=camera.cy + camera.fy * y / self.distance)


@dataclass(frozen=True)
class Sample:
    """One picture of an exposure.

    level    from which on it is used
    time     from 0, where the shutter opens, to 1, where it closes
    point    of the lens, in units of the world
    weights  its share of the light where all samples up to a level are used, by that level
    """

    level: int
    time: float
    point: tuple[float, float]
    weights: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Exposure:
    """How long, and through which lens, a picture is taken.

    open, close  when the shutter opens and closes, in frames of each model's clip from the picture's own time
    moments      the scene evenly spread from open to close, both included; none: only the models' time moves, nothing else
    curve        how far the shutter is open, evenly spread from open to close
    steps        into which the time is divided at the most; a power of two is used
    aperture     the lens, or None for a pinhole

    Example:
        picture = fg.render(model, camera, 0.5, exposure=fg.Exposure(-0.25, 0.25, steps=4))
    """

    open: float = 0.0
    close: float = 0.0
    moments: tuple[Moment, ...] = ()
    curve: tuple[float, ...] = (1.0,)
    steps: int = 32
    aperture: Aperture | None = None

    def __post_init__(self) -> None:
        if self.steps < 1 or (self.aperture and self.aperture.samples < 1):
            raise FastGSError("an exposure needs at least one step and one sample of the lens.")
        if not (np.isfinite(self.curve).all() and min(self.curve) >= 0 and max(self.curve) > 0):
            raise FastGSError("a shutter's curve must have numbers from 0 up, and not only zeros.")

    @property
    def moves(self) -> bool:
        """Whether the shutter stays open for any time at all."""
        return self.close > self.open or len(self.moments) > 1

    @property
    def levels(self) -> int:
        """The highest level of samples: 2^levels + 1 is the largest number of them."""
        most = max(self.steps if self.moves else 1, self.aperture.samples if self.aperture else 1)
        return int(np.log2(most))

    def samples(self, levels: int) -> list[Sample]:
        """The samples of levels 0 to `levels`: the middle of time and lens, then those that divide the exposure in 2, 4, 8 ... parts.

        Times of a level are those of lower ones and those halfway between, so a part of a picture in which little moves can do with
        the first levels.  The points of a lens that is no pinhole follow its sequence, from level 1 on.
        """
        count = 1 << levels
        found = [Sample(0, 0.5, (0.0, 0.0), (1.0, *([0.0] * levels)))]
        order = [(level, node) for level in range(1, levels + 1) for node in self._nodes(level, levels)]
        points = self.aperture.points(len(order)) if self.aperture else np.zeros((len(order), 2))
        for (level, node), point in zip(order, points, strict=True):
            weights = tuple(self._weight(node, count, each) if each >= level else 0.0 for each in range(levels + 1))
            if self.moves and not self.aperture and 2 * node == count:
                found[0] = replace(found[0], weights=(1.0, *weights[1:]))
            else:
                found.append(Sample(level, node / count if self.moves else 0.5, tuple(point.tolist()), weights))
        return found

    def _nodes(self, level: int, levels: int) -> list[int]:
        """Which of the 2^levels + 1 times (of a picture in which nothing moves: 2^levels points) a level adds, from outside inwards."""
        count, step = 1 << levels, (1 << levels) >> level
        nodes = list(range(0, count + self.moves, step) if level == 1 else range(step, count, 2 * step))
        return [node for i in range(-(-len(nodes) // 2)) for node in dict.fromkeys((nodes[i], nodes[-1 - i]))]

    def _weight(self, node: int, count: int, level: int) -> float:
        """A sample's share of the light where the samples up to a level are used: of the curve, what is nearest to it (trapezoids)."""
        step = count >> level
        if not self.moves:
            return step / count
        if len(self.curve) == 1:
            return (0.5 if node in (0, count) else 1.0) * step / count
        x = np.linspace(0, 1, 4097)
        y = np.interp(x, np.linspace(0, 1, len(self.curve)), self.curve)
        return float((y * np.maximum(1 - np.abs(x * count - node) / step, 0)).sum() / y.sum())

    def scene(self, instances: list[ViewedInstance], camera: Camera, time: float, point: tuple[float, float]
              ) -> tuple[list[ViewedInstance], Camera]:
        """The picture's instances, and its camera, in one sample."""
        moved = [self._at(instance, time) for instance in instances]
        if len(self.moments) > 1:
            camera = replace(_mixed_camera(*self._between(time)), window=camera.window)
        if self.aperture:
            camera = self.aperture.through(camera, point)
        return [instance.viewed(camera) for instance in moved], camera

    def middle(self, instances: list[ViewedInstance], camera: Camera,
               given: np.ndarray | None) -> tuple[list[ViewedInstance], Camera, np.ndarray | None]:
        """The scene for the passes that are not averaged: the instances, the camera and the holdout's triangles [T, 3, 3] in the middle
        of the time, through the middle of the lens; given: the triangles [T, 3, 3] at the picture's own time."""
        if not self.moves:
            return instances, camera, given
        return *replace(self, aperture=None).scene(instances, camera, 0.5, (0.0, 0.0)), self.holdout(given, 0.5)

    def holdout(self, given: np.ndarray | None, time: float) -> np.ndarray | None:
        """The triangles [T, 3, 3] of a holdout in one sample; given: those [T, 3, 3] at the picture's own time, which stand still where no
        moment has any."""
        if all(moment.holdout is None for moment in self.moments):
            return given
        before, after, share = self._between(time)
        return between(before.holdout, after.holdout, share)

    def _at(self, instance: ViewedInstance, time: float) -> Instance:
        if not self.moments:
            return replace_time(instance, instance.t + (self.open + time * (self.close - self.open)) / instance.model.clip.frame_count)
        before, after, share = self._between(time)
        a, b = (moment.instances.get(instance.place, instance) for moment in (before, after))
        placement = a.placement + share * (b.placement - a.placement)
        near = a if share < 0.5 else b
        settings = replace(near.settings, crops=crops_between(a.settings.crops, b.settings.crops, share))
        instance = replace(instance, settings=settings)
        if not (one_clip(a.source, instance.source) and one_clip(b.source, instance.source)):  # frames of a sequence are other Gaussians
            return replace_time(instance, instance.t, placement)
        if not a.source is instance.source is b.source:  # across a seam of a long clip
            return replace_time(instance, a.t + share * (b.t - a.t), placement)
        if a.origin is None is b.origin:
            return replace_time(instance, a.t + share * (b.t - a.t), placement)
        between = mixed(a.model, a.t, b.model, b.t, share)
        model = between if instance.rows is None else between.take(instance.rows)
        if instance.painted:
            now = still(instance.model, slice_model(instance.model, instance.t, cull=False))
            model = replace(model, features=now.features, appearance=now.appearance)
        return replace(replace_time(instance, 0.0, placement), model=model, origin=instance.source)

    def _between(self, time: float) -> tuple[Moment, Moment, float]:
        """The moments before and after a time, and how far it lies between them."""
        at = time * (len(self.moments) - 1)
        i = min(int(at), len(self.moments) - 2) if len(self.moments) > 1 else 0
        return self.moments[i], self.moments[min(i + 1, len(self.moments) - 1)], at - i


def replace_time(instance: Instance, t: float, placement: np.ndarray | None = None) -> Instance:
    """The instance at another time, and perhaps at another place, before no camera."""
    plain = {f.name: getattr(instance, f.name) for f in fields(Instance)}
    return Instance(**plain | {"placement": instance.placement if placement is None else placement, "t": t})


def _mixed_camera(before: Moment, after: Moment, share: float) -> Camera:
    """The camera between those of two moments that are near each other."""
    a, b = before.camera, after.camera
    if share == 0:
        return a

    def mixed(name: str) -> Any:
        return getattr(a, name) + share * (getattr(b, name) - getattr(a, name))

    poses = [np.linalg.inv(camera.world_to_camera) for camera in (a, b)]
    pose = poses[0] + share * (poses[1] - poses[0])
    u, _, v = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ v if np.allclose(poses[0][:3, :3].T @ poses[0][:3, :3], np.eye(3), atol=1e-6) else pose[:3, :3]
    return replace(a, world_to_camera=np.linalg.inv(pose), **{name: mixed(name) for name in ("fx", "fy", "cx", "cy", "near")})


class Film:
    """Adds up the light of samples.  Light adds up as light: sRGB colours are decoded first and encoded in the end.

    spaces   the colour spaces of the models; of a mixture colours are added as they are
    objects  how many objects' shares of the pixels are added up
    """

    def __init__(self, height: int, width: int, spaces: set[str], objects: int = 0) -> None:
        self.rgb, self.shares = np.zeros((height, width, 3), np.float32), np.zeros((height, width, objects), np.float32)
        self.alpha, self.held = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
        self.encoded = spaces == {"srgb"}

    def add(self, rgb: np.ndarray | None, alpha: np.ndarray, weight: float, held: np.ndarray | None = None,
            shares: np.ndarray | None = None) -> None:
        """Add a sample's picture."""
        if shares is not None:
            self.shares += (weight * shares).astype(np.float32)
        self.alpha += (weight * alpha).astype(np.float32)
        if held is not None:
            self.held += (weight * held).astype(np.float32)
        if rgb is not None:
            self.rgb += (weight * (colour.scene_linear(rgb, alpha, "srgb") if self.encoded else rgb)).astype(np.float32)

    def picture(self) -> tuple[np.ndarray, np.ndarray]:
        """rgb [h, w, 3], premultiplied in the models' colour space, and alpha [h, w]."""
        if not self.encoded:
            return self.rgb, self.alpha
        return colour.encoded(self.rgb, self.alpha), self.alpha
