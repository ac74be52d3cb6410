# SPDX-License-Identifier: GPL-3.0-or-later
"""Similarities: motions that turn, move and scale, from pairs of places that belong together."""
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..util.arguments import numbers
from ..util.errors import FastGSError
from ..util.rotations import transform

FLAT = 0.02
"""Places whose triangle is flatter than this, its height by its length, lie on a line: hardly anything says how it turns about that."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """A motion of the world that puts places on others.

    matrix    [4, 4] float64: it scales, turns and moves
    residual  root mean squared distance that is left between the pairs, in the world's units

    Example:
        found = fg.similarity([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2, 0, 0], [4, 0, 0], [2, 2, 0]])
    """

    matrix: np.ndarray
    residual: float

    @property
    def scale(self) -> float:
        """Factor by which it makes things larger."""
        return scale_of(self.matrix)


def scale_of(matrix: np.ndarray) -> float:
    """Factor by which a matrix [4, 4] makes things larger, on average of its directions."""
    return float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))


def similarity(places: ArrayLike, targets: ArrayLike, scale: bool = True) -> Similarity:
    """The similarity that moves `places` [P, 3] to `targets` [P, 3], at least three pairs, in the sense of least squares (Umeyama 1991).

    scale  whether it may scale; otherwise it only turns and moves

    Raises FastGSError for fewer than three pairs, for places on a line, and where two of them are at one place.

    Example:
        found = fg.similarity([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2, 0, 0], [4, 0, 0], [2, 2, 0]])
        print(found.scale, found.matrix)
    """
    a, b = (numbers(p, "places of pairs", "(P, 3)") for p in (places, targets))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3 or len(a) < 3:
        raise FastGSError(f"three pairs of places are needed, or more, not places of the shapes {a.shape} and {b.shape}.")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise FastGSError("the places of pairs must be finite numbers.")
    for p in (a, b):
        spread = np.linalg.svd(p - p.mean(0), compute_uv=False)
        if not spread[1] > FLAT * spread[0] > 0:
            raise FastGSError("the places lie on a line, or at one place, so that nothing says how to turn; choose places far apart, "
                              "around a corner.")
    middle_a, middle_b = a.mean(0), b.mean(0)
    x, y = a - middle_a, b - middle_b
    u, s, vt = np.linalg.svd(y.T @ x)
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    turn = (u * mirror) @ vt
    factor = float((s * mirror).sum() / (x * x).sum()) if scale else 1.0
    matrix = transform(factor * turn, middle_b - factor * turn @ middle_a)
    left = factor * x @ turn.T - y
    return Similarity(matrix, float(np.sqrt((left * left).sum(1).mean())))
