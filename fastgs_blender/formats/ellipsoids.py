# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians whose shape is a matrix and not a rotation with three sizes: the axes and sizes that they have.

INRIA's rasteriser and its forks do not normalise quaternions (forward.cu, computeCov3D: "q = rot;// / glm::length(rot)").  What a trainer
hands over as it is has the shape R S, where R is no rotation; 4D Gaussians, cut at one time, are like it.
"""
import numpy as np

from ..util import rotations

ROWS = 1 << 14
"""Gaussians at a time, which the processor's cache holds."""
SWEEPS = 4
"""Of Jacobi's one-sided method (Hestenes 1958) over the pairs of axes: random matrices reach float64's precision."""
FLAT = 1e-18
"""The least standard deviation."""


def of_raw_quaternions(rotation: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln scale [N, 3] and rotation [N, 4] of what INRIA's rasteriser draws of quaternions [N, 4] of any length and sizes [N, 3]."""
    rotation = np.asarray(rotation, np.float64)
    return principal(rotations.to_matrices(rotation) * sizes[:, None], rotations.to_matrices(rotations.unit(rotation)))


def principal(spread: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln scale [N, 3] and rotation [N, 4] of Gaussians of the covariances spread @ spread^T; spread [N, 3, M].

    near  rotations [N, 3, 3], from which the axes are turned no further than needed, so that they keep their order over time
    """
    starts = range(0, max(len(spread), 1), ROWS)
    scale, axes = zip(*(_principal(spread[start:start + ROWS], near[start:start + ROWS]) for start in starts), strict=True)
    return np.concatenate(scale), rotations.from_matrices(np.concatenate(axes))


def _principal(spread: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln scale [N, 3] and axes [N, 3, 3]: `near`, turned step by step until the columns of spread^T @ axes are orthogonal."""
    m = spread.shape[2]
    columns = np.concatenate([np.swapaxes(spread, 1, 2) @ near, near], 1).transpose(2, 1, 0).copy()  # [3, M + 3, N]
    for i, j in SWEEPS * ((0, 1), (0, 2), (1, 2)):
        p, q = columns[i], columns[j]
        excess = (p[:m] ** 2).sum(0) - (q[:m] ** 2).sum(0)
        angle = 0.5 * np.arctan2(2 * np.where(excess < 0, -1, 1) * (p[:m] * q[:m]).sum(0), np.abs(excess))
        cosine, sine = np.cos(angle), np.sin(angle)
        columns[i], columns[j] = cosine * p + sine * q, cosine * q - sine * p
    size = np.linalg.norm(columns[:, :m], axis=1).T
    return np.log(np.maximum(size, FLAT)), columns[:, m:].transpose(2, 1, 0)
