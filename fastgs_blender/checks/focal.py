# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds a factor by which the focal lengths of all cameras are wrong alike: films are often cropped where photographs are not.

Each camera fits the others then nearly as well as ever, in the middle of its picture.  But matches of all pairs together are nearest to
their epipolar lines with other focal lengths.  Cameras that look in one direction tell nothing; those that look at one thing do.
"""
from dataclasses import replace

import numpy as np

from ..captures.evidence import differs
from ..training.initial import features
from .matching import Matches, Pair, off_lines

FACTORS = np.exp(np.linspace(-0.25, 0.25, 31))
"""Factors that are tried."""
LEAST = 0.02
"""Smallest change that is told, as a logarithm: training corrects less than that."""
GAIN = 1.2
"""By how many times the matches of half of the pairs must come nearer: a shallow minimum is one of noise."""
MOST = 200
"""Largest number of matches of a pair that are looked at."""


def common_factor(matches: Matches) -> float | None:
    """The factor that the focal lengths of all cameras lack, where pairs of cameras surely say so, whichever camera is left out."""
    off = np.array([_off(matches, pair) for pair in matches.pairs]).reshape(-1, len(FACTORS))
    views = {view for pair in matches.pairs for view in (pair.a, pair.b)}
    parts = [off[[view not in (pair.a, pair.b) for pair in matches.pairs]] for view in views]
    if len(parts) < 3 or not all(map(len, parts)):
        return None
    whole, each = _best(off), np.array([_best(part) for part in parts])
    deviation = float(np.sqrt((len(each) - 1) * each.var()))  # the jackknife's
    gain = np.median(off[:, len(FACTORS) // 2] / np.maximum(off[:, off.mean(0).argmin()], 1e-12))
    return float(np.exp(whole)) if gain > GAIN and differs(whole, deviation, LEAST) else None


def _off(matches: Matches, pair: Pair) -> list[float]:
    """The median distance in pixels of a pair's matches from their epipolar lines, with each of FACTORS: Sampson's, for noise adds as much
    to it with any factor."""
    rows = pair.rows[:: -(-len(pair.rows) // MOST)]
    one, other = (matches.features[pair.moment, view] for view in (pair.a, pair.b))
    places, theirs = one.places[rows[:, 0]], other.places[rows[:, 1]]
    found = []
    for factor in FACTORS:
        a, b = (replace(each.camera, fx=factor * each.camera.fx, fy=factor * each.camera.fy) for each in (one, other))
        matrix = features.fundamental(a, b)
        here, there = off_lines(matrix.T, theirs, places), off_lines(matrix, places, theirs)
        found.append(float(np.median(here * there / np.maximum(np.hypot(here, there), 1e-12))))
    return found


def _best(off: np.ndarray) -> float:
    """The logarithm of the factor with the least mean distance over pairs [P, F]; NaN at the end of what was tried."""
    mean = off.mean(0)
    k = int(mean.argmin())
    if not 0 < k < len(mean) - 1:
        return np.nan
    before, here, after = mean[k - 1:k + 2]
    step = np.log(FACTORS[1] / FACTORS[0])
    return float(np.log(FACTORS[k]) + step * (before - after) / 2 / max(before - 2 * here + after, 1e-12))
