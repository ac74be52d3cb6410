# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures how much brighter each camera films than the others, by the colours of points that several cameras see.

The logarithm of a colour is the point's plus that of the camera's gain: robust least squares over all points and cameras together.
(Medians of ratios to the points' medians are too near 1, because a point that few cameras see has their own colours as its median.)  Every
eighth of the points is held back once, which tells the standard deviations.
"""
import numpy as np

from ..util import groups
from .evidence import differs

DARK, BRIGHT = 0.04, 0.96
"""Colours (0..1) beyond which nothing is told of a camera's exposure."""
FEW, SHARED = 30, 12
"""Points of a camera, and of two cameras together, with fewer of which nothing is told."""
ROUNDS, OUTLYING = 12, 0.06
"""Rounds of robust least squares, and the difference of a colour's logarithm at which it counts half."""
PARTS = 8
LEAST_ERROR, LEAST = 0.01, 0.03
"""Standard deviation of a gain's logarithm at best, as surfaces and lenses are not even, and the least one that counts."""


def gains_of(colours: np.ndarray) -> np.ndarray:
    """Logarithms of the gains of V cameras, their median 0, and their standard deviations [V, 2, 3]; 0, 0 for a camera that has too few
    points in common with the others.

    colours  [P, V, 3] of P points, 0..1; NaN where a camera does not see one
    """
    table = np.where((colours < DARK) | (colours > BRIGHT), np.nan, colours)
    there = np.isfinite(table)
    there &= there.sum(1, keepdims=True) > 1  # alone, a colour tells nothing
    found, whole = np.zeros((colours.shape[1], 2, 3)), there.all(2)
    together = whole.T.astype(np.float64) @ whole
    pairs = [(i, j) for i, j in np.argwhere(together >= SHARED).tolist() if i < j]
    known = np.array(max(groups.joined(range(len(found)), pairs), key=len, default=[]), int)
    known = known[(there[:, known].sum(0) >= FEW).all(1)] if len(known) else known
    if len(known) < 2:
        return found
    logs = np.log(np.where(there, table, np.nan)[:, known])
    gains = _fitted(logs)
    rest = np.array([_fitted(logs[np.arange(len(logs)) % PARTS != part]) for part in range(PARTS)])
    spread = np.sqrt((PARTS - 1) / PARTS * ((rest - rest.mean(0)) ** 2).sum(0))
    found[known] = np.stack([gains, np.hypot(spread, LEAST_ERROR)], 1)
    return found


def brighter(gains: np.ndarray) -> np.ndarray:
    """Which cameras [V] are surely exposed otherwise: one channel of gains_of() counts."""
    return differs(gains[:, 0], gains[:, 1], LEAST).any(1)


def _fitted(logs: np.ndarray) -> np.ndarray:
    """Offsets [V, 3], their median 0, of colours' logarithms [P, V, 3]."""
    offsets = np.stack([_offsets(logs[..., channel]) for channel in range(3)], 1)
    return offsets - np.median(offsets, 0)


def _offsets(values: np.ndarray) -> np.ndarray:
    """Offsets [V] of columns: values [P, V], NaN where unknown, are a number of each row plus these, but for noise and outliers."""
    there = np.isfinite(values)
    values, weight = np.where(there, values, 0.0), there.astype(np.float64)
    offsets = np.zeros(values.shape[1])
    for _ in range(ROUNDS):
        total = np.maximum(weight.sum(1), 1e-9)
        # the rows' own numbers eliminated: normal equations of the columns alone
        matrix = np.diag(weight.sum(0)) - weight.T @ (weight / total[:, None])
        offsets = np.linalg.pinv(matrix) @ (weight * (values - ((weight * values).sum(1) / total)[:, None])).sum(0)
        own = (weight * (values - offsets)).sum(1) / total
        weight = there / (1 + ((values - offsets - own[:, None]) / OUTLYING) ** 2)
    return offsets
