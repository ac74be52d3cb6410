# SPDX-License-Identifier: GPL-3.0-or-later
"""The bases of time: functions of t whose weighted sum moves a Gaussian.

A new basis is one frozen dataclass here, listed in BASES.  It must state `terms`, `weights` and `rates`; its fields are what a file
records of it.  Whatever else depends on the basis asks it, and `Basis` (basis.py) has an answer to begin with: rendering, gradients,
learning rates, the penalty of motion, training's choice of motions, fits, joining and files need nothing else.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..util.arguments import finite, in_words
from ..util.errors import FastGSError
from .basis import MAX_TERMS, Basis, Family
from .keyframes import Keyframes

MAX_DEGREE = 32
"""The highest degree of polynomials: higher powers leave float32."""
MARGIN = 0.1
"""Share of a Fourier series' period that stays free on either side of the clip, so that motion need not return (Gaussian-Flow)."""


def _whole_number(value: Any, low: int, high: int, what: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= int(value) <= high:
        raise FastGSError(f"{what} must be a whole number from {low} to {high}, not {value!r}.")


def _finite(*values: Any) -> None:
    if not all(map(finite, values)):
        raise FastGSError(f"the scale and offset of a basis of time must be finite numbers, not {', '.join(map(repr, values))}.")


def _one_length(spans: list[tuple[float, float]]) -> float:
    """The length that all segments have; raises FastGSError."""
    length = spans[0][1]
    if any(abs(other - length) > 1e-9 * length for _, other in spans):
        raise FastGSError("the segments cannot be joined: a series needs segments of one length.")
    return length


@dataclass(frozen=True)
class Static(Basis):
    """No change in time.

    Example:
        basis = fg.Static()
    """

    name: ClassVar[str] = "static"
    terms: ClassVar[int] = 0

    def weights(self, t: ArrayLike) -> np.ndarray:
        return np.zeros(np.shape(t) + (0,))

    rates = weights

    def curvature(self) -> np.ndarray:
        return np.zeros((0, 0))

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        return self

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return constant, coefficients


@dataclass(frozen=True)
class Fourier(Basis):
    """The paper's basis (eq. 3-4): sin(2 pi k p), cos(2 pi k p), k = 1..order, interleaved (sin 1, cos 1, sin 2, ...).

    The phase is p = scale * t + offset; the paper has scale 1, offset 0, order 5.  `linear` adds a term t at the end,
    which frees the motion from returning to where it began.

    Example:
        basis = fg.Fourier(5, linear=True)
    """

    name: ClassVar[str] = "fourier"
    competes: ClassVar[bool] = True
    order: int = 5
    scale: float = 1.0
    offset: float = 0.0
    linear: bool = False

    def __post_init__(self) -> None:
        _whole_number(self.order, 0, MAX_TERMS // 2 - 1, "the order of a Fourier series")
        _finite(self.scale, self.offset)
        if not isinstance(self.linear, (bool, np.bool_)):
            raise FastGSError(f"whether a Fourier series has a linear term is true or false, not {self.linear!r}.")

    @property
    def terms(self) -> int:
        return 2 * self.order + self.linear

    @property
    def max_frequency(self) -> float:
        return self.order * abs(self.scale)

    def _parts(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        t = np.asarray(t, np.float64)[..., None]
        omega = 2 * np.pi * np.arange(1, self.order + 1)
        angle = omega * (self.scale * t + self.offset)
        return t, omega, np.sin(angle), np.cos(angle)

    def _join(self, sines: np.ndarray, cosines: np.ndarray, line: np.ndarray) -> np.ndarray:
        pairs = np.stack([sines, cosines], -1).reshape(sines.shape[:-1] + (-1,))
        return np.concatenate([pairs, line], -1) if self.linear else pairs

    def weights(self, t: ArrayLike) -> np.ndarray:
        t, _, sin, cos = self._parts(t)
        return self._join(sin, cos, t)

    def rates(self, t: ArrayLike) -> np.ndarray:
        t, omega, sin, cos = self._parts(t)
        return self._join(omega * self.scale * cos, -omega * self.scale * sin, np.ones_like(t))

    @classmethod
    def trained(cls, last: float) -> dict[str, tuple[Family, int]]:
        return {"fourier": (lambda n: cls(n, (1 - 2 * MARGIN) / last, MARGIN), 5),
                "fourier+linear": (lambda n: cls(n, 1.0, 0.0, linear=True), 5), "paper": (cls, 5)}

    def frequency_index(self) -> np.ndarray:
        pairs = np.repeat(np.arange(1.0, self.order + 1), 2)
        return np.append(pairs, 1.0) if self.linear else pairs

    def curvature(self) -> np.ndarray:
        weights = np.repeat((self.scale * np.arange(1.0, self.order + 1)) ** 2, 2)
        return np.diag(np.append(weights, 0.0) if self.linear else weights)

    @classmethod
    def fits(cls, first: float, last: float) -> dict[str, list[Family]]:
        """With a linear term it is exact for steady travel and whole turns, whether or not the last sample repeats the first."""
        rate, offset = _onto(first, last)
        return {"fourier": [lambda n: cls(n - 1, 1.0, 0.0, linear=True), lambda n: cls(n - 1, rate, offset, linear=True)], "paper": [cls]}

    @classmethod
    def rotation_fits(cls, first: float, last: float) -> list[Family]:
        """A quaternion turns by half the angle: the series has twice the period."""
        rate, offset = _onto(first, last)
        return [lambda n: cls(n, 0.5), lambda n: cls(n, 0.5 * rate, 0.5 * offset)]

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        return replace(self, scale=self.scale / _one_length(spans), offset=0.0)

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c = coefficients
        angle = 2 * np.pi * np.arange(1, self.order + 1) * (self.offset - self.scale * begin / length)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        a, b = c[:, 0:2 * self.order:2], c[:, 1:2 * self.order:2]
        pairs = np.stack([a * cos - b * sin, a * sin + b * cos], 2).reshape(len(c), 2 * self.order, c.shape[2])
        if self.linear:
            line = c[:, -1:]
            return constant - line[:, 0] * begin / length, np.concatenate([pairs, line / length], 1)
        return constant, pairs


def _onto(first: float, last: float) -> tuple[float, float]:
    """Scale and offset that map first..last onto 0..1."""
    rate = 1 / (last - first)
    return rate, 0.0 - rate * first


@dataclass(frozen=True)
class Cosine(Basis):
    """Half-period cosines cos(pi k p), k = 1..order, p = scale * t + offset.  Nothing forces the motion to return.

    Example:
        basis = fg.Cosine(10)
    """

    name: ClassVar[str] = "cosine"
    competes: ClassVar[bool] = True
    order: int = 10
    scale: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _whole_number(self.order, 0, MAX_TERMS, "the order of half-period cosines")
        _finite(self.scale, self.offset)

    @property
    def terms(self) -> int:
        return self.order

    @property
    def max_frequency(self) -> float:
        return 0.5 * self.order * abs(self.scale)

    def _angle(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        omega = np.pi * np.arange(1, self.order + 1)
        return omega, omega * (self.scale * np.asarray(t, np.float64)[..., None] + self.offset)

    def weights(self, t: ArrayLike) -> np.ndarray:
        return np.cos(self._angle(t)[1])

    def rates(self, t: ArrayLike) -> np.ndarray:
        omega, angle = self._angle(t)
        return -omega * self.scale * np.sin(angle)

    @classmethod
    def trained(cls, last: float) -> dict[str, tuple[Family, int]]:
        return {"cosine": (lambda n: cls(n, 1 / last, 0.0), 10)}

    def frequency_index(self) -> np.ndarray:
        return np.arange(1.0, self.order + 1)

    def curvature(self) -> np.ndarray:
        """Matrix [K, K], diagonal: the k-th term swings k / 2 times."""
        return np.diag((self.scale * np.arange(1.0, self.order + 1) / 2) ** 2)

    @classmethod
    def fits(cls, first: float, last: float) -> dict[str, list[Family]]:
        """Over exactly first..last it is mirrored beyond, so that the half frame after the last is as tame as the one before it."""
        return {"cosine": cls.rotation_fits(first, last)}

    @classmethod
    def rotation_fits(cls, first: float, last: float) -> list[Family]:
        rate, offset = _onto(first, last)
        return [lambda n: cls(n, rate, offset)]

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        return Fourier(self.order, 0.5 * self.scale / _one_length(spans))

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c = coefficients
        angle = np.pi * np.arange(1, self.order + 1) * (self.offset - self.scale * begin / length)
        sine, cosine = -c * np.sin(angle)[:, None], c * np.cos(angle)[:, None]
        return constant, np.stack([sine, cosine], 2).reshape(len(c), 2 * self.order, c.shape[2])


@dataclass(frozen=True)
class Polynomial(Basis):
    """Powers 1..degree of t - mu_tau: STG's motion (degree 3) and the paper's rotation (eq. 7, degree 1).

    Example:
        basis = fg.Polynomial(3)
    """

    name: ClassVar[str] = "polynomial"
    centred: ClassVar[bool] = True
    degree: int = 3

    def __post_init__(self) -> None:
        _whole_number(self.degree, 0, MAX_DEGREE, "the degree of a polynomial of time")

    @property
    def terms(self) -> int:
        return self.degree

    def weights(self, t: ArrayLike) -> np.ndarray:
        return np.asarray(t, np.float64)[..., None] ** np.arange(1, self.degree + 1)

    def rates(self, t: ArrayLike) -> np.ndarray:
        k = np.arange(1, self.degree + 1)
        return k * np.asarray(t, np.float64)[..., None] ** (k - 1)

    @classmethod
    def trained(cls, last: float) -> dict[str, tuple[Family, int]]:
        return {"polynomial": (cls, 3)}

    def frequency_index(self) -> np.ndarray:
        return np.ones(self.degree)

    def curvature(self) -> np.ndarray:
        """Matrix [K, K], diagonal: of a power k of t - mu_tau, where |t - mu_tau| <= 1."""
        k = np.arange(1.0, self.degree + 1)
        return np.diag(k * (k - 1) / (2 * np.pi) ** 2)

    def joined(self, spans: list[tuple[float, float]]) -> Basis:
        return self

    def retimed(self, whole: Basis, begin: float, length: float, constant: np.ndarray,
                coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return constant, coefficients / length ** np.arange(1, self.degree + 1)[:, None]


BASES = {cls.name: cls for cls in (Static, Cosine, Fourier, Polynomial, Keyframes)}


def trained_motions(last: float = 1.0) -> dict[str, tuple[Family, int]]:
    """The motions that training offers, in all bases: see Basis.trained."""
    return {name: offer for kind in BASES.values() for name, offer in kind.trained(last).items()}


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
        return BASES[name](**values)
    except (TypeError, ValueError) as error:
        raise FastGSError(f"the parameters of the basis of time {name!r} do not fit it: {in_words(values)}.") from error
