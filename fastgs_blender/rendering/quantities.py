# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantities: what passes sum over the splats besides colour and depth, each a few numbers of every Gaussian that is drawn.

They are computed here, in float64 array code, for every backend: only for the splats of a picture, and only where a pass asks.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..model.chapters import one_clip
from ..model.gaussians import GaussianModel
from ..model.slicing import positions_at, quaternions_at
from ..util import rotations
from ..util.threads import product
from .instances import LIMIT, Instance, Moment, ViewedInstance

THIN = 1e-3
"""Variance in pixels^2 that a Gaussian at least has when its motion is told apart along its width: seen edge-on it has none."""


class Shown:
    """The M Gaussians `index` of an instance before its camera, at its time.  What is asked for is computed then, in float64.

    backend  a loaded backend (util/backends.py), which finds faster where they are; None: NumPy does it
    """

    def __init__(self, instance: ViewedInstance, index: np.ndarray, backend: Any = None):
        self.instance, self.index, self._backend = instance, index, backend

    @classmethod
    def all_of(cls, instance: ViewedInstance, backend: Any) -> Shown:
        """Those Gaussians of an instance that its camera can see, in their order."""
        there = np.zeros(len(instance.model), bool)
        there[backend.front_to_back([instance], instance.camera)] = True
        return cls(instance, np.flatnonzero(there), backend)

    @cached_property
    def _posed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._backend.posed(self.instance, self.index) if self._backend else posed(self.instance, self.index)

    @cached_property
    def position(self) -> np.ndarray:
        """[M, 3] in the model's space."""
        return self._posed[0] if self._backend else positions_at(self.instance.model, self.instance.t, self.index)  # no more is needed

    @cached_property
    def world(self) -> np.ndarray:
        """[M, 3] in the world."""
        return _transformed(self.instance.placement, self.position)

    @cached_property
    def view(self) -> np.ndarray:
        """[M, 3] in the camera's axes."""
        return _transformed(self.instance.model_to_camera, self.position)

    @property
    def axes(self) -> np.ndarray:
        """[3, 3, M]: the Gaussians' axes in the model's space, as columns, each as long as its standard deviation."""
        return self._posed[2]

    def pixels(self, instance: ViewedInstance) -> tuple[np.ndarray, np.ndarray]:
        """The same Gaussians of another instance of the model in its camera's picture: their centres [M, 2], and their standard deviations
        along their own axes [M, 2, 3], in pixels."""
        camera, to_camera = instance.camera, instance.model_to_camera
        view = _transformed(to_camera, positions_at(instance.model, instance.t, self.index))
        scale = np.exp(instance.model.scale[self.index].astype(np.float64))[:, None]
        spread = to_camera[:3, :3] @ (self._axes_at(instance.t, instance.model) * scale)
        flat = spread[:, :2]
        if not camera.orthographic:
            depth = np.where(view[:, 2] > 0, view[:, 2], np.nan)[:, None, None]
            flat = (flat - view[:, :2, None] / depth * spread[:, 2:]) / depth
        return camera.pixels(view), flat * np.array([[camera.fx], [camera.fy]])

    def _axes_at(self, t: float, model: GaussianModel) -> np.ndarray:
        """Each Gaussian's axes in the model's space, as columns [M, 3, 3]."""
        return rotations.to_matrices(rotations.unit(quaternions_at(model, t, self.index)))


def posed(instance: Instance, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """PictureBackend.posed() in NumPy."""
    model, t = instance.model, instance.t
    turn = rotations.unit(quaternions_at(model, t, index))
    axes = np.stack(rotations.elements(turn)).reshape(3, 3, -1) * np.exp(model.scale[index].T.astype(np.float64))
    return positions_at(model, t, index), turn, axes


@dataclass(frozen=True)
class Quantity:
    """Some numbers of each Gaussian: values(Shown) gives [M, width] float64.

    same  gives the numbers [width] of an instance all of whose Gaussians have the same; None: they have their own
    core  whether they are summed over the core of each pixel (layout.py), and not over all that it shows
    """

    width: int
    values: Callable[[Shown], np.ndarray]
    same: Callable[[ViewedInstance], np.ndarray] | None = None
    core: bool = False

    def of(self, shown: Shown) -> np.ndarray:
        """The values [M, width]; 0 where they are not numbers or too large to be summed."""
        with np.errstate(all="ignore"):
            values = self.values(shown)
        return np.where(np.abs(values) <= LIMIT, values, 0)


@dataclass(frozen=True)
class Mist:
    """Blender's mist: 0 up to a distance of `start` from the camera, 1 from `depth` beyond that on.

    falloff  the curve between: 'QUADRATIC', 'LINEAR' or 'INVERSE_QUADRATIC' (the square root)
    """

    start: float = 5.0
    depth: float = 25.0
    falloff: str = 'QUADRATIC'

    def quantity(self) -> Quantity:
        """How far each Gaussian lies in the mist."""
        exponent = {'QUADRATIC': 2.0, 'LINEAR': 1.0, 'INVERSE_QUADRATIC': 0.5}[self.falloff]

        def values(shown: Shown) -> np.ndarray:
            distance = np.abs(shown.view[:, 2]) if shown.instance.camera.orthographic else np.linalg.norm(shown.view, axis=1)
            return np.clip((distance - self.start) / max(self.depth, 1e-30), 0, 1)[:, None] ** exponent

        return Quantity(1, values)


def vector(instances: list[ViewedInstance], before: Moment | None, after: Moment | None) -> Quantity:
    """Blender's speed vectors in pixels, y up: from where a Gaussian is to where it was one frame earlier, and from where it will be
    one frame later to where it is (Cycles `primitive_motion_vector`).

    The places at the other frames come from the model's motion as a function of time, at those very times, and from the moments'
    placements and cameras.  Without moments, cameras and placements stand still and the time moves by a frame of each model's clip.

    A Gaussian that turns, or grows in the picture, moves differently at each of its pixels, so its vector is a plane, as its depth is
    (oracle.plane): 12 numbers a, b, c of four each, with which it is a + b x + c y, x and y counted from the image's middle.  A
    thirteenth, 1, sums up to the weight of all.
    """
    moved = {instance: (_moved(instance, before, -1), _moved(instance, after, 1)) for instance in instances}

    def values(shown: Shown) -> np.ndarray:
        now, spread = shown.pixels(shown.instance)
        x, y = spread[:, 0], spread[:, 1]  # sums and matmul: einsum takes three times as long for so many small matrices
        xx, xy, yy = (x * x).sum(1) + THIN, (x * y).sum(1), (y * y).sum(1) + THIN
        towards = np.stack([np.stack([yy, -xy], -1), np.stack([-xy, xx], -1)], 1) / (xx * yy - xy * xy)[:, None, None]
        towards = spread.transpose(0, 2, 1) @ towards  # from pixels to the Gaussian's own axes
        shift, slope = np.empty((len(now), 4)), np.empty((len(now), 4, 2))
        for i, other in enumerate(moved[shown.instance]):
            there, wide = shown.pixels(other)
            sign = (1 - 2 * i) * np.array([1, -1])
            shift[:, 2 * i:2 * i + 2] = sign * (there - now)
            slope[:, 2 * i:2 * i + 2] = sign[:, None] * ((wide - spread) @ towards)
        camera = shown.instance.camera
        shift -= np.einsum("mck,mk->mc", slope, now - np.array([camera.width, camera.height]) / 2)
        return np.concatenate([shift, slope[..., 0], slope[..., 1], np.ones((len(now), 1))], 1)

    return Quantity(13, values, core=True)


def _moved(instance: ViewedInstance, moment: Moment | None, frames: int) -> ViewedInstance:
    """The instance at another moment, or so many frames of its clip later."""
    if moment is None:
        return replace(instance, t=instance.t + frames / instance.model.clip.frame_count)
    there = moment.instances.get(instance.place, instance)
    if there.source is not instance.source:  # frames of a sequence are not the same Gaussians, but chapters of a long clip share its time
        t = there.t if one_clip(there.source, instance.source) else instance.t
        return Instance(instance.model, there.placement, t).viewed(moment.camera)
    return Instance(there.model, there.placement, there.t).viewed(moment.camera)


def shares(instances: list[ViewedInstance], names: Sequence) -> Quantity:
    """1 in the column of each Gaussian's object, among names (Instance.identity): what part of a pixel each object covers."""
    column = {instance: names.index(instance.identity) for instance in instances if instance.identity in names}

    def same(instance: ViewedInstance) -> np.ndarray:
        out = np.zeros(len(names))
        if instance in column:
            out[column[instance]] = 1
        return out

    return Quantity(len(names), lambda shown: np.tile(same(shown.instance), (len(shown.index), 1)), same)


def _transformed(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return (product(matrix[:3, :3], points.T) + matrix[:3, 3:]).T
