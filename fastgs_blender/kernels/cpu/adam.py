# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam (Kingma and Ba 2015) in place, for the rows that a step has seen.

A row that is seen in one of P steps goes sqrt(P) as far in it.  So it does by the usual Adam, whose second moment is P times smaller there,
but which moves all rows in every step.  By steps of one length, what few cameras see is left behind (docs/notes/learning-rates.md).
"""
from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import float32

from .jit import kernel

EPSILON = 1e-15
LONGEST = 16
"""A row that was seen longer ago goes no farther."""
STEPS = 1 << 16
"""From this step on there is nothing left to correct."""


@cache
def corrections(beta1: float, beta2: float) -> np.ndarray:
    """[STEPS, 2] float32: at step n, 1 / (1 - beta1^n) and 1 / sqrt(1 - beta2^n)."""
    n = np.maximum(np.arange(STEPS, dtype=np.float64), 1)
    return np.stack([1 / (1 - beta1**n), 1 / np.sqrt(1 - beta2**n)], 1).astype(np.float32)


def reach(since: np.ndarray) -> np.ndarray:
    """How far rows [R] go whose step stands for so many, in rates: float32."""
    return np.sqrt(np.minimum(since, LONGEST), dtype=np.float32)


@kernel
def adam(first, last, rows, reach, value, gradient, mean, square, count, rate, floor, beta1, beta2, table):
    """A step of the rows rows[first:last] of value [N, D], downhill.

    reach         [R] float32, a factor on the rate of each of the rows
    gradient      [N, D]; what is no finite number counts as zero
    mean, square  [N, D]: Adam's moments
    count         [N] int32: the steps each row has taken; each corrects its own bias, as a row that is seldom seen is young for long
    rate          [D]
    floor         added to the root of the second moment: what hardly any gradient pulls at stays where it is
    table         corrections(beta1, beta2)
    """
    keep1, keep2 = float32(beta1), float32(beta2)
    add1, add2 = float32(1 - beta1), float32(1 - beta2)
    tiny, zero, most = float32(1e-30), float32(0), float32(np.inf)
    for k in range(first, last):
        i = rows[k]
        count[i] += 1
        n = min(count[i], len(table) - 1)
        c1, c2 = table[n, 0] * reach[k], table[n, 1]
        for c in range(value.shape[1]):
            g = gradient[i, c]
            g = g if abs(g) < most else zero
            m = keep1 * mean[i, c] + add1 * g
            m = m if abs(m) > tiny else zero  # numbers that fade away become slow before they become nothing
            s = keep2 * square[i, c] + add2 * g * g
            mean[i, c], square[i, c] = m, s
            value[i, c] -= rate[c] * c1 * m / (math.sqrt(s) * c2 + floor)
