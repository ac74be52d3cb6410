# SPDX-License-Identifier: GPL-3.0-or-later
"""Integrates the animation of a splat object's *Speed*: how far its clip has run by a frame, whichever frames were looked at before.

Between keys, constant, linear and Bezier curves are integrated in closed form, as Blender evaluates them.  Eased keys, modifiers of curves,
NLA strips and drivers are evaluated at the nodes of a Gauss rule in each frame.
"""
from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from itertools import pairwise

import bpy
import numpy as np

from .cameras.keys import curve_of, driver_of
from .drivers import value_at
from .strips import Strips
from .time import Run

PATH, USUAL = "fastgs.speed", 1.0
MOST_CUTS = 100_000
"""Parts of the time that are integrated one by one; longer times are divided into so many."""
NODES, WEIGHTS = (tuple(each.tolist()) for each in np.polynomial.legendre.leggauss(8))
FEW_NODES, FEW_WEIGHTS = (tuple(each.tolist()) for each in np.polynomial.legendre.leggauss(3))
HALVINGS = 60
FARTHEST = 20_000
"""Frames after its begin in which the end of a clip is looked for."""
SLACK = 1e-5
"""Frames: Blender stores single precision."""


def run_of(obj, frame: float) -> Run | None:
    """How far the clip of an object has run by a frame of the scene; None where its speed is the same at all times."""
    speed = speed_of(obj)
    start = obj.fastgs.start_frame
    if speed is None or not (math.isfinite(start) and math.isfinite(frame)):
        return None
    return Run(speed.integral(start, frame), speed.backwards(start))


def speed_of(obj) -> Speed | None:
    """The animation of an object's speed; None where there is none, or none that is known at other frames than the current one."""
    if driver_of(obj, PATH) is not None:
        speed = value_at(obj, PATH)
        return None if speed is None else Speed(speed, whole_frames)
    if strips := Strips(obj, PATH, USUAL):
        return Speed(strips.at, lambda a, b: {*whole_frames(a, b), *strips.cuts()}) if strips.known else None
    curve = curve_of(obj, PATH)
    return None if curve is None else _Curve(curve) if _plain(curve) else Speed(curve.evaluate, lambda a, b: _cuts(curve, a, b))


def trouble(obj) -> str:
    """Why the animation of an object's speed is not integrated; empty where it is, or where there is none."""
    if speed_of(obj) is not None:
        return ""
    if driver_of(obj, PATH) is not None:
        return ("Speed has a driver that is not known on other frames: the clip runs as if it had always been so fast as now. Key the "
                "speed, or key the capture frame.")
    if Strips(obj, PATH, USUAL):
        return ("Speed is animated by NLA strips that are not known on other frames, such as transitions: the clip runs as if it had "
                "always been so fast as now. Key the speed in the object's action.")
    return ""


def end_of(speed: Speed, start: float, frames: float) -> float | None:
    """The frame on which a clip has ended that begins on `start` and lasts so many frames of the scene at speed 1: it has run through,
    or back to before its begin.  None: it goes on for longer than one looks."""
    run, at, sign = 0.0, start, -1 if speed.backwards(start) else 1

    def ended(passed):
        return not -SLACK <= sign * passed < frames - SLACK

    for _ in range(FARTHEST):
        step = speed.integral(at, at + 1)
        if ended(run + step):
            low, high = at, at + 1
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                low, high = (low, middle) if ended(run + speed.integral(at, middle)) else (middle, high)
            return high
        run, at = run + step, at + 1
    return None


class Speed:
    """A speed as a function of the scene's frame.

    at    the function
    cuts  (first, last) -> frames between these at which the function, or its slope, may jump
    """

    def __init__(self, at: Callable[[float], float], cuts: Callable[[float, float], Iterable[float]]):
        self.at, self._cuts = at, cuts

    def backwards(self, start: float) -> bool:
        """Whether it is negative first."""
        first = self.at(start)
        return first < 0 if first else self.integral(start, start + 1) < 0

    def integral(self, first: float, last: float) -> float:
        """The integral from one frame to another, negative where the other comes before."""
        if last < first:
            return -self.integral(last, first)
        inner = sorted({cut for cut in self._cuts(first, last) if first < cut < last})
        return math.fsum(self._part(a, b) for a, b in pairwise((first, *inner, last)))

    def _part(self, a: float, b: float) -> float:
        """The integral between neighbouring cuts."""
        middle, half = (a + b) / 2, (b - a) / 2
        return half * math.fsum(w * self.at(middle + half * x) for x, w in zip(NODES, WEIGHTS))


class _Curve(Speed):
    """An F-curve of constant, linear and Bezier keys, without modifiers."""

    def __init__(self, curve: bpy.types.FCurve):
        self._keys = list(curve.keyframe_points)
        self._times = [key.co.x for key in self._keys]
        super().__init__(curve.evaluate, lambda a, b: self._times)

    def _part(self, a, b):
        place = bisect_right(self._times, (a + b) / 2)
        if not 0 < place < len(self._keys):  # beyond the keys curves are straight
            return (b - a) * (self.at(a) + self.at(b)) / 2 if a < b else 0.0
        key, following = self._keys[place - 1], self._keys[place]
        (t0, v0), (t1, v1) = key.co, following.co
        if key.interpolation == 'CONSTANT':
            return (b - a) * v0
        if key.interpolation == 'LINEAR':
            return (b - a) * (v0 + (v1 - v0) * ((a + b) / 2 - t0) / (t1 - t0))
        x, y = zip(*_handles(key, following))
        low, high = _share(x, a), _share(x, b)
        middle, half = (low + high) / 2, (high - low) / 2
        places = [middle + half * node for node in FEW_NODES]
        return half * math.fsum(weight * _cubic(y, s) * _slope(x, s) for s, weight in zip(places, FEW_WEIGHTS))


def _plain(curve) -> bool:
    """Whether a curve's integral is known in closed form."""
    keys = curve.keyframe_points
    return len(keys) > 0 and all(m.mute for m in curve.modifiers) and all(
        key.interpolation in ('CONSTANT', 'LINEAR', 'BEZIER') for key in keys)


def _handles(key, following):
    """The four points of a Bezier segment; as Blender does it, handles that are longer than the segment are shortened."""
    (t0, v0), (t1, v1) = key.co, following.co
    points = []
    for (t, v), (x, y) in (((t0, v0), key.handle_right), ((t1, v1), following.handle_left)):
        share = min(1.0, (t1 - t0) / max(abs(x - t), 1e-30))
        points.append((t + share * (x - t), v + share * (y - v)))
    return (t0, v0), *points, (t1, v1)


def _cubic(p, s: float) -> float:
    r = 1 - s
    return r * r * r * p[0] + 3 * r * r * s * p[1] + 3 * r * s * s * p[2] + s * s * s * p[3]


def _slope(p, s: float) -> float:
    r = 1 - s
    return 3 * (r * r * (p[1] - p[0]) + 2 * r * s * (p[2] - p[1]) + s * s * (p[3] - p[2]))


def _share(x, time: float) -> float:
    """Where on a Bezier segment, 0 to 1, its time is `time`."""
    low, high = 0.0, 1.0
    if time <= x[0] or time >= x[3]:
        return 0.0 if time <= x[0] else 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if _cubic(x, middle) < time else (low, middle)
    return (low + high) / 2


def whole_frames(first: float, last: float) -> Iterable[float]:
    """The whole frames between two frames, or as many of them as are few enough."""
    a, b = math.ceil(first), math.floor(last)
    return (float(a + k) for k in range(0, b - a + 1, max((b - a) // MOST_CUTS, 1)))


def _cuts(curve, first: float, last: float) -> set[float]:
    """Whole frames, keys, those that the modifier Cycles repeats, and the steps of Stepped Interpolation."""
    times = [key.co.x for key in curve.keyframe_points]
    cuts = {*whole_frames(first, last), *times}
    for modifier in curve.modifiers:
        if modifier.type == 'CYCLES' and len(times) > 1 and times[-1] > times[0]:
            length = times[-1] - times[0]
            turns = range(math.floor((first - times[0]) / length), math.ceil((last - times[0]) / length) + 1)
            cuts |= {time + turn * length for turn in turns[:MOST_CUTS] for time in times}
        elif modifier.type == 'STEPPED' and modifier.frame_step > 0:
            step, offset = modifier.frame_step, modifier.frame_offset
            turns = range(math.floor((first - offset) / step), math.ceil((last - offset) / step) + 1)
            cuts |= {offset + turn * step for turn in turns[:MOST_CUTS]}
    return cuts
