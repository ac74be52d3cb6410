# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds numbers to whole steps, where bits are worth more than the error: rate-distortion optimised quantisation.

The parameters of a Gaussian share their step sizes, though pictures change with some of them much less than with others: with how thick a
disc is, for example.  Such a number is rounded to one that is farther away and costs fewer bits.  A whole number c costs about
TAIL log2(1 + |c|) bits.  One more bit for a parameter whose step is the one that its own sensitivity asks for lowers the squared error by
2 ln 2 / 12 of the step's square.  So, with `ease` the ratio of this step to the shared one, the best c for x minimises

    (x - c)^2 + pull ln(1 + |c|),   pull = ease^2 TAIL / 6
"""
from collections.abc import Callable
from functools import cache
from math import floor, log1p, sqrt

import numpy as np

TAIL = 2.0
"""How steeply large numbers become rare: c occurs in proportion to (1 + |c|)^-TAIL."""
EASIEST = 8.0
"""The largest ratio that is believed: few pictures may have shown a parameter."""


def ldexp(values: np.ndarray | float, exponents: np.ndarray) -> np.ndarray:
    """values * 2^exponents, exact; on Windows NumPy takes no exponents of 64 bits."""
    return np.asarray(np.ldexp(values, exponents.astype(np.intc)))


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
    _kernel()(*(np.ascontiguousarray(array, np.float64) for array in (values, step[:, 0], pull)), out)
    return out


@cache
def _kernel() -> Callable[..., None]:
    from ..kernels.cpu.jit import kernel

    return kernel(_chain)


def _chain(values: np.ndarray, step: np.ndarray, pull: np.ndarray, out: np.ndarray) -> None:
    """Fills out [N, D]; each number depends on the one before, so that numpy is slow at it."""
    for k in range(values.shape[1]):
        sum_ = 0.0
        for i in range(len(values)):
            x = (values[i, k] - sum_) / step[i]
            size, strength = abs(x), pull[i, k]
            root = (size + 1) ** 2 - 2 * strength
            code = floor(0.5 * (size + sqrt(root))) if root > 0 else 0.0
            if code > 0 and strength * log1p(code) > size**2 - (size - code) ** 2:
                code = 0.0
            out[i, k] = np.int64(code if x > 0 else -code)
            sum_ += out[i, k] * step[i]
