# SPDX-License-Identifier: GPL-3.0-or-later
"""Joining the segments of a long capture into one ordinary model.

Every segment was trained in its own time u in [0, 1], and lies at t = begin + length * u of the whole.  Nothing is fitted: each
basis of time (motion.py) writes the same motion in t, where it can.  What the segments share, the decoder above all, must be the
same in all of them.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..util.errors import FastGSError
from .appearance import Changing, Features
from .gaussians import Clip, GaussianModel
from .motion import Basis
from .surroundings import together
from .temporal import Always, Radial, WindowedRadial

FLAT = -40.0
"""ln s_tau of a Gaussian that does not fade."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A model of a part of the capture.

    model   in its own time
    begin   where its time 0 lies in the whole, in t
    length  how much of the whole its time 0..1 takes; bases with frequencies need the same length in all segments
    shown   (first, last) t at which it is fully there; None: no end on that side
    fade    width of the flanks outside `shown`, in t
    """

    model: GaussianModel
    begin: float
    length: float
    shown: tuple[float | None, float | None] = (None, None)
    fade: float = 0.01


def join(segments: list[Segment], clip: Clip) -> GaussianModel:
    """One model that shows at any time what its segments show; raises FastGSError where they do not fit together.

    Let `shown` overlap and each segment's flank lie where its neighbour is fully there: then nothing shines through.
    """
    first = segments[0].model
    for s in segments:
        _same(first, s.model)
    moving = _common([s.model.basis for s in segments], segments)
    turning = _common([s.model.rotation_basis for s in segments], segments)
    parts = [_in_whole_time(s, i, segments, moving, turning) for i, s in enumerate(segments)]
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return replace(first, **arrays, basis=moving, rotation_basis=turning, temporal_kind=WindowedRadial(), clip=clip,
                   surroundings=together([s.model.surroundings for s in segments]))


def _same(first: GaussianModel, other: GaussianModel):
    look, its = first.appearance, other.appearance
    if type(look) is not type(its) or first.raster != other.raster or first.axes != other.axes or first.colour_space != other.colour_space:
        raise FastGSError("the segments cannot be joined: their appearance, rasteriser constants, axes or colour space differ.")
    if isinstance(look, Changing):
        raise FastGSError("the segments cannot be joined: their colours change in time.")
    if isinstance(look, Features):
        same = np.array_equal(look.w1, its.w1) and np.array_equal(look.w2, its.w2) and (
            look.activation, look.decode) == (its.activation, its.decode)
    else:
        same = look == its
    if not same:
        raise FastGSError("the segments cannot be joined: they need one appearance in common, with the same decoder.")
    if not isinstance(other.temporal_kind, (Always, Radial)):
        raise FastGSError(f"the segments cannot be joined: their temporal opacity is {other.temporal_kind.name}, not radial.")


def _common(bases: list[Basis], segments: list[Segment]) -> Basis:
    """The basis in the whole's time that holds the motion of all segments."""
    first = bases[0]
    if any(basis != first for basis in bases):
        raise FastGSError("the segments cannot be joined: they move in different bases of time.")
    return first.whole([(s.begin, s.length) for s in segments])


def _in_whole_time(segment: Segment, number: int, segments, moving: Basis, turning: Basis) -> dict[str, np.ndarray]:
    """The arrays of a segment's model in the whole's time."""
    model, length = segment.model, segment.length
    n = len(model)
    arrays = {name: array.astype(np.float64) for name, array in model.arrays.items()}
    if isinstance(model.appearance, Features):
        arrays["features"][:, 6:9] /= length
    for constant, motion, basis, joined in (("position", "motion", model.basis, moving),
                                            ("rotation", "rotation_motion", model.rotation_basis, turning)):
        arrays[constant], arrays[motion] = basis.retimed(joined, segment.begin, length, arrays[constant], arrays[motion])
    arrays["mu_tau"] = segment.begin + length * arrays["mu_tau"]
    bell = arrays["temporal"][:, 0] - 2 * np.log(length) if isinstance(model.temporal_kind, Radial) else np.full(n, FLAT)
    begin, end = (sign * 1e6 if edge is None else edge for edge, sign in zip(segment.shown, (-1, 1)))
    arrays["temporal"] = np.stack([bell, *(np.full(n, v) for v in (begin, end, np.log(segment.fade)))], -1)
    return arrays
