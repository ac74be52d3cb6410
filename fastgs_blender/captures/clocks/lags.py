# SPDX-License-Identifier: GPL-3.0-or-later
"""Aligns curves over time that contain the same events: finds the time offset of each, to a fraction of a sample."""
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...util import groups

LEAST_COMMON = 12
"""Samples in which two curves must overlap, and the least share of the shorter one."""
COMMON_SHARE = 0.5
FINE = 0.02
"""Samples between two shifts that are tried near the best whole one."""
ROUNDS = 60
EACH = 4
"""Values for each number that is fitted to them."""


@dataclass(frozen=True)
class Pair:
    """Curve j shows at sample s what curve i shows at s + lag.

    error   standard deviation of the lag
    alone   how much better this lag fits than any other
    alike   the curves' correlation at this lag, -1..1
    common  samples that both curves have, as many as tell something of their own: what changes slowly is told by each of them again
    """

    i: int
    j: int
    lag: float
    error: float
    alone: float
    alike: float = 1.0
    common: float = 0.0


def compared(curves: Sequence[np.ndarray], i: int, j: int, most: int, error: float) -> Pair | None:
    """The best lag of two curves within +-most samples; None where they overlap too little, or one of them is flat."""
    a, b = curves[i], curves[j]
    least = max(LEAST_COMMON, int(COMMON_SHARE * min(len(a), len(b))))
    lags = [lag for lag in range(-most, most + 1) if min(len(a) - lag, len(b)) - max(-lag, 0) >= least]
    if not lags:
        return None
    alike = np.array([_alike(a, b, float(lag)) for lag in lags])
    common = np.array([min(len(a) - lag, len(b)) - max(-lag, 0) for lag in lags])
    alike *= np.sqrt(common / common.max())  # short pieces are alike by chance
    best = int(np.argmax(alike))
    if alike[best] <= 0:
        return None
    away = np.abs(np.arange(len(lags)) - best) > 2
    inner = np.r_[False, (alike[1:-1] >= alike[:-2]) & (alike[1:-1] >= alike[2:]), False] if len(lags) > 2 else np.zeros(len(lags), bool)
    others = alike[away & inner]
    fine = lags[best] + np.arange(-1, 1 + FINE / 2, FINE)
    closer = np.array([_alike(a, b, lag) for lag in fine])
    top = int(np.argmax(closer))
    alone = float(closer[top] - max(others.max(initial=0), 0))
    return Pair(i, j, float(fine[top]), error, alone, float(closer[top]), float(common[best]) / _repeated(a, b))


def _alike(a: np.ndarray, b: np.ndarray, lag: float) -> float:
    """The correlation of b [n] with a moved by lag samples, over what is common to both."""
    places = np.arange(len(b)) + lag
    inside = (places >= 0) & (places <= len(a) - 1)
    if inside.sum() < 3:
        return -1.0
    x, y = between(a, places[inside]), b[inside]
    x, y = x - x.mean(), y - y.mean()
    size = np.sqrt((x @ x) * (y @ y))
    return float(x @ y / size) if size > 1e-12 else -1.0


def _repeated(a: np.ndarray, b: np.ndarray) -> float:
    """How many samples of two curves tell what one would if they did not depend on each other (Bartlett 1946): at least 1."""
    alone = [line - line.mean() for line in (a, b)]
    steps = np.arange(1, max(min(len(a), len(b)) // 2, 1))
    first, second = (np.array([line[step:] @ line[:-step] for step in steps]) / max(line @ line, 1e-12) for line in alone)
    return float(max(1.0, 1 + 2 * first @ second))


def between(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """values [..., n] at places (samples, fractions lie between them) by Catmull and Rom's cubic; the ends are repeated."""
    n = values.shape[-1]
    first = np.clip(np.floor(places).astype(int), 0, max(n - 2, 0))
    u = places - first
    p0, p1, p2, p3 = (values[..., np.clip(first + k, 0, n - 1)] for k in (-1, 0, 1, 2))
    return p1 + 0.5 * u * (p2 - p0 + u * (2 * p0 - 5 * p1 + 4 * p2 - p3 + u * (3 * (p1 - p2) + p3 - p0)))


def offsets_from_pairs(count: int, pairs: Sequence[Pair]) -> tuple[np.ndarray, np.ndarray]:
    """(offsets [count], their standard deviations [count]) that agree best with the pairs; the median of the offsets is 0.

    The sum of absolute differences is least, so that a few wrong pairs do no harm.  Where pairs differ from the offsets by more than their
    errors, deviations grow.  What one pair alone tells has twice the deviation, as nothing contradicts it, also beside pairs that are far
    less exact; with four that are equally exact it is as it is.  What no pair reaches is NaN, with the deviation inf.
    """
    offsets, deviations = np.full(count, np.nan), np.full(count, np.inf)
    group = max(groups.joined(range(count), [(pair.i, pair.j) for pair in pairs]), key=len)
    pairs = [pair for pair in pairs if pair.i in group]
    if len(group) < 2:
        return offsets, deviations
    place = {camera: k for k, camera in enumerate(group)}
    rows = np.zeros((len(pairs), len(group)))
    for row, pair in zip(rows, pairs):
        row[place[pair.j]], row[place[pair.i]] = 1, -1
    lags, errors = (np.array([getattr(pair, name) for pair in pairs]) for name in ("lag", "error"))
    found = np.zeros(len(group))
    for _ in range(ROUNDS):
        weights = 1 / (errors * (np.abs(rows @ found - lags) + 1e-3))
        found = np.linalg.lstsq(np.sqrt(weights)[:, None] * rows, np.sqrt(weights) * lags, rcond=None)[0]
    away = np.abs(rows @ found - lags)
    weights = 1 / (errors**2 + away**2)
    information = rows.T @ (rows * weights[:, None])
    least = np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)))
    surprise = away / errors / 0.6745  # its median is 1 where the errors are right
    for camera, k in place.items():
        own = rows[:, k] != 0
        told_by = weights[own].sum() ** 2 / (weights[own] ** 2).sum()
        deviations[camera] = least[k] * max(1.0, np.median(surprise), np.median(surprise[own]), 2 / np.sqrt(told_by))
    offsets[group] = found - np.median(found)
    return offsets, deviations


def grown(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """What of values [n] grows evenly with places [n, 3], less its median; 0 where too few are known (not NaN) to tell it from chance.

    The sum of absolute differences is least, so that single values that stand out add nothing.
    """
    known = np.isfinite(values)
    axes = min(3, int(known.sum()) // EACH - 1)
    if axes < 1:
        return np.zeros(len(values))
    along = places - places[known].mean(0)
    along = along @ np.linalg.svd(along[known], full_matrices=False)[2][:axes].T
    terms = np.hstack([np.ones((len(values), 1)), along / max(np.abs(along).max(), 1e-30)])
    found = np.zeros(axes + 1)
    for _ in range(ROUNDS):
        weights = np.sqrt(1 / (np.abs(terms @ found - values)[known] + 1e-3))
        found = np.linalg.lstsq(weights[:, None] * terms[known], weights * values[known], rcond=None)[0]
    return terms @ found - np.median(terms[known] @ found)
