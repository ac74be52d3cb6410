# SPDX-License-Identifier: GPL-3.0-or-later
"""Turning static Gaussians into a world with other axes: positions, rotations and spherical harmonics."""
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..model.appearance import SH, sh_basis
from ..model.gaussians import GaussianModel
from ..util import rotations

DIRECTIONS = {"R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)}
"""Right, left, down, up, forward and backward in RDF."""


def into_rdf(axes: str) -> np.ndarray:
    """[3, 3]: from axes that are named by three letters, such as RUB or LUF, to RDF.  It may mirror."""
    return np.array([DIRECTIONS[letter] for letter in axes], np.float64).T


def turned(model: GaussianModel, turn: np.ndarray) -> GaussianModel:
    """The static model with its space multiplied by an orthogonal matrix [3, 3], which may mirror; `axes` stays as it is.

    A matrix that only changes signs is applied without rounding.
    """
    if np.array_equal(turn, np.eye(3)):
        return model
    signs = np.diag(turn).astype(np.float32) if _only_signs(turn) else None
    position = model.position * signs if signs is not None else model.position.astype(np.float64) @ turn.T
    changed: dict[str, Any] = {"position": position, "rotation": _turned_rotation(model.rotation, turn),
                               "surroundings": model.surroundings.moved(rotations.transform(turn))}
    if isinstance(model.appearance, SH) and model.appearance.degree:
        count = (model.appearance.degree + 1) ** 2
        matrix = sh_turn(turn, model.appearance.degree)
        if _only_signs(matrix):
            flips = np.repeat(np.diag(matrix), 3).astype(np.float32)
            changed["features"] = model.features * flips
        else:
            features = model.features.reshape(len(model), count, 3)
            changed["features"] = (matrix @ features).reshape(len(model), 3 * count)
    return replace(model, **changed)


def with_axes(model: GaussianModel, axes: str) -> GaussianModel:
    """The static model in the given axes, one of AXES."""
    return replace(turned(model, into_rdf(axes).T @ into_rdf(model.axes)), axes=axes)


def sh_turn(turn: np.ndarray, degree: int) -> np.ndarray:
    """Matrix [B, B], B = (degree + 1)^2, of the coefficients of spherical harmonics in a space multiplied by `turn` [3, 3].

    It solves Y(turn d) c' = Y(d) c for all directions d, band by band, so it holds for any order and any signs of Y.
    """
    return _sh_turn(tuple(np.asarray(turn, np.float64).ravel()), degree)


@lru_cache(maxsize=64)
def _sh_turn(values: tuple[float, ...], degree: int) -> np.ndarray:
    turn = np.array(values).reshape(3, 3)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = sh_basis(directions, degree), sh_basis(directions @ turn.T, degree)
    matrix = np.zeros(((degree + 1) ** 2,) * 2)
    for band in range(degree + 1):
        part = slice(band**2, (band + 1) ** 2)
        matrix[part, part] = np.linalg.lstsq(after[:, part], before[:, part], rcond=None)[0]
    matrix = np.round(matrix, 12)  # what should be 0 or 1 is
    matrix.flags.writeable = False
    return matrix


def _turned_rotation(rotation: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A Gaussian looks the same along +x and -x: where only signs change its own axes change them too, and w stays."""
    if _only_signs(turn):
        x, y, z = np.diag(turn)
        return rotation * np.array([1, y * z, x * z, x * y], np.float32)
    return rotations.multiply(rotations.from_matrices(turn * np.linalg.det(turn)), rotation.astype(np.float64))


def _only_signs(matrix: np.ndarray) -> bool:
    return bool(np.array_equal(np.abs(matrix), np.eye(len(matrix))))
