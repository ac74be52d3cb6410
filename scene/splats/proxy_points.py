# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the few points that stand for a model in Solid view and in other render engines.

Plain arrays, no Blender.  Everything is drawn without chance, so that the same file gives the same proxy.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.model.framing import is_subject, without_backdrop
from ...fastgs_blender.model.gaussians import GaussianModel
from ...fastgs_blender.model.sequence import Source
from ...fastgs_blender.model.slicing import Slice, sigmoid, slice_model
from ..colour import srgb_to_linear

LIMIT = 20_000
"""The most points of a proxy."""

MOMENTS = 9
"""At so many times of the clip the model is looked at for its extent."""

PROBES = 50_000
CANDIDATES = 200_000
CELLS = 64
TURNS = 3


@dataclass(frozen=True, eq=False)
class Points:
    """M points in the model's space, float32.

    position  [M, 3]
    colour    [M, 3]  linear Rec.709, 0 or more
    radius    [M]     about half the distance to the next point
    t         the model time that most of them are taken from
    """

    position: np.ndarray
    colour: np.ndarray
    radius: np.ndarray
    t: float


def choose(model: Source, limit: int = LIMIT) -> Points:
    """At most `limit` points of the model: important ones (opaque, large), from everywhere.

    They show the time at which most is to be seen.  Up to six of them are the outermost Gaussians of the whole clip, so that
    the points' bounding box holds the motion.  The backdrop, and lone Gaussians far outside (floaters), are left out of both.
    """
    frames = model.clip.frame_count
    times = sorted({round(x) / frames for x in np.linspace(0, frames - 1, MOMENTS)})
    moments = [_sample(model, t, PROBES) for t in times]
    box = _robust_box([s.position for s, _ in moments])
    if limit < 1 or box is None:
        return Points(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32), times[0])
    moments = [(_within(s, box), share) for s, share in moments]
    best = int(np.argmax([s.opacity.sum() * share for s, share in moments]))
    s = _within(_sample(model, times[best], CANDIDATES)[0], box)
    corners = min(6, limit // 10)
    order, spacing = _fair_order(s, box, limit - corners)
    parts = [_take(s, order)]
    parts += _outermost([s for s, _ in moments], box, parts[0])[:corners]
    size = 1.5 * np.concatenate([np.sqrt(_area(p)) for p in parts])
    return Points(
        position=np.concatenate([p.position for p in parts]).astype(np.float32),
        colour=np.concatenate([_colour(p, model.moment(times[best], hold=True)[0]) for p in parts]).astype(np.float32),
        radius=np.clip(size, 0.5 * spacing, max(spacing, np.median(size))).astype(np.float32),
        t=times[best],
    )


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


def _area(s: Slice) -> np.ndarray:
    """What a Gaussian covers at most: the product of its two larger standard deviations [M]."""
    ordered = np.sort(s.scale, axis=1)
    return ordered[:, 1] * ordered[:, 2]


def _within(s: Slice, box) -> Slice:
    return _take(s, np.flatnonzero(_inside(s.position, box)))


def _inside(position: np.ndarray, box) -> np.ndarray:
    return ((position >= box[0]) & (position <= box[1])).all(1)


def _robust_box(clouds: list[np.ndarray]):
    """(low, high) of the subject at all times; None where there is nothing."""
    found = [p[is_subject(p)] for p in clouds if len(p)]
    return (np.min([p.min(0) for p in found], axis=0), np.max([p.max(0) for p in found], axis=0)) if found else None


def _outermost(slices: list[Slice], box, chosen: Slice) -> list[Slice]:
    """For each face of the box that no chosen Gaussian touches, one that does."""
    found = []
    for axis in range(3):
        for face in (box[0][axis], box[1][axis]):
            if not (chosen.position[:, axis] == face).any():
                touching = ((s, np.flatnonzero(s.position[:, axis] == face)[:1]) for s in slices)
                found.append(_take(*next(pair for pair in touching if len(pair[1]))))
    return found


def _fair_order(s: Slice, box, limit: int) -> tuple[np.ndarray, float]:
    """Indices of at most `limit` Gaussians, and the distance between neighbours.

    Each cell of a grid gives its most important one first, then each its second, and so on.  The grid is the finest of which
    every filled cell has its turn, so that no place is left out for being less important than others.
    """
    finest = max((box[1] - box[0]).max(), 1e-6) / CELLS
    place = ((s.position - box[0]) / finest).astype(np.int64)
    for halvings in range(CELLS.bit_length()):
        key = (place >> halvings) @ [1, CELLS + 1, (CELLS + 1) ** 2]
        if len(np.unique(key)) * TURNS <= limit:
            break
    cell = finest * 2**halvings
    importance = s.opacity * _area(s)
    by_cell = np.lexsort((-importance, key))
    sorted_key = key[by_cell]
    first = np.flatnonzero(np.diff(sorted_key, prepend=-1))
    rank = np.arange(len(key)) - np.repeat(first, np.diff(first, append=len(key)))
    order = by_cell[np.lexsort((-importance[by_cell], rank))][:limit]
    return order, cell * float(np.sqrt(len(first) / max(len(order), 1)))


def _colour(s: Slice, model: GaussianModel) -> np.ndarray:
    """Linear colour [M, 3] from no particular side: of SH the constant term, of features the base without the decoder's rest."""
    rgb = np.clip(model.appearance.plain_colours(s.features), 0, 100)
    return rgb if model.colour_space == "linear" else srgb_to_linear(rgb)
