# SPDX-License-Identifier: GPL-3.0-or-later
"""What joins the Gaussians of a model: neighbours in place and velocity, and those that follow each other; and how alike two are."""
from dataclasses import dataclass

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at, positions_at
from ..rendering.filters import base_colours
from ..util.kept import kept
from .neighbours import nearest
from .succession import successions

TIMES = 9
"""Moments of the clip at which Gaussians are compared; at every second one of them their neighbours are looked for."""
COUNT = 8
"""Neighbours of a Gaussian at a moment."""
ALIVE = 0.05
"""Opacity from which on a Gaussian counts at a moment."""
STRETCH, TINT = 0.15, (0.04, 0.1)
"""Differences that count as none: a change of distance by the usual distance of neighbours, and a distance of colours (0..1).  In a model
whose neighbours differ more than that, it is twice their median; of colours at most the second: hidden Gaussians and fine patterns differ
much in trained models, and a red ball still ends at a white wall."""
DRIFT = (0.03, 0.1)
"""What counts as no change of distance, too: this share, at least and at most, of how far the two travel.  In trained models the Gaussians
of a thing drift apart, the more the farther it goes."""
FIRM, FAR = 4.0, 5.0
"""The share is so many times the change that the firmest quarter of joins has, of those that travel FAR usual distances."""
MOST_STRETCH, MOST_TINT = 12.0, 6.0
"""The most of `drift` and of `tint`: a thing has several colours, but does not come apart."""
FOLLOWS = 0.7
"""The `drift` of two Gaussians of which one follows the other: they hold each other half as strongly as others."""
NEAREST = 0.3
"""Joins get no stronger below this distance, in units of the usual one."""
LOOSE = 1e-6
"""Least weight of a join."""


@dataclass(frozen=True, eq=False)
class Joins:
    """Pairs of neighbours.

    ends    [E, 2] int32, each pair once
    near    [E] float32, their least distance, in units of the usual one of their neighbours; where one follows the other, when they meet
    drift   [E] float32, how much they drift apart: 0 on, about 1 is unusual
    tint    [E] float32, the same of how much they differ in colour
    first   from this number on, the Gaussians of joins follow each other
    """

    ends: np.ndarray
    near: np.ndarray
    drift: np.ndarray
    tint: np.ndarray
    first: int

    def of(self, some: np.ndarray) -> "Joins":
        """Those by which a thing is found, of which some Gaussians [N] bool are known: who follows whom counts where half of these do."""
        follow = np.zeros(len(some), bool)
        follow[self.ends[self.first:]] = True
        if follow[some].mean() >= 0.5:
            return self
        return Joins(self.ends[:self.first], self.near[:self.first], self.drift[:self.first], self.tint[:self.first], self.first)

    def held(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """How strongly each pair holds together [E] float32, and the sum [count] of what meets in each Gaussian."""
        weight = (np.exp(-self.drift - self.tint) / np.maximum(self.near, NEAREST) ** 2 + LOOSE).astype(np.float32)
        i, j = self.ends.T
        return weight, np.bincount(i, weight, count) + np.bincount(j, weight, count) + LOOSE


@kept
@np.errstate(all="ignore")
def joins(model: GaussianModel) -> Joins:
    """The joins of a model's Gaussians, kept while it lives.  Gaussians that are never seen have none."""
    from ..kernels.cpu.walk import distances  # it brings numba, which enabling the add-on must not

    times = (np.arange(TIMES) + 0.5) / TIMES
    place = np.stack([positions_at(model, t) for t in times]).astype(np.float32)
    alive = np.stack([opacities_at(model, t) >= ALIVE for t in times])
    changes = model.basis.terms > 0 or not (alive == alive[0]).all()
    keys, usual, weight = [np.zeros(0, np.int64)], np.zeros(len(model)), np.zeros(len(model))
    for k in range(0, TIMES, 2) if changes else [0]:
        rows = np.flatnonzero(alive[k])
        if len(rows) < 2:
            continue
        velocity = model.basis.rate(model.motion[rows], times[k], model.mu_tau[rows])
        index, squared = nearest(np.concatenate([place[k][rows], 0.5 * velocity / TIMES], 1), COUNT, trees=2, leaf=48)
        there = index >= 0
        usual[rows] += np.sqrt(np.where(there, squared, 0)[:, :COUNT // 2]).mean(1)
        weight[rows] += 1
        i, j = np.repeat(rows, index.shape[1])[there.ravel()], rows[index[there]]
        keys.append(np.minimum(i, j) * len(model) + np.maximum(i, j))
    pairs = np.unique(np.concatenate(keys))
    i, j = ends = pairs // max(len(model), 1), pairs % max(len(model), 1)
    low, high = np.full(len(pairs), np.inf, np.float32), np.zeros(len(pairs), np.float32)
    distances(np.stack(ends, 1), place.transpose(1, 0, 2).copy(), alive.T.copy(), low, high)
    usual /= np.maximum(weight, 1)
    unit = np.maximum(0.5 * (usual[i] + usual[j]), 1e-9)
    colour = np.clip(base_colours(model), 0, 1)  # what is brighter looks white all the same
    change = (high - low) / unit
    drift = _unusual(change, _usual(change, STRETCH, np.inf) + _drift(place, alive, ends, high - low, unit), MOST_STRETCH)
    differs = np.linalg.norm(colour[i] - colour[j], axis=1)
    tint = _unusual(differs, _usual(differs, *TINT), MOST_TINT)
    near, drift, tint = (each.astype(np.float32) for each in (low / unit, drift, tint))
    found = Joins(np.stack(ends, 1).astype(np.int32), near, drift, tint, len(pairs))
    if not changes:
        return found
    more, apart = successions(model, found.ends, found.held(len(model))[0], usual, ALIVE)
    other = _unusual(np.linalg.norm(colour[more[:, 0]] - colour[more[:, 1]], axis=1), _usual(differs, *TINT), MOST_TINT)
    follows = np.full(len(more), FOLLOWS, np.float32)
    near, drift, tint = (np.concatenate(both, dtype=np.float32) for both in ((near, apart), (drift, follows), (tint, other)))
    return Joins(np.concatenate([found.ends, more], dtype=np.int32, casting="same_kind"), near, drift, tint, len(pairs))


def _drift(place: np.ndarray, alive: np.ndarray, ends: tuple, change: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """The changes of distance [E], in units of the usual one, that count as none because the two of each join travel."""
    low, high = (edge(np.where(alive[..., None], place, other), 0) for edge, other in ((np.min, np.inf), (np.max, -np.inf)))
    own = np.linalg.norm(np.maximum(high - low, 0), axis=1)
    travel = np.maximum(own[ends[0]], own[ends[1]]) / unit
    far = (travel > FAR) & (change > -np.inf)  # -inf: never seen at the same time
    return travel * np.clip(FIRM * np.quantile((change / unit / travel)[far], 0.25) if far.any() else 0, *DRIFT)


def _usual(value: np.ndarray, least: float, most: float) -> float:
    return float(np.clip(2 * float(np.median(value)) if len(value) else 0.0, least, most))


def _unusual(value: np.ndarray, usual: float | np.ndarray, most: float) -> np.ndarray:
    return np.minimum(0.5 * (value / usual) ** 2, most)
