# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians take the place of which: in a model of films, what moves fast is other Gaussians at each moment.

A Gaussian goes on in a straight line before and after its life, as it went in the nearer half of it.  One that ends and one that begins
follow each other if they meet in this way.  Where lasting Gaussians hold one, these tell what belongs to it: a floor that flickers is no
thrown ball.
"""
import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from .neighbours import nearest

LIFE = 0.6
"""The share of the clip from which on a Gaussian that is seen lasts."""
SURE = 0.7
"""The least factor of its opacity at which a Gaussian's place is sure: nothing in the films holds what is hardly seen."""
BEYOND, FRAMES = 0.75, 2.0
"""How far it goes on before and after that time, by the length of that; and at least so many frames."""
MOMENTS = 512
"""The most moments at which Gaussians are compared; else every frame."""
HELD = 0.1
"""The most of what joins a Gaussian that may join it to lasting ones."""
COUNT, FEW, FAR = 16, 4, 4.0
"""Of so many neighbours the nearest FEW that end where it begins, or begin where it ends, up to this distance in units of the usual one."""
ROUGH = 0.01
"""So much of their velocities counts among neighbours, by the length of the clip: they are rough where a life is short."""
WAY = 0.5
"""So much of how far they would drift apart in the shorter of the two lives counts as distance: two that pass do not follow each other."""


def successions(model: GaussianModel, ends: np.ndarray, weight: np.ndarray, usual: np.ndarray,
                alive: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of short-lived Gaussians of which one follows the other: [F, 2], and their distances in units of the usual one [F].

    ends [E, 2], weight [E] are the joins of neighbours; usual [N] is their usual distance, 0 where none is known; alive is the opacity
    from which on a Gaussian counts
    """
    rows = _loose(model, ends, weight, alive)
    if not len(rows):
        return np.zeros((0, 2), np.int64), np.zeros(0)
    count, step = len(model), 1 / np.clip(model.clip.frame_count, 1, MOMENTS)
    usual = np.where(usual > 0, usual, np.median(usual[usual > 0]) if (usual > 0).any() else 1)
    span = model.temporal_kind.span(np.full(len(rows), -np.log(SURE)), model.mu_tau[rows], model.temporal[rows])
    begin, end = np.clip(span.begin, 0, 1), np.clip(span.end, 0, 1)
    half = np.maximum((end - begin) / 2, step / 10)
    first, last = _places(model, rows, begin), _places(model, rows, end)
    coming = (_places(model, rows, begin + half) - first) / half[:, None]
    going = (last - _places(model, rows, end - half)) / half[:, None]
    beyond = np.maximum(BEYOND * (end - begin), FRAMES * step)
    keys, near = [np.zeros(0, np.int64)], [np.zeros(0, np.float32)]
    for t in np.arange(0.5 * step, 1, step):
        here = np.flatnonzero((begin - beyond <= t) & (t <= end + beyond) & ((t < begin) | (t > end)))
        if len(here) < 2:
            continue
        begins = t < begin[here]
        velocity = np.where(begins[:, None], coming[here], going[here])
        place = np.where(begins[:, None], first[here], last[here]) + velocity * (t - np.where(begins, begin[here], end[here]))[:, None]
        index, squared = nearest(np.concatenate([place, ROUGH * velocity], 1), COUNT, trees=2, leaf=48)
        follows = (index >= 0) & (begins[index] != begins[:, None])
        i, k = np.nonzero(follows & (np.cumsum(follows, 1) <= FEW))
        j = index[i, k]
        way = WAY * np.minimum(*(end - begin)[here[np.stack([i, j])]])
        apart = np.sqrt(squared[i, k] + way**2 * ((velocity[i] - velocity[j]) ** 2).sum(1))
        i, j = rows[here[np.stack([i, j])]]
        apart /= 0.5 * (usual[i] + usual[j])
        keys.append((np.minimum(i, j) * count + np.maximum(i, j))[apart < FAR])
        near.append(apart[apart < FAR])
    key, apart = np.concatenate(keys), np.concatenate(near)
    nearest_first = np.lexsort((apart, key))
    key, which = np.unique(key[nearest_first], return_index=True)
    low, high = np.sort(ends, 1).T.astype(np.int64)
    new = ~np.isin(key, low * count + high)
    key, which = key[new], which[new]
    return np.stack([key // max(count, 1), key % max(count, 1)], 1), apart[nearest_first][which]


def _loose(model: GaussianModel, ends: np.ndarray, weight: np.ndarray, alive: float) -> np.ndarray:
    """The numbers of the short-lived Gaussians that hardly any lasting one holds."""
    visible = np.log(np.maximum(sigmoid(model.opacity) / alive, 1e-9))
    span = model.temporal_kind.span(np.maximum(visible, 0), model.mu_tau, model.temporal)
    seen = (visible > 0) & (span.end > 0) & (span.begin < 1)
    short = seen & (np.minimum(span.end, 1) - np.maximum(span.begin, 0) < LIFE)
    held, lasting = np.zeros(len(short)), np.zeros(len(short))
    for one, other in ends.T, ends.T[::-1]:
        held += np.bincount(one, weight, len(short))
        lasting += np.bincount(one, weight * ~short[other], len(short))
    return np.flatnonzero(short & (lasting <= HELD * held))


def _places(model: GaussianModel, rows: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Where Gaussians are, each at its own time [M]: [M, 3]."""
    weights = model.basis.weights(t - model.mu_tau[rows] if model.basis.centred else t)
    return model.position[rows] + np.einsum("nk,nkd->nd", weights, model.motion[rows].astype(np.float64))
