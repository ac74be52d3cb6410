# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparing a model that was read with what its format's own formulas say, in float64, at one time."""
from __future__ import annotations

import numpy as np

import fastgs_blender as fg
from fastgs_blender.model.appearance import RGB, momentary, sh_basis

TOLERANCE = 1e-4


def colours(appearance, features: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Colours [N, 3] that a model's features [N, F] give in directions [N, 3]."""
    appearance = momentary(appearance)
    if isinstance(appearance, RGB):
        return np.asarray(features, np.float64)
    basis = sh_basis(directions, appearance.degree)
    return np.maximum(0, 0.5 + np.einsum("nb,nbc->nc", basis, features.reshape(*basis.shape, 3)))


def spherical(direction: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Colours [N, 3] of coefficients [N, B, 3] as graphdeco's 3DGS evaluates them, B = 1, 4, 9 or 16."""
    x, y, z = direction.T
    terms = [0.28209479177387814 * np.ones_like(x), -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
             1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y),
             -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y), -0.5900435899266435 * y * (3 * x * x - y * y),
             2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
             0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y), -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
             1.445305721320277 * z * (x * x - y * y), -0.5900435899266435 * x * (x * x - 3 * y * y)]
    count = coefficients.shape[1]
    return np.maximum(0, 0.5 + sum(terms[b][:, None] * coefficients[:, b] for b in range(count)))


def directions(n: int) -> np.ndarray:
    """N unit vectors, the same ones every time."""
    d = np.random.default_rng(5).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def kernel_covariance(scale, rotation) -> np.ndarray:
    """Covariances [N, 3, 3] as rasterisers of INRIA's family make them of quaternions w x y z of any length.

    graphdeco-inria/diff-gaussian-rasterization@59f5f77, cuda_rasterizer/forward.cu, computeCov3D, lines 118-152: the division by the length
    is commented out (line 127).  The same line stands in the forks that are used by Deformable-3DGS (all branches of
    ingra14m/diff-gaussian-rasterization-extentions), Ex4DGS (line 137), 4DGS (line 251), Dynamic 3D Gaussians and 4D-Rotor Gaussians.
    """
    found = []
    for (sx, sy, sz), (r, x, y, z) in zip(np.asarray(scale, np.float64), np.asarray(rotation, np.float64), strict=True):
        matrix = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - r * z), 2 * (x * z + r * y)],
                           [2 * (x * y + r * z), 1 - 2 * (x * x + z * z), 2 * (y * z - r * x)],
                           [2 * (x * z - r * y), 2 * (y * z + r * x), 1 - 2 * (x * x + y * y)]])
        found.append(matrix @ np.diag([sx * sx, sy * sy, sz * sz]) @ matrix.T)
    return np.array(found)


def unit(quaternions) -> np.ndarray:
    """torch.nn.functional.normalize of the last axis: zeros stay."""
    q = np.asarray(quaternions, np.float64)
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-12)


def assert_shows(model: fg.GaussianModel, t: float, *, position, opacity, colour, scale=None, rotation=None, covariance=None,
                 tolerance: float = TOLERANCE) -> None:
    """The model at t is what is expected: position [N, 3], opacity [N], colour [N, 3] in directions(N), and either covariance [N, 3, 3] or
    scale [N, 3] and a rotation [N, 4] of any length.  Gaussians that cannot be seen may be anywhere and look like anything."""
    s = fg.slice_model(model, t, cull=False)
    assert len(s.index) == len(position)
    np.testing.assert_allclose(s.opacity, opacity, atol=tolerance, rtol=0)
    seen = np.asarray(opacity) > 0
    np.testing.assert_allclose(s.position[seen], np.asarray(position)[seen], atol=tolerance, rtol=0)
    if covariance is None:
        np.testing.assert_allclose(s.scale[seen], np.asarray(scale)[seen], atol=tolerance, rtol=tolerance)
        covariance = kernel_covariance(scale, unit(rotation))
    np.testing.assert_allclose(np.linalg.norm(s.rotation, axis=1), 1, atol=1e-5)
    size = np.linalg.norm(covariance[seen], axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(kernel_covariance(s.scale, s.rotation)[seen] / size, covariance[seen] / size, atol=tolerance, rtol=0)
    seen_colours = colours(model.appearance, s.features, directions(len(position)))
    np.testing.assert_allclose(seen_colours[seen], np.asarray(colour)[seen], atol=tolerance, rtol=0)
