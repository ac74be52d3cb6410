# SPDX-License-Identifier: GPL-3.0-or-later
"""Vectors: the motion in pixels of what each pixel shows.

A pixel has the motion of one splat, that of the median depth.  A mean over splats would be wrong wherever a pixel mixes two surfaces that
move differently, at each outline: by several pixels, between the two motions.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cameras.camera import Camera
from .instances import LIMIT, Instance, Moment, ViewedInstance
from .quantities import Shown

THIN = 1e-3
"""Variance in pixels^2 that a Gaussian at least has when its motion is told apart along its width: seen edge-on it has none."""


def picture(instances: list[ViewedInstance], splat: np.ndarray, camera: Camera, before: Moment | None, after: Moment | None) -> np.ndarray:
    """Blender's speed vectors [h, w, 4] in pixels, y up: from where a point is to where it was one frame earlier, and from where it will be
    one frame later to where it is (Cycles `primitive_motion_vector`); 0 where nothing is.

    splat  [h, w] which Gaussian each pixel shows, counted through all instances, or -1: the probe of layout.PROBES

    The places at the other frames come from the model's motion as a function of time, at those very times, and from the moments'
    placements and cameras.  Without moments, cameras and placements stand still and the time moves by a frame of each model's clip.
    """
    out = np.zeros((splat.size, 4), np.float32)
    x, y = (each.ravel() for each in np.meshgrid(*camera.from_middle()))
    splat, first = splat.ravel(), 0
    for instance in instances:
        count = len(instance.model)
        pixels = np.flatnonzero((splat >= first) & (splat < first + count))
        seen = np.zeros(count, bool)
        seen[splat[pixels] - first] = True
        rows = (np.cumsum(seen) - 1)[splat[pixels] - first]
        a, b, c = _planes(instance, np.flatnonzero(seen), before, after)
        out[pixels] = a[rows] + b[rows] * x[pixels, None] + c[rows] * y[pixels, None]
        first += count
    return out.reshape(*camera.window[:1:-1], 4)


def _planes(instance: ViewedInstance, index: np.ndarray, before: Moment | None, after: Moment | None) -> np.ndarray:
    """The vectors [3, M, 4] of an instance's Gaussians index [M]: a + b x + c y, x and y counted from the image's middle.

    A Gaussian that turns, or grows in the picture, moves differently at each of its pixels, so its vector is a plane, as its depth is
    (oracle.plane).  Where that is no number, or too large, the Gaussian stands still.
    """
    shown, camera = Shown(instance, index), instance.camera
    with np.errstate(all="ignore"):
        now, spread = shown.pixels(instance)
        (xx, xy), (_, yy) = np.einsum("mik,mjk->ijm", spread, spread) + THIN * np.eye(2)[..., None]
        towards = np.stack([np.stack([yy, -xy], -1), np.stack([-xy, xx], -1)], 1) / (xx * yy - xy * xy)[:, None, None]
        towards = np.einsum("mik,mij->mkj", spread, towards)  # from pixels to the Gaussian's own axes
        shift, slope = np.empty((len(now), 4)), np.empty((len(now), 4, 2))
        for i, (moment, frames) in enumerate(((before, -1), (after, 1))):
            there, wide = shown.pixels(_moved(instance, moment, frames))
            sign = -frames * np.array([1, -1])
            shift[:, 2 * i:2 * i + 2] = sign * (there - now)
            slope[:, 2 * i:2 * i + 2] = sign[:, None] * np.einsum("mik,mkj->mij", wide - spread, towards)
        shift -= np.einsum("mck,mk->mc", slope, now - np.array([camera.width, camera.height]) / 2)
    planes = np.stack([shift, slope[..., 0], slope[..., 1]])
    return np.where((np.abs(planes) <= LIMIT).all(0), planes, 0)


def _moved(instance: ViewedInstance, moment: Moment | None, frames: int) -> ViewedInstance:
    """The instance at another moment, or so many frames of its clip later."""
    if moment is None:
        return replace(instance, t=instance.t + frames / instance.model.clip.frame_count)
    there = moment.instances.get(instance.place, instance)
    if there.source is not instance.source:  # frames of a sequence are not the same Gaussians
        return Instance(instance.model, there.placement, instance.t).viewed(moment.camera)
    return Instance(there.model, there.placement, there.t).viewed(moment.camera)
