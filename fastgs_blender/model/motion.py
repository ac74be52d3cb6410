# SPDX-License-Identifier: GPL-3.0-or-later
"""Bases of time: how a few coefficients per Gaussian become a value at any time.

Every basis answers the same two questions: the weights w_k of its coefficients at a time, and their
derivatives.  A quantity with constant term c and coefficients c_k is then  c + sum_k w_k(t) c_k.
A new basis is one small frozen dataclass here, listed in BASES; files, slicing and kernels need nothing else.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import ClassVar

import numpy as np

from ..util.errors import FastGSError


@dataclass(frozen=True)
class Basis:
    """One basis of time.

    `centred` says what time means to it: False, the model's t, one set of weights for all Gaussians;
    True, t - mu_tau of each Gaussian, and then the weights are the powers 1..K of it.
    """

    name: ClassVar[str] = ""
    centred: ClassVar[bool] = False

    @property
    def terms(self) -> int:
        """K, the number of coefficients per axis, the constant term not counted."""
        raise NotImplementedError

    @property
    def max_frequency(self) -> float:
        """The highest frequency the basis holds, in cycles per unit of t (0: no such limit)."""
        return 0.0

    def weights(self, t) -> np.ndarray:
        """Weights [..., K] float64 at times t [...]."""
        raise NotImplementedError

    def rates(self, t) -> np.ndarray:
        """Derivatives of the weights by t, [..., K] float64."""
        raise NotImplementedError

    def evaluate(self, coefficients, t, mu_tau):
        """Sum of the weighted coefficients and its derivative by t.

        coefficients [N, K, D], t a number, mu_tau [N]; returns two arrays [N, D] float64.
        """
        c = np.asarray(coefficients, np.float64)
        time = t - np.asarray(mu_tau, np.float64) if self.centred else float(t)
        form = "nk,nkd->nd" if self.centred else "k,nkd->nd"
        return np.einsum(form, self.weights(time), c), np.einsum(form, self.rates(time), c)


@dataclass(frozen=True)
class Static(Basis):
    """No change in time."""

    name: ClassVar[str] = "static"
    terms: ClassVar[int] = 0

    def weights(self, t):
        return np.zeros(np.shape(t) + (0,))

    rates = weights


@dataclass(frozen=True)
class Fourier(Basis):
    """The paper's basis (eq. 3-4): sin(2 pi k p), cos(2 pi k p), k = 1..order, interleaved (sin 1, cos 1, sin 2, ...).

    The phase is p = scale * t + offset; the paper has scale 1, offset 0, order 5.  `linear` adds a term t at the end,
    which frees the motion from returning to where it began.
    """

    name: ClassVar[str] = "fourier"
    order: int = 5
    scale: float = 1.0
    offset: float = 0.0
    linear: bool = False

    @property
    def terms(self):
        return 2 * self.order + self.linear

    @property
    def max_frequency(self):
        return self.order * abs(self.scale)

    def _parts(self, t):
        t = np.asarray(t, np.float64)[..., None]
        omega = 2 * np.pi * np.arange(1, self.order + 1)
        angle = omega * (self.scale * t + self.offset)
        return t, omega, np.sin(angle), np.cos(angle)

    def _join(self, sines, cosines, line):
        pairs = np.stack([sines, cosines], -1).reshape(sines.shape[:-1] + (-1,))
        return np.concatenate([pairs, line], -1) if self.linear else pairs

    def weights(self, t):
        t, _, sin, cos = self._parts(t)
        return self._join(sin, cos, t)

    def rates(self, t):
        t, omega, sin, cos = self._parts(t)
        return self._join(omega * self.scale * cos, -omega * self.scale * sin, np.ones_like(t))


@dataclass(frozen=True)
class Cosine(Basis):
    """Half-period cosines cos(pi k p), k = 1..order, p = scale * t + offset.  Nothing forces the motion to return."""

    name: ClassVar[str] = "cosine"
    order: int = 10
    scale: float = 1.0
    offset: float = 0.0

    @property
    def terms(self):
        return self.order

    @property
    def max_frequency(self):
        return 0.5 * self.order * abs(self.scale)

    def _angle(self, t):
        omega = np.pi * np.arange(1, self.order + 1)
        return omega, omega * (self.scale * np.asarray(t, np.float64)[..., None] + self.offset)

    def weights(self, t):
        return np.cos(self._angle(t)[1])

    def rates(self, t):
        omega, angle = self._angle(t)
        return -omega * self.scale * np.sin(angle)


@dataclass(frozen=True)
class Polynomial(Basis):
    """Powers 1..degree of t - mu_tau: STG's motion (degree 3) and the paper's rotation (eq. 7, degree 1)."""

    name: ClassVar[str] = "polynomial"
    centred: ClassVar[bool] = True
    degree: int = 3

    @property
    def terms(self):
        return self.degree

    def weights(self, t):
        return np.asarray(t, np.float64)[..., None] ** np.arange(1, self.degree + 1)

    def rates(self, t):
        k = np.arange(1, self.degree + 1)
        return k * np.asarray(t, np.float64)[..., None] ** (k - 1)


@dataclass(frozen=True)
class Keyframes(Basis):
    """A table: coefficient k is the offset from the constant term at times[k]; held outside the table.

    interpolation 'linear', or 'catmull-rom': cubic Hermite whose tangents are the chords between the neighbours
    (one-sided at both ends), so that uneven times are handled and straight motion stays straight.
    """

    name: ClassVar[str] = "keyframes"
    times: tuple[float, ...] = (0.0, 1.0)
    interpolation: str = "linear"

    def __post_init__(self):
        object.__setattr__(self, "times", tuple(float(t) for t in self.times))
        if self.interpolation not in ("linear", "catmull-rom"):
            raise FastGSError(f"keyframes know the interpolations linear and catmull-rom, not {self.interpolation!r}.")
        if not self.times or not np.all(np.diff(self.times) > 0) or not np.all(np.isfinite(self.times)):
            raise FastGSError("keyframe times must be at least one, finite and increasing.")

    @property
    def terms(self):
        return len(self.times)

    @property
    def max_frequency(self):
        return 0.5 / float(np.min(np.diff(self.times))) if len(self.times) > 1 else 0.0

    def _blend(self, t, rate):
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

    def weights(self, t):
        return self._blend(t, rate=False)

    def rates(self, t):
        return self._blend(t, rate=True)


BASES = {cls.name: cls for cls in (Static, Fourier, Cosine, Polynomial, Keyframes)}


def basis_to_dict(basis: Basis) -> dict:
    """The basis as plain JSON values, for a file's header."""
    return {"name": basis.name, **asdict(basis)}


def basis_from_dict(values: dict) -> Basis:
    """The inverse of basis_to_dict; raises FastGSError for an unknown basis or wrong parameters."""
    values = dict(values)
    name = values.pop("name", None)
    if name not in BASES:
        raise FastGSError(f"the basis of time {name!r} is unknown; this version knows {', '.join(BASES)}.")
    try:
        basis = BASES[name](**values)
        for field in fields(basis):
            value = getattr(basis, field.name)
            kinds = {"int": int, "float": (int, float), "bool": bool, "str": str}.get(field.type, tuple)
            if not isinstance(value, kinds) or (isinstance(value, bool) and field.type != "bool"):
                raise TypeError
            if isinstance(value, float) and not np.isfinite(value):
                raise ValueError
        if not 0 <= basis.terms <= 100_000:
            raise ValueError
    except (TypeError, ValueError) as error:
        raise FastGSError(f"the parameters of the basis of time {name!r} do not fit it: {values}.") from error
    return basis
