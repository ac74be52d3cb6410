# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the few Gaussians that represent a model in other render engines, and computes their shape and colour at a time.

Plain arrays, no Blender.  The choice is deterministic, so that the same file gives the same proxy.
"""
from __future__ import annotations

import weakref
from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.model.framing import focus_sphere, in_ball, inside_backdrop, is_subject, without_backdrop
from ...fastgs_blender.model.gaussians import GaussianModel
from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.model.slicing import Slice, sigmoid, slice_model
from ...fastgs_blender.rendering.instances import ObjectSettings
from ...fastgs_blender.rendering.looks import Look, graded, look_numbers, size_factor
from ...fastgs_blender.util import rotations
from ..colour import linear

LIMIT = 20_000
"""The most points of a proxy."""

MOMENTS = 9
"""At so many times of the clip the model is looked at."""

PROBES = 50_000
CANDIDATES = 200_000
CELLS = 64
TURNS = 3
EDGE = 1.5
"""An opaque Gaussian is shown up to so many standard deviations; the area of others is less by their opacity."""
MOST_LARGER = 2.5
BRIEF = 0.5
"""Gaussians that are seen for less than this share of the clip are chosen for each moment anew."""
GOLDEN = 0.6180339887498949
"""Multiples of it, without their whole parts, fill 0..1 evenly."""


_chosen: weakref.WeakKeyDictionary[Source, tuple[int, Points]] = weakref.WeakKeyDictionary()
"""By model: the last limit, and the Gaussians that were chosen."""


@dataclass(frozen=True, eq=False)
class Points:
    """M Gaussians that stand for a model; positions are in the model's space.

    index     [M]     which Gaussians they are
    position  [M, 3]  at the time t, float32
    colour    [M, 3]  linear Rec.709 at the time t, 0 or more, float32
    radius    [M]     of balls as large as they are, float32
    larger    how much larger than the Gaussians the balls are, because few stand for many
    t         the model time at which most is to be seen
    box       [2, 3]  lower and upper corner of what is seen in the whole clip, strays left out
    subject   [2, 3]  the same of the subject alone, where the file knows what its capture's cameras looked at
    """

    index: np.ndarray
    position: np.ndarray
    colour: np.ndarray
    radius: np.ndarray
    larger: float
    t: float
    box: np.ndarray
    subject: np.ndarray


@dataclass(frozen=True, eq=False)
class Shown:
    """M chosen Gaussians at a time, in the model's space, float32.

    position  [M, 3]
    axes      [M, 3, 3]  columns: the half axes of the ellipsoids; 0 for those that are not seen
    colour    [M, 3]     linear Rec.709, 0 or more
    """

    position: np.ndarray
    axes: np.ndarray
    colour: np.ndarray


def choose(source: Source, limit: int = LIMIT) -> Points:
    """At most `limit` Gaussians of a model: important ones (opaque, large, long seen), from everywhere and from all of the clip.

    The backdrop, and lone Gaussians far outside (floaters), are left out, of the box too.  Of a sequence they are those of the
    frame on which most is to be seen.  They are remembered as long as the model lives: a thread can choose them before they are needed.
    """
    known = _chosen.get(source)
    if known is None or known[0] != limit:
        known = _chosen[source] = limit, _choose(source, limit)
    return known[1]


def _choose(source: Source, limit: int) -> Points:
    frames = source.clip.frame_count
    times = sorted({round(x) / frames for x in np.linspace(0, frames - 1, MOMENTS)})
    moments = [_sample(source, t, PROBES) for t in times]
    box = _robust_box([s.position for s, _ in moments])
    ball = focus_sphere(source.moment(times[0], hold=True)[0].surroundings.cameras)
    subject = box if box is None else _robust_box([s.position[in_ball(s.position, ball)] for s, _ in moments])
    subject = np.zeros((2, 3)) if subject is None else np.array(subject)
    if limit < 1 or box is None:
        none = np.zeros((0, 3), np.float32)
        return Points(np.zeros(0, np.int32), none, none, np.zeros(0, np.float32), 1.0, times[0],
                      np.zeros((2, 3)) if box is None else np.array(box), subject)
    best = int(np.argmax([s.opacity[_inside(s.position, box)].sum() * share for s, share in moments]))
    moment = times[best]
    model, at = source.moment(moment, hold=True)
    if model is not source:  # other frames have other Gaussians
        times, best = [at], 0
    every = _every(model)
    candidates = model.take(every)
    peak, seen = _visibility(candidates, times, best)
    weight, peak_opacity, brief = seen.mean(0), seen.max(0), (seen > 0).mean(0) < BRIEF
    s = _at_their_time(candidates, times, peak)
    finite = np.isfinite(np.concatenate([s.position, s.scale, s.features], 1)).all(1)
    usable = np.flatnonzero(_inside(s.position, box) & finite & (weight > 0))
    importance = weight * _area(s.scale)
    kind = np.where(brief, 1 + peak, 0)
    order = usable[_fair_order(s.position[usable], kind[usable], importance[usable], box, limit)]
    larger = float(min(np.sqrt(importance[usable].sum() / max(importance[order].sum(), 1e-30)), MOST_LARGER))
    edge = EDGE * larger * np.sqrt(peak_opacity[order])
    chosen = candidates.take(order)
    shown = slice_model(chosen, times[best], cull=False)
    fine = np.flatnonzero(np.isfinite(np.concatenate([shown.position, shown.features], 1)).all(1))
    shown, order, edge = _take(shown, fine), order[fine], edge[fine]
    return Points(
        index=every[order].astype(np.int32),
        position=shown.position.astype(np.float32),
        colour=_colour(shown, model).astype(np.float32),
        radius=(edge * np.sqrt(_area(shown.scale))).astype(np.float32),
        larger=larger,
        t=moment,
        box=np.array(box),
        subject=subject,
    )


def show(chosen: GaussianModel, t: float, larger: float = 1.0, look: np.ndarray | None = None) -> Shown:
    """Compute the ellipsoids and colours of chosen Gaussians, a model of their own, at the time t; `larger` as in Points.

    look  their object's, a row of looks.look_numbers(); None: as in the file
    """
    look = look_numbers(ObjectSettings(), chosen.colour_space) if look is None else look
    s = slice_model(chosen, t, cull=False)
    finite = np.isfinite(np.concatenate([s.position, s.scale, s.features], 1)).all(1)
    opacity = np.minimum(s.opacity * look[Look.OPACITY], 1)
    seen = finite & (opacity >= chosen.raster.alpha_cut)
    with np.errstate(over="ignore", invalid="ignore"):
        seen &= 1 + np.exp(-chosen.opacity.astype(np.float64)) <= look[Look.FAINTEST]
        size = EDGE * larger * np.sqrt(opacity) * size_factor(s.scale.max(1), look)
        axes = rotations.to_matrices(s.rotation) * (size[:, None] * s.scale)[:, None, :]
    return Shown(
        position=np.where(finite[:, None], s.position, 0).astype(np.float32),
        axes=np.where(seen[:, None, None], axes, 0).astype(np.float32),
        colour=_colour(s, chosen, look).astype(np.float32))


def shared_out(count: int, shares: list[float]) -> np.ndarray:
    """Distribute `count` points over several pictures in proportion to their shares, evenly: the number of the picture of each point
    [count]."""
    ends = np.cumsum(shares) / np.sum(shares)
    return np.searchsorted(ends[:-1], (np.arange(count) + 0.5) * GOLDEN % 1, "right")


def _every(model) -> np.ndarray:
    """The candidates: all Gaussians outside of the backdrop, or every n-th of them."""
    inside = inside_backdrop(model)
    return inside[np.linspace(0, len(inside) - 1, CANDIDATES).astype(int)] if len(inside) > CANDIDATES else inside


def _visibility(candidates, times, best):
    """(the moment [C] at which each is seen best, the opacity with which each is seen [T, C])."""
    opacity = sigmoid(candidates.opacity)
    seen = np.stack([opacity * candidates.temporal_kind.factor(t, candidates.mu_tau, candidates.temporal) for t in times])
    seen = np.where(np.isfinite(seen) & (seen >= candidates.raster.alpha_cut), seen, 0)
    return np.where(seen[best] >= 0.9 * seen.max(0), best, seen.argmax(0)), seen


def _at_their_time(candidates, times, peak) -> Slice:
    """Each candidate at the moment at which it is seen best."""
    parts, places = [], []
    for moment in np.unique(peak):
        here = np.flatnonzero(peak == moment)
        parts.append(slice_model(candidates.take(here), times[moment], cull=False))
        places.append(here)
    order = np.argsort(np.concatenate(places), kind="stable")
    return Slice(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in vars(parts[0])})


def _sample(source: Source, t: float, limit: int) -> tuple[Slice, float]:
    """The Gaussians that are visible at t, or every n-th of them, and the inverse of the share that was taken."""
    model, t = source.moment(t, hold=True)
    model = without_backdrop(model)
    sigma = sigmoid(model.opacity) * model.temporal_kind.factor(t, model.mu_tau, model.temporal)
    visible = np.flatnonzero(sigma >= model.raster.alpha_cut)
    every = visible[np.linspace(0, len(visible) - 1, limit).astype(int)] if len(visible) > limit else visible
    s = slice_model(model.take(every), t)
    finite = np.isfinite(np.concatenate([s.position, s.scale, s.features], 1)).all(1)
    return _take(s, np.flatnonzero(finite)), len(visible) / max(len(every), 1)


def _take(s: Slice, index) -> Slice:
    return Slice(**{name: value[index] for name, value in vars(s).items()})


def _area(scale: np.ndarray) -> np.ndarray:
    """What a Gaussian covers at most: the product of its two larger standard deviations [M]."""
    ordered = np.sort(scale, axis=1)
    return ordered[:, 1] * ordered[:, 2]


def _inside(position: np.ndarray, box) -> np.ndarray:
    return ((position >= box[0]) & (position <= box[1])).all(1)


def _robust_box(clouds: list[np.ndarray]):
    """(low, high) of the subject at all times; None where there is nothing."""
    found = [p[is_subject(p)] for p in clouds if len(p)]
    return (np.min([p.min(0) for p in found], axis=0), np.max([p.max(0) for p in found], axis=0)) if found else None


def _fair_order(position, kind, importance, box, limit: int) -> np.ndarray:
    """Indices of at most `limit` of M candidates.

    Each cell of a grid gives its most important one first, then each its second, and so on; each kind [M] has cells of its own.  The
    grid is the finest of which every filled cell has its turn, so that no place is left out for being less important than others.
    """
    finest = max((box[1] - box[0]).max(), 1e-6) / CELLS
    place = ((position - box[0]) / finest).astype(np.int64)
    for halvings in range(CELLS.bit_length()):
        key = (place >> halvings) @ [1, CELLS + 1, (CELLS + 1) ** 2] + kind * (CELLS + 1) ** 3
        if len(np.unique(key)) * TURNS <= limit:
            break
    by_cell = np.lexsort((-importance, key))
    sorted_key = key[by_cell]
    first = np.flatnonzero(np.diff(sorted_key, prepend=-1))
    rank = np.arange(len(key)) - np.repeat(first, np.diff(first, append=len(key)))
    return by_cell[np.lexsort((-importance[by_cell], rank))][:limit]


def _colour(s: Slice, model: GaussianModel, look: np.ndarray | None = None) -> np.ndarray:
    """Linear colour [M, 3] from no particular side: of SH the constant term, of features the base without the decoder's rest."""
    rgb = model.appearance.plain_colours(s.features)
    return linear(rgb if look is None else graded(np.clip(np.nan_to_num(rgb), 0, 100), look), model.colour_space)
