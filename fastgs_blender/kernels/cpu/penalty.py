# SPDX-License-Identifier: GPL-3.0-or-later
"""Norms of the coefficients of motion and their gradients, one pass over [N, columns]."""
from __future__ import annotations

import numpy as np
from numba import float32

from .jit import kernel


@kernel
def magnitudes(first, last, values, width, factor, times, gradient, sums):
    """sums [columns] += sum over rows of |value|, rounded off below `width`; gradient [N, columns] = its gradient * factor * times.

    |x| is Huber's: x^2 / (2 width) below the width, |x| - width / 2 above.  factor [columns]; times [N], rows of 0 stay as they are.
    """
    inverse, half, one = float32(1 / width), float32(0.5 * width), float32(1)
    slopes = np.empty(values.shape[1], np.float32)
    for n in range(first, last):
        for c in range(values.shape[1]):
            x = values[n, c]
            slope = x * inverse
            slope = slope if slope < one else one
            slope = slope if slope > -one else -one
            sums[c] += slope * (x - half * slope)
            slopes[c] = slope
        if times[n] != float32(0):
            for c in range(values.shape[1]):
                gradient[n, c] += slopes[c] * factor[c] * times[n]


@kernel
def squares(first, last, values, sums):
    """sums [columns] += sum over rows of value^2."""
    for n in range(first, last):
        for c in range(values.shape[1]):
            sums[c] += values[n, c] * values[n, c]


@kernel
def scaled(first, last, values, factor, times, gradient):
    """gradient [N, columns] += values * factor [columns] * times [N]."""
    for n in range(first, last):
        if times[n] != float32(0):
            for c in range(values.shape[1]):
                gradient[n, c] += values[n, c] * factor[c] * times[n]
