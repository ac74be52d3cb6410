# SPDX-License-Identifier: GPL-3.0-or-later
"""Least squares in time: which basis of which order describes sampled motion, and its coefficients.

All trajectories share their times, so that one factorisation of the design matrix serves them all.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..util.arguments import one_of
from .motion import BASES, Basis, Family, Static

SAFE = 0.4
"""Coefficients per sample at most.  The Nyquist limit is 1; near it a basis swings between the samples."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A basis and the matrix [K + 1, S] that turns values at S times into the constant term and K coefficients."""

    basis: Basis
    solve: np.ndarray
    design: np.ndarray

    @classmethod
    def of(cls, basis: Basis, t: np.ndarray) -> Fit:
        """The least-squares fit at times t [S].  A direction that the samples do not determine stays 0."""
        design = np.concatenate([np.ones((len(t), 1)), basis.weights(t)], 1)
        return cls(basis, np.linalg.pinv(design, rcond=1e-9), design)

    def __call__(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """values [S, ...] -> coefficients [K + 1, ...] and what the fit makes of the values [S, ...]."""
        coefficients = self.coefficients(values)
        return coefficients, self.values(coefficients)

    def coefficients(self, values: np.ndarray) -> np.ndarray:
        """values [S, ...] -> coefficients [K + 1, ...]."""
        return (self.solve @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

    def values(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients [K + 1, ...] -> the values [S, ...] that they make."""
        return (self.design @ coefficients.reshape(len(coefficients), -1)).reshape(-1, *coefficients.shape[1:])


def motion_families(name: str, t: np.ndarray) -> list[Family]:
    """Bases of positions by order, for motion known at times t [S] that increase; "auto": those of all bases that compete."""
    families: dict[str, list[Family]] = {}
    for kind in BASES.values():
        families |= kind.fits(float(t[0]), float(t[-1]))
    if isinstance(name, str) and name == "auto":
        return [family for kind in BASES.values() if kind.competes for family in families[kind.name]]
    return families[one_of(name, "the basis of a fit", ["auto", *families])]


def rotation_families(t: np.ndarray) -> list[Family]:
    """Bases of quaternions by order, for rotations known at times t [S] that increase."""
    return [family for kind in BASES.values() for family in kind.rotation_fits(float(t[0]), float(t[-1]))]


def choose(families: list[Family], t: np.ndarray, error: Callable[[Fit], float], max_order: int = 0, most: float = np.inf) -> Basis:
    """The basis with the fewest coefficients whose error is at most 1, else the one with the least error.

    t [S] the times that are known; families of bases by order, at a tie the first wins; error(fit) relative to the tolerance.
    Never more coefficients than SAFE x S or `most`, nor a higher order than max_order (0: no such limit).
    """
    static = Fit.of(Static(), t)
    if len(t) < 2 or error(static) <= 1:
        return Static()
    best = None
    for family in families:
        highest = _highest(family, min(max(int(SAFE * len(t)), 1), most), max_order)
        if highest < 1:
            continue
        errors: dict[int, float] = {}

        def measure(order: int, family: Family = family, errors: dict[int, float] = errors) -> float:
            if order not in errors:
                errors[order] = error(Fit.of(family(order), t))
            return errors[order]

        order = _first(lambda n: measure(n) <= 1, highest)
        key = (0, family(order).terms) if measure(order) <= 1 else (1, measure(order))
        if best is None or key < best[0]:
            best = key, family(order)
    return best[1] if best else Static()


def _highest(family: Family, limit: float, max_order: int) -> int:
    """The highest order whose basis has no more coefficients than the limit."""
    def allowed(n: int) -> bool:
        basis = family(n)
        return basis.terms <= limit and (max_order <= 0 or getattr(basis, "order", n) <= max_order)

    n = 0
    while allowed(n + 1):
        n += 1
    return n


def _first(good: Callable[[int], bool], highest: int) -> int:
    """The least order that is good, found by doubling and halving (more terms fit better); `highest` if none is."""
    low, high = 0, 1
    while high < highest and not good(high):
        low, high = high, min(2 * high, highest)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if good(middle) else (middle, high)
    return high
