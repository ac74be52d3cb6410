# SPDX-License-Identifier: GPL-3.0-or-later
"""Basis: all that a basis of time answers, with the answers of a basis that states no more than its weights.

A quantity with constant term c and coefficients c_k is  c + sum_k w_k(t) c_k.  The bases themselves are in motion.py.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import comb
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..util.errors import FastGSError

MAX_TERMS = 100_000
"""The most coefficients per axis."""
SAMPLES = 2049
"""Times at which the greatest speed and acceleration of a basis are looked for, where it does not state them."""

Family = Callable[[int], "Basis"]
"""Bases of one kind by order."""


@dataclass(frozen=True)
class Basis:
    """One basis of time.

    `centred` says which time it takes: False, the model's t, one set of weights for all Gaussians;
    True, t - mu_tau of each Gaussian, and then the weights must be the powers 1..K of it, as the kernels compute them.
    """

    name: ClassVar[str] = ""
    centred: ClassVar[bool] = False
    competes: ClassVar[bool] = False
    """Whether fits() under its own name take part where a fit chooses its basis itself."""

    @property
    def terms(self) -> int:
        """K, the number of coefficients per axis, the constant term not counted."""
        raise NotImplementedError

    def weights(self, t: ArrayLike) -> np.ndarray:
        """Weights [..., K] float64 at times t [...]."""
        raise NotImplementedError

    def rates(self, t: ArrayLike) -> np.ndarray:
        """Derivatives of the weights by t, [..., K] float64 at times t [...]."""
        raise NotImplementedError

    @property
    def max_frequency(self) -> float:
        """The highest frequency that the basis holds, in cycles per unit of t (0: no such limit)."""
        return 0.0

    def value(self, coefficients: np.ndarray, t: float, mu_tau: np.ndarray) -> np.ndarray:
        """Sum of the weighted coefficients [N, K, D] at t, a number, for mu_tau [N]: [N, D] float64."""
        return self._sum(self.weights, coefficients, t, mu_tau)

    def rate(self, coefficients: np.ndarray, t: float, mu_tau: np.ndarray) -> np.ndarray:
        """The derivative of value() by t, [N, D] float64."""
        return self._sum(self.rates, coefficients, t, mu_tau)

    def _sum(self, weigh: Callable[[ArrayLike], np.ndarray], coefficients: np.ndarray, t: float, mu_tau: np.ndarray) -> np.ndarray:
        time: ArrayLike = t - np.asarray(mu_tau, np.float64) if self.centred else float(t)
        form = "nk,nkd->nd" if self.centred else "k,nkd->nd"
        return np.einsum(form, weigh(time), np.asarray(coefficients, np.float64))

    def recentred(self, constant: np.ndarray, coefficients: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constant [N, D] and coefficients [N, K, D] of the same motion when mu_tau [N] moves by delta [N]."""
        if not self.centred:
            return constant, coefficients
        old = np.concatenate([np.asarray(constant)[:, None], coefficients], 1).astype(np.float64)
        new = np.stack([sum(comb(k, j) * delta[:, None] ** (k - j) * old[:, k] for k in range(j, self.terms + 1))
                        for j in range(self.terms + 1)], 1)
        return new[:, 0], new[:, 1:]

    def within(self, begin: float, end: float) -> tuple[Basis, slice]:
        """A basis with the same weights at times from `begin` to `end`, and which of this one's terms it has."""
        return self, slice(None)

    # Training

    @classmethod
    def trained(cls, last: float) -> dict[str, tuple[Family, int]]:
        """The motions that training offers in this basis, each with its usual order; the clip's frames run from t = 0 to `last`."""
        return {}

    def frequency_index(self) -> np.ndarray:
        """Each term's greatest speed relative to the slowest's [K], at least 1: its learning rate is divided by it."""
        speed = np.abs(self.rates(self._times())).max(0, initial=0.0)
        return np.maximum(speed / speed[speed > 0].min(initial=np.inf), 1.0)

    def curvature(self) -> np.ndarray:
        """Matrix [R, K] that stands for the paper's i^2 in its penalty of motion.

        For a Fourier series i^2 |w| is, up to (2 pi)^2, the greatest acceleration that a term brings.  So every basis takes the
        greatest |d^2 / dt^2| of each term over (2 pi)^2, on the diagonal: 0 for straight motion, which is never penalised.
        """
        times = self._times()
        bend = np.abs(np.gradient(self.rates(times), times, axis=0, edge_order=2)).max(0, initial=0.0) / (2 * np.pi) ** 2
        return np.diag(np.where(bend > 1e-6, bend, 0.0))

    def _times(self) -> np.ndarray:
        return np.linspace(-1.0 if self.centred else 0.0, 1.0, SAMPLES)

    # Fits of sampled motion (fitting.py)

    @classmethod
    def fits(cls, first: float, last: float) -> dict[str, list[Family]]:
        """The names under which this basis can be fitted to positions at times first..last, each with its bases by order."""
        return {}

    @classmethod
    def rotation_fits(cls, first: float, last: float) -> list[Family]:
        """Bases by order that can be fitted to quaternions at times first..last."""
        return []

    # A change of time, t = begin + length u (joining.py)

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        """A basis in t that holds motion in this basis in u for every (begin, length) of spans; FastGSError where there is none."""
        raise FastGSError(f"the segments cannot be joined: motion in the basis {self.name!r} cannot be moved in time.")

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constant [N, D] and coefficients [N, K', D] in `whole` of motion in u with constant [N, D] and coefficients [N, K, D]."""
        raise NotImplementedError
