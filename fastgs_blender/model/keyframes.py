# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframes: a basis of time whose coefficients are values at given times."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..util.arguments import numbers, one_of, shown
from ..util.errors import FastGSError
from .basis import MAX_TERMS, Basis, Family

LEAST_GAP = 1e-9
"""The shortest time between two keyframes."""
SHORT = 64
"""Keyframes of a table that is not worth cutting into the parts of a long clip."""


@dataclass(frozen=True)
class Keyframes(Basis):
    """A table: coefficient k is the offset from the constant term at times[k]; held outside the table.

    interpolation 'linear', or 'catmull-rom': cubic Hermite whose tangents are the chords between the neighbours
    (one-sided at both ends), so that uneven times are handled and straight motion stays straight.

    Example:
        basis = fg.Keyframes((0.0, 0.5, 1.0), "catmull-rom")
    """

    name: ClassVar[str] = "keyframes"
    times: tuple[float, ...] = (0.0, 1.0)
    interpolation: str = "linear"

    def __post_init__(self) -> None:
        times = numbers(self.times, "keyframe times", "(number of keyframes,)")
        if times.ndim != 1:
            raise FastGSError(f"keyframe times must be numbers of the shape (number of keyframes,), not {shown(self.times)}.")
        object.__setattr__(self, "times", tuple(times.tolist()))
        one_of(self.interpolation, "the interpolation of keyframes", ("linear", "catmull-rom"))
        if not 0 < len(self.times) <= MAX_TERMS or not np.isfinite(self.times).all() or not (np.diff(self.times) >= LEAST_GAP).all():
            raise FastGSError(f"keyframe times must be 1 to {MAX_TERMS} finite numbers that increase by at least {LEAST_GAP:g}.")

    @property
    def terms(self) -> int:
        return len(self.times)

    @property
    def max_frequency(self) -> float:
        return 0.5 / float(np.min(np.diff(self.times))) if len(self.times) > 1 else 0.0

    def _blend(self, t: ArrayLike, rate: bool) -> np.ndarray:
        x, n = np.array(self.times), len(self.times)
        t = np.asarray(t, np.float64)
        flat = t.reshape(-1)
        w = np.zeros((flat.size, n))
        if n == 1:
            w[:] = 0.0 if rate else 1.0
            return w.reshape(t.shape + (n,))
        inside = np.clip(flat, x[0], x[-1])
        i = np.clip(np.searchsorted(x, inside, side="right") - 1, 0, n - 2)
        h, row = x[i + 1] - x[i], np.arange(flat.size)
        u = (inside - x[i]) / h
        if self.interpolation == "linear":
            w[row, i], w[row, i + 1] = (-1 / h, 1 / h) if rate else (1 - u, u)
        else:
            if rate:
                p = (6 * u**2 - 6 * u) / h
                p0, p1, m0, m1 = p, -p, 3 * u**2 - 4 * u + 1, 3 * u**2 - 2 * u
            else:
                p0, p1 = 2 * u**3 - 3 * u**2 + 1, -2 * u**3 + 3 * u**2
                m0, m1 = h * (u**3 - 2 * u**2 + u), h * (u**3 - u**2)
            w[row, i], w[row, i + 1] = p0, p1
            for key, tangent in ((i, m0), (i + 1, m1)):  # the tangent at a key is the chord between its neighbours
                before, after = np.maximum(key - 1, 0), np.minimum(key + 1, n - 1)
                chord = tangent / (x[after] - x[before])
                w[row, after] += chord
                w[row, before] -= chord
        if rate:
            w[flat != inside] = 0.0
        return w.reshape(t.shape + (n,))

    def weights(self, t: ArrayLike) -> np.ndarray:
        return self._blend(t, rate=False)

    def rates(self, t: ArrayLike) -> np.ndarray:
        return self._blend(t, rate=True)

    def within(self, begin: float, end: float) -> tuple[Basis, slice]:
        """The part of the table that counts then: the keys on either side, and for tangents one more; all of a short table."""
        if self.terms <= SHORT:
            return self, slice(None)
        first = max(int(np.searchsorted(self.times, begin, side="right")) - 2, 0)
        last = min(int(np.searchsorted(self.times, end, side="left")) + 2, self.terms)
        first = max(min(first, last - 2), 0)
        return replace(self, times=self.times[first:last]), slice(first, last)

    @classmethod
    def trained(cls, last: float) -> dict[str, tuple[Family, int]]:
        return {"keyframes": (lambda n: cls(tuple(np.linspace(0, last, max(n, 2))), "catmull-rom"), 11)}

    def frequency_index(self) -> np.ndarray:
        return np.ones(self.terms)

    def curvature(self) -> np.ndarray:
        """Matrix [K - 2, K].  A key has no acceleration of its own: rows are the second differences at the inner keys, divided by the
        keys' distances and weighted so that they add up to the mean over time."""
        if self.terms < 3:
            return np.zeros((0, self.terms))
        gap = np.diff(self.times)
        rows = np.zeros((self.terms - 2, self.terms))
        inner = np.arange(self.terms - 2)
        rows[inner, inner], rows[inner, inner + 1], rows[inner, inner + 2] = 1 / gap[:-1], -1 / gap[:-1] - 1 / gap[1:], 1 / gap[1:]
        return rows / ((2 * np.pi) ** 2 * (self.times[-1] - self.times[0]))

    @classmethod
    def fits(cls, first: float, last: float) -> dict[str, list[Family]]:
        return {"keyframes": [lambda n: cls(tuple(np.linspace(first, last, n + 1)), "catmull-rom")]}

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        """The tables of all segments side by side."""
        if self.interpolation != "linear":
            raise FastGSError("the segments cannot be joined: smooth keyframes of different segments disturb each other; use linear ones.")
        times = np.unique(np.round(np.concatenate([begin + length * np.array(self.times) for begin, length in spans]), 12))
        return replace(self, times=tuple(times[np.diff(times, prepend=-np.inf) > 2 * LEAST_GAP].tolist()))

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constant [N, D] and coefficients [N, K', D], as Basis.retimed() of constant [N, D] and coefficients [N, K, D]; outside of its
        own span each table keeps its nearest value."""
        assert isinstance(whole, Keyframes)
        return constant, np.einsum("jk,nkd->njd", self.weights((np.array(whole.times) - begin) / length), coefficients)
