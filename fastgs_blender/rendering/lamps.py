# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: what arrives from them at a place, before anything stands in the way.

Radiometry is Cycles': a white diffuse surface that receives the irradiance E has the radiance E / pi.  A lamp of P watts has the radiant
intensity P / (4 pi) to all sides (point, spot), or P / pi along its axis (area); a sun's strength is the irradiance of what faces it.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..util.errors import FastGSError
from ..util.threads import product
from .shadow import Light, mixed

TIMES = 8
"""Times at which a lamp of one point throws shadows while a shutter is open, if these move."""
Beam = Callable[[np.ndarray], np.ndarray]
"""Which share of its intensity a lamp sends at an angle to its axis, of the cosines [N] of the angles: [N]."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp.

    light   its points
    colour  [3] or [L, 3] scene linear: of a sun the irradiance of a surface that faces it, of other lamps the radiant intensity along the
            axis; each point has this colour, or its own, and the lamp is their mean
    axis    unit vector [3] in the world along which it shines, or one for each point [L, 3]; None: it shines alike to all sides
    beam    how it fades away from the axis
    soft    radius within which it gets no brighter (Cycles' soft falloff)
    name    by which ObjectSettings and SceneLight know what it does not light, and what its light passes
    shape   [3, 3] by which directions are multiplied before the beam takes their angles to the axis; None: they are taken as they are

    Raises FastGSError for colours that are not finite, or not one for all points or one each.
    """

    light: Light
    colour: np.ndarray
    axis: np.ndarray | None = None
    beam: Beam | None = None
    soft: float = 0.0
    name: str = ""
    shape: np.ndarray | None = None

    def __post_init__(self) -> None:
        colour = np.asarray(self.colour, np.float64)
        if colour.shape not in ((3,), (len(self.light.points), 3)) or not np.isfinite(colour).all():
            raise FastGSError("a lamp needs a colour of three finite numbers, for all of its points or for each.")
        object.__setattr__(self, "colour", np.broadcast_to(colour, (len(self.light.points), 3)))
        if self.axis is not None:
            object.__setattr__(self, "axis", np.broadcast_to(np.asarray(self.axis, np.float64), (len(self.light.points), 3)))

    def share(self, number: int, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """How much of its colour its point of that number sends to positions [3, M] with unit normals [3, M], in the world: [M]."""
        place = self.light.points[number]
        if self.light.parallel:
            return np.maximum(product(place, normal), 0)
        towards = (place[:, None] - position).astype(np.float32)
        square = np.maximum(np.einsum("km,km->m", towards, towards), 1e-12)
        length = np.sqrt(square)
        share = np.maximum(np.einsum("km,km->m", normal, towards), 0) / ((square + self.soft**2) * length)
        if self.beam is not None and self.axis is not None:
            if self.shape is not None:
                towards = product(self.shape, towards)
                length = np.sqrt(np.maximum(np.einsum("km,km->m", towards, towards), 1e-12))
            share *= self.beam(np.einsum("k,km->m", -self.axis[number].astype(np.float32), towards) / length)
        return share

    def like(self, other: Lamp) -> bool:
        """Whether another lamp stands where it does and shines as it does."""
        return all(np.array_equal(a, b) for a, b in zip(self._rows(), other._rows(), strict=True))

    def exposed(self, moments: Sequence[Lamp], curve: Sequence[float]) -> Lamp:
        """This lamp while a shutter is open: each of its points shines at one time, and a point with much of its light at several.

        moments  itself [M], with as many points, at times evenly spread over the exposure
        curve    how far the shutter is open, likewise
        """
        bright = np.abs(self.colour).sum(1)
        copies = np.maximum(np.round(TIMES * bright / max(bright.sum(), 1e-30)), 1).astype(int)
        point = np.repeat(np.arange(len(copies)), copies)
        times = _times(copies, curve)
        first = np.minimum((times * (len(moments) - 1)).astype(int), len(moments) - 2)
        share = (times * (len(moments) - 1) - first)[:, None]
        points, colour, axis = (each[first, point] + share * (each[first + 1, point] - each[first, point])
                                for each in (np.stack(rows) for rows in zip(*(each._rows() for each in moments), strict=True)))
        if self.light.parallel:
            points /= np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-30)
        colour *= (len(point) / len(copies) / copies[point])[:, None]
        return replace(self, light=Light(points, self.light.parallel, times), colour=colour, axis=None if self.axis is None else axis)

    def _rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What moves of its points: their places, colours and axes, [L, 3] each."""
        return self.light.points, self.colour, np.zeros_like(self.colour) if self.axis is None else self.axis


def _times(copies: np.ndarray, curve: Sequence[float]) -> np.ndarray:
    """Times from 0 to 1, so many of each point of a lamp: those of all points, and of each one, are as dense as the shutter is open."""
    even = np.concatenate([(np.arange(count) + (k + 0.5) / len(copies)) / count for k, count in enumerate(copies)])
    x = np.linspace(0, 1, 4097)
    light = np.interp((x[1:] + x[:-1]) / 2, np.linspace(0, 1, len(curve)), curve).cumsum()
    return np.interp(even, np.concatenate([[0], light / light[-1]]), x)


def cone(angle: float, blend: float) -> Beam:
    """A spot's beam, which ends at the half of an angle in radians and fades over a share of it (Cycles' spot_light_attenuation)."""
    edge = np.cos(angle / 2)
    width = max((1 - edge) * blend, 1e-9)

    def beam(cosine: np.ndarray) -> np.ndarray:
        x = np.clip((cosine - edge) / width, 0, 1)
        return x * x * (3 - 2 * x)

    return beam


def flat(spread: float = np.pi) -> Beam:
    """The beam of a flat lamp (Lambert), kept within a spread in radians (Cycles' area_light_spread_attenuation)."""
    half = min(spread, np.pi) / 2
    if half > np.pi / 2 - 1e-3:
        return lambda cosine: np.maximum(cosine, 0)
    edge = max(np.tan(half), 1e-6)
    strength = 1 / max(edge - half, 1e-9)

    def beam(cosine: np.ndarray) -> np.ndarray:
        ahead = np.maximum(cosine, 1e-9)
        tangent = np.sqrt(np.maximum(1 - ahead * ahead, 0)) / ahead
        return np.where(cosine > 0, ahead * np.maximum(edge - tangent, 0) * strength, 0)

    return beam


def dome(radiance: ArrayLike, directions: int = 32) -> Lamp:
    """The world around, of one radiance [3]: suns all around."""
    return Lamp(Light(Light.ball(np.zeros(3), 1.0, directions).points, True), 4 * np.pi * np.asarray(radiance, np.float64))


def panorama(radiance: np.ndarray, directions: int = 32) -> Lamp | None:
    """The world around as a picture of its radiance: at most so many suns, each for all light of a part of it.  None where it is dark.

    radiance  [h, w, 3] equirectangular: the lowest row first, +Y in the middle of a row

    The part whose light spreads most (light times squared extent) is cut into two of as much light, again and again, along its longer side
    (after Debevec, A Median Cut Algorithm for Light Probe Sampling, 2005).  So a small bright sun is one direction, and its shadows sharp.
    """
    height, width = radiance.shape[:2]
    up, turn = ((np.arange(count) + 0.5) / count - 0.5 for count in (height, width))
    up, turn = np.pi * up[:, None], 2 * np.pi * turn
    towards = np.stack(np.broadcast_arrays(np.sin(turn) * np.cos(up), np.cos(turn) * np.cos(up), np.sin(up)), -1)
    light = np.maximum(radiance, 0) * (2 * (np.pi / height) * (np.pi / width) * np.cos(up))[..., None]
    energy = light.sum(-1)
    if not energy.any():
        return None

    def measured(top: int, bottom: int, left: int, right: int) -> tuple[float, tuple[float, float], tuple[int, int, int, int]]:
        """(how far its light spreads, its sides in radians, where it lies) of a part."""
        sides = (bottom - top) * np.pi / height, (right - left) * 2 * np.pi / width * np.cos(up[top:bottom]).max()
        spread = (sides[0] ** 2 + sides[1] ** 2) * energy[top:bottom, left:right].sum()
        return spread if (bottom - top) * (right - left) > 1 else 0.0, sides, (top, bottom, left, right)

    parts = [measured(0, height, 0, width)]
    while len(parts) < directions:
        most = max(range(len(parts)), key=lambda number: parts[number][0])
        spread, (tall, wide), (top, bottom, left, right) = parts[most]
        if spread == 0:
            break
        across = bottom - top == 1 or (wide > tall and right - left > 1)
        sums = energy[top:bottom, left:right].sum(0 if across else 1).cumsum()
        cut = min(int(np.searchsorted(sums, sums[-1] / 2)) + 1, len(sums) - 1)
        halves = [(top, bottom, left, left + cut), (top, bottom, left + cut, right)] if across else [
            (top, top + cut, left, right), (top + cut, bottom, left, right)]
        parts[most:most + 1] = [measured(*half) for half in halves]
    parts = [parts[k] for k in mixed(len(parts))]
    boxes = [np.s_[top:bottom, left:right] for _, _, (top, bottom, left, right) in parts if energy[top:bottom, left:right].any()]
    middles = np.stack([(energy[box][..., None] * towards[box]).sum((0, 1)) for box in boxes])
    colours = np.stack([light[box].sum((0, 1)) for box in boxes])
    return Lamp(Light(middles / np.maximum(np.linalg.norm(middles, axis=1, keepdims=True), 1e-30), True), len(boxes) * colours)
