# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds numbers to whole steps, where bits are worth more than the error: rate-distortion optimised quantisation.

The parameters of a Gaussian share their step sizes, though pictures change with some of them much less than with others: with how thick a
disc is, for example.  Such a number is rounded to one that is farther away and costs fewer bits.  A whole number c costs about
TAIL log2(1 + |c|) bits.  One more bit for a parameter whose step is the one that its own sensitivity asks for lowers the squared error by
2 ln 2 / 12 of the step's square.  So, with `ease` the ratio of this step to the shared one, the best c for x minimises

    (x - c)^2 + pull ln(1 + |c|),   pull = ease^2 TAIL / 6
"""
from __future__ import annotations

from math import floor, log1p, sqrt

import numpy as np

TAIL = 2.0
"""How steeply large numbers become rare: c occurs in proportion to (1 + |c|)^-TAIL."""
EASIEST = 8.0
"""The largest ratio that is believed: few pictures may have shown a parameter."""


def pulls(own: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The pull on numbers whose own steps and shared steps are these."""
    return np.minimum(own / step, EASIEST) ** 2 * (TAIL / 6)


def rounded(x: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """The best whole numbers for x, int64 of its shape."""
    size = np.abs(x)
    root = np.maximum((size + 1) ** 2 - 2 * pull, 0)
    code = np.where(root > 0, np.floor(0.5 * (size + np.sqrt(root))), 0)
    code = np.where(pull * np.log1p(code) > size**2 - (size - code) ** 2, 0, code)
    return np.copysign(code, x).astype(np.int64)


def chained(values: np.ndarray, step: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Whole numbers [N, D] whose running sums, each times its step [N, 1], stay near values [N, D]; pull [N, D]."""
    out = np.empty(values.shape, np.int64)
    steps = step[:, 0].tolist()
    for k, (column, pulled) in enumerate(zip(values.T.tolist(), pull.T.tolist(), strict=True)):
        sum_, codes = 0.0, []
        for value, own, strength in zip(column, steps, pulled, strict=True):
            x = (value - sum_) / own
            size = abs(x)
            root = (size + 1) ** 2 - 2 * strength
            code = floor(0.5 * (size + sqrt(root))) if root > 0 else 0
            if code and strength * log1p(code) > size**2 - (size - code) ** 2:
                code = 0
            if code:
                code = code if x > 0 else -code
                sum_ += code * own
            codes.append(code)
        out[:, k] = codes
    return out
