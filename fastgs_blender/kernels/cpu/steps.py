# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a training step that update all parameters, on the CPU: penalties, random moves, Adam."""
from __future__ import annotations

import math

import numpy as np

from ...model.slicing import sigmoid
from ...util import rotations
from ...util.threads import ranges, run
from .. import asserts
from ..protocol import MotionNorm
from . import adam as kernels
from . import penalty

ROWS = 16_384
"""Gaussians in one piece of work."""
GATE, SHARPNESS, NEGLIGIBLE = 0.995, 100.0, 1e-4
"""MCMC's noise (Kheradmand et al. 2024): Gaussians more transparent than GATE are moved; the edge's sharpness; the share from which on."""


def motion_penalty(norm: MotionNorm, motion: np.ndarray, gradient: np.ndarray, scale: float, since: np.ndarray) -> np.ndarray:
    """TrainingBackend.motion_penalty()."""
    asserts.motion_penalty(norm, motion, gradient, since)
    n = len(motion)
    if not n or not norm.weights.any():
        return np.zeros(1)
    if norm.matrix is None:
        return np.array([_norms(norm, motion.reshape(n, -1), gradient.reshape(n, -1), scale, since)])
    matrix = norm.matrix.astype(np.float32)
    rows = np.ascontiguousarray(np.einsum("rk,nkd->nrd", matrix, motion)).reshape(n, -1)
    part = np.zeros_like(rows)
    value = _norms(norm, rows, part, scale, since)
    gradient += np.einsum("rk,nrd->nkd", matrix, part.reshape(n, -1, 3))
    return np.array([value])


def _norms(norm: MotionNorm, values, gradient, scale, since) -> float:
    """The penalty of values [N, 3 R]; scale * since * its gradient is added to gradient [N, 3 R]."""
    n, columns = values.shape
    pieces = [(sums, *piece) for sums, piece in zip(np.zeros((-(-n // ROWS), columns)), ranges(n, ROWS))]
    share, smooth = norm.weights / (n * norm.extent), norm.smooth * norm.extent
    if norm.reading == "mean":
        factor = (scale * share).astype(np.float32)
        run(lambda sums, a, b: penalty.magnitudes(a, b, values, smooth, factor, since, gradient, sums), pieces)
        return float(np.sum([sums for sums, _, _ in pieces], 0) @ share)
    run(lambda sums, a, b: penalty.squares(a, b, values, sums), pieces)
    size = np.sqrt(np.sum([sums for sums, _, _ in pieces], 0) / n + smooth**2)
    factor = (scale * share / size).astype(np.float32)
    run(lambda sums, a, b: penalty.scaled(a, b, values, factor, since, gradient), pieces)
    return float((size - smooth) @ norm.weights / norm.extent)


def steps_since(rows: np.ndarray, moved: np.ndarray, step: int) -> np.ndarray:
    """TrainingBackend.steps_since()."""
    asserts.steps_since(moved)
    out = np.zeros(len(moved), np.float32)
    out[rows] = step - moved[rows]
    return out


def anchor(features: np.ndarray, target: np.ndarray, gradient: np.ndarray, rows: np.ndarray, strength: float) -> None:
    """TrainingBackend.anchor()."""
    asserts.anchor(features, target, gradient)
    rows = rows[np.isfinite(target[rows, 0])]
    gradient[rows] += np.float32(strength) * (features[rows] - target[rows])


def mcmc_penalty(parameters: dict, gradients: dict, opacity_weight: float, scale_weight: float, extent: float) -> None:
    """TrainingBackend.mcmc_penalty()."""
    asserts.mcmc_penalty(parameters, gradients)
    n = max(len(parameters["opacity"]), 1)
    o = sigmoid(parameters["opacity"])
    gradients["opacity"] += (opacity_weight / n * o * (1 - o)).astype(np.float32)
    gradients["scale"] += (scale_weight / (3 * n) * np.exp(parameters["scale"]) / extent).astype(np.float32)


def mcmc_noise(parameters: dict, reach: float, key: tuple[int, ...], frozen: int = 0) -> None:
    """TrainingBackend.mcmc_noise()."""
    asserts.mcmc_noise(parameters)
    opacity = sigmoid(parameters["opacity"])
    gate = 1 / (1 + np.exp(-SHARPNESS * ((1 - opacity) - GATE)))
    rows = frozen + np.flatnonzero(gate[frozen:] > NEGLIGIBLE)
    if not len(rows):
        return
    step = np.random.default_rng(key).standard_normal((len(rows), 3)) * (gate[rows] * reach)[:, None]
    axes = rotations.to_matrices(rotations.unit(np.asarray(parameters["rotation"][rows], np.float64)))
    scale = np.exp(parameters["scale"][rows].astype(np.float64))
    parameters["position"][rows] += np.einsum("nij,nj,nkj,nk->ni", axes, scale**2, axes, step).astype(np.float32)


def adam(rows: np.ndarray, tensors, betas: tuple[float, float], moved: np.ndarray, step: int, since: np.ndarray | None = None) -> None:
    """TrainingBackend.adam()."""
    asserts.adam(tensors, moved)
    table, pieces = kernels.corrections(*betas), []
    assert len(rows) == 0 or (rows.min() >= 0 and rows.max() < len(moved))
    reach = kernels.reach((steps_since(rows, moved, step) if since is None else since)[rows])
    for value, gradient, mean, square, count, rate, floor, shared in tensors:
        n = len(value)
        these, far = (np.arange(n), np.ones(n, np.float32)) if shared else (rows, reach)
        arrays = [a.reshape(n, math.prod(value.shape[1:])) for a in (value, np.ascontiguousarray(gradient, np.float32), mean, square)]
        columns = np.broadcast_to(np.asarray(rate, np.float32).reshape(-1), arrays[0].shape[1]).copy()
        rest = (these, far, *arrays, count, columns, np.float32(max(floor, kernels.EPSILON)), *betas, table)
        pieces += [(*piece, rest) for piece in ranges(len(these), ROWS)]
    run(lambda first, last, rest: kernels.adam(first, last, *rest), pieces)
    moved[rows] = step
