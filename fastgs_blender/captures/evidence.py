# SPDX-License-Identifier: GPL-3.0-or-later
"""Decides whether a camera's clock, gain or pose differs from the others', by what two cameras that see the same thing show.

Each has its own measure: what moves in planes through two cameras (clocks/epipolar.py), colours of points that several cameras see
(gains.py), tracks of features that were held back (training/initial/refine.py).  Each gives a value with its standard deviation, and
the rule is one.
"""
import numpy as np
from numpy.typing import ArrayLike

SURE = 3.0
"""A value counts where it is so many standard deviations from 0."""
AROUND = 2.0
"""Training moves a value that counts within so many standard deviations of it: a poor model is sure of wrong values."""


def differs(values: ArrayLike, deviations: ArrayLike, least: float) -> np.ndarray:
    """Whether values are surely not 0: by SURE standard deviations, and by more than `least`.

    deviations  0 or not finite where nothing is known: such a value is unsure, and never counts
    """
    value, deviation = np.broadcast_arrays(np.asarray(values, np.float64), np.asarray(deviations, np.float64))
    known = np.isfinite(value) & np.isfinite(deviation) & (deviation > 0)
    return known & (np.abs(np.where(known, value, 0)) > np.maximum(least, SURE * np.where(known, deviation, 0)))


def median(values: ArrayLike) -> tuple[float, float]:
    """The median of values and its standard deviation, whatever their distribution: from the quantiles beside it; NaN of none."""
    known = np.asarray(values, np.float64)
    if not len(known):
        return np.nan, np.nan
    beside = 0.5 / np.sqrt(len(known))
    low, middle, high = np.quantile(known, [0.5 - beside, 0.5, 0.5 + beside])
    return float(middle), float(high - low) / 2


def limits(values: np.ndarray, deviations: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Between which training may move values [2, ...]: where `moves`, AROUND deviations to either side; else they stay 0."""
    return np.stack([np.where(moves, values + side * AROUND * deviations, 0.0) for side in (-1, 1)])
