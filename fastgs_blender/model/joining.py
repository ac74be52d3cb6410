# SPDX-License-Identifier: GPL-3.0-or-later
"""Joining the segments of a long capture into one ordinary model.

Every segment was trained in its own time u in [0, 1], and lies at t = begin + length * u of the whole.  The bases are closed
under such a change of time, so nothing is fitted: a Fourier series is one of the same order with other phases, half-period
cosines are a Fourier series of half the frequency, powers of t - mu_tau scale, and tables of keyframes stand side by side.
What the segments share, the decoder above all, must be the same in all of them.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..util.errors import FastGSError
from .appearance import Features
from .gaussians import Clip, GaussianModel
from .motion import Basis, Cosine, Fourier, Keyframes, Polynomial, Static
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
    return replace(first, **arrays, basis=moving, rotation_basis=turning, temporal_kind=WindowedRadial(), clip=clip)


def _same(first: GaussianModel, other: GaussianModel):
    look, its = first.appearance, other.appearance
    if type(look) is not type(its) or first.raster != other.raster or first.axes != other.axes or first.colour_space != other.colour_space:
        raise FastGSError("the segments cannot be joined: their appearance, rasteriser constants, axes or colour space differ.")
    if isinstance(look, Features):
        same = np.array_equal(look.w1, its.w1) and np.array_equal(look.w2, its.w2) and look.activation == its.activation
    else:
        same = look == its
    if not same:
        raise FastGSError("the segments cannot be joined: they need one appearance in common, with the same decoder.")
    if not isinstance(other.temporal_kind, (Always, Radial)):
        raise FastGSError(f"the segments cannot be joined: their temporal opacity is {other.temporal_kind.name}, not radial.")


def _common(bases: list[Basis], segments: list[Segment]) -> Basis:
    """The basis in the whole's time that holds all of the segments' ones."""
    first = bases[0]
    if any(basis != first for basis in bases):
        raise FastGSError("the segments cannot be joined: they move in different bases of time.")
    if isinstance(first, (Static, Polynomial)):
        return first
    if isinstance(first, Keyframes):
        times = np.concatenate([s.begin + s.length * np.array(first.times) for s in segments])
        return replace(first, times=tuple(np.unique(np.round(times, 12)).tolist()))
    length = segments[0].length
    if any(abs(s.length - length) > 1e-9 * length for s in segments):
        raise FastGSError("the segments cannot be joined: a series needs segments of one length.")
    if isinstance(first, Cosine):
        return Fourier(first.order, 0.5 * first.scale / length)
    return replace(first, scale=first.scale / length, offset=0.0)


def _in_whole_time(segment: Segment, number: int, segments, moving: Basis, turning: Basis) -> dict[str, np.ndarray]:
    """The arrays of a segment's model in the whole's time."""
    model, length = segment.model, segment.length
    n = len(model)
    arrays = {name: array.astype(np.float64) for name, array in model.arrays.items()}
    if isinstance(model.appearance, Features):
        arrays["features"][:, 6:9] /= length
    for constant, motion, basis, joined in (("position", "motion", model.basis, moving),
                                            ("rotation", "rotation_motion", model.rotation_basis, turning)):
        arrays[constant], arrays[motion] = _moved(arrays[constant], arrays[motion], basis, joined, segment)
    arrays["mu_tau"] = segment.begin + length * arrays["mu_tau"]
    bell = arrays["temporal"][:, 0] - 2 * np.log(length) if isinstance(model.temporal_kind, Radial) else np.full(n, FLAT)
    begin, end = (sign * 1e6 if edge is None else edge for edge, sign in zip(segment.shown, (-1, 1)))
    arrays["temporal"] = np.stack([bell, *(np.full(n, v) for v in (begin, end, np.log(segment.fade)))], -1)
    return arrays


def _moved(constant, c, basis: Basis, joined: Basis, segment: Segment):
    """Constant [N, D] and coefficients [N, K, D] of `basis` in u as those of `joined` in t = begin + length u."""
    begin, length = segment.begin, segment.length
    if isinstance(basis, Static):
        return constant, c
    if isinstance(basis, Polynomial):
        return constant, c / length ** np.arange(1, basis.degree + 1)[:, None]
    if isinstance(basis, Keyframes):
        return constant, _on_table(c, basis, joined, segment)
    # the phase of the series at t: scale u + offset = joined.scale' t + shift
    k = np.arange(1, basis.order + 1)
    if isinstance(basis, Cosine):
        angle = np.pi * k * (basis.offset - basis.scale * begin / length)
        sine, cosine = -c * np.sin(angle)[:, None], c * np.cos(angle)[:, None]
        return constant, np.stack([sine, cosine], 2).reshape(len(c), 2 * basis.order, -1)
    angle = 2 * np.pi * k * (basis.offset - basis.scale * begin / length)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    a, b = c[:, 0:2 * basis.order:2], c[:, 1:2 * basis.order:2]
    pairs = np.stack([a * cos - b * sin, a * sin + b * cos], 2).reshape(len(c), 2 * basis.order, -1)
    if basis.linear:
        line = c[:, -1:]
        return constant - line[:, 0] * begin / length, np.concatenate([pairs, line / length], 1)
    return constant, pairs


def _on_table(c, basis: Keyframes, joined: Keyframes, segment: Segment):
    """The table's values at the joined times; beside its own span the nearest value, as Keyframes hold it."""
    if basis.interpolation != "linear":
        raise FastGSError("the segments cannot be joined: smooth keyframes of different segments disturb each other; use linear ones.")
    u = (np.array(joined.times) - segment.begin) / segment.length
    return np.einsum("jk,nkd->njd", basis.weights(u), c)
