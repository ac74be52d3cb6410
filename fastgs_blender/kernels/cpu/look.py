# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks of one Gaussian inside kernels, as rendering/looks.py states them; `look` is a row of look_numbers()."""
from __future__ import annotations

import numpy as np

from ...rendering.colour import SRGB_CUT, SRGB_GAMMA, SRGB_LINEAR_CUT, SRGB_OFFSET, SRGB_SLOPE
from ...rendering.looks import Look
from .jit import inline
from .lanes import where

OPACITY, FAINTEST, SCALE, SMALLEST, LARGEST, SIZED, GRADED, LINEAR, FACTOR, POWER, MATRIX, _ = (int(place) for place in Look)


@inline
def size_factor(scale, look):
    """What multiplies the standard deviations of a Gaussian with the largest one `scale`."""
    return where(scale > 0.0, min(max(scale * look[SCALE], look[SMALLEST]), look[LARGEST]) / scale, 1.0)


@inline
def _to_linear(x):
    a = abs(x)
    return np.copysign(a / SRGB_SLOPE if a <= SRGB_CUT else ((a + SRGB_OFFSET) / (1 + SRGB_OFFSET)) ** SRGB_GAMMA, x)


@inline
def _to_srgb(x):
    return x * SRGB_SLOPE if x <= SRGB_LINEAR_CUT else (1 + SRGB_OFFSET) * x ** (1 / SRGB_GAMMA) - SRGB_OFFSET


@inline
def grade(colour, look):
    """Change a colour [3] in place."""
    linear = look[LINEAR] != 0.0
    r, g, b = colour[0], colour[1], colour[2]
    if not linear:
        r, g, b = _to_linear(r), _to_linear(g), _to_linear(b)
    for row in range(3):
        at = MATRIX + 3 * row
        x = look[FACTOR] * max(look[at] * r + look[at + 1] * g + look[at + 2] * b, 0.0) ** look[POWER]
        colour[row] = x if linear else _to_srgb(x)
