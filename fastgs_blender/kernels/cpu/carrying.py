# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that move surfaces: weights of the Gaussians around vertices, where they put these, and means over neighbours."""
from __future__ import annotations

from functools import partial

import numpy as np

from ...util.threads import portions, run
from .. import asserts
from .jit import inline, kernel


def affine_weights(points: np.ndarray, places: np.ndarray, number: np.ndarray, weight: np.ndarray, reaches: np.ndarray,
                   ridge: float) -> np.ndarray:
    """SurfaceBackend.affine_weights()."""
    asserts.affine_weights(points, places, number, weight, reaches)
    out = np.zeros(weight.shape)
    run(lambda begin, end: _affine_weights(points, places, number, weight, reaches, ridge, begin, end, out), portions(len(points)))
    return out


@kernel
def _affine_weights(points, places, number, weight, reaches, ridge, begin, end, out):
    count, m, one = number.shape[1], np.empty((4, 5)), np.ones(4)
    for v in range(begin, end):
        total = 0.0
        for k in range(count):
            total += weight[v, k]
        if not total > 0:
            continue
        m[:] = 0
        for k in range(count):
            if weight[v, k] > 0:
                _away(points, places, number[v, k], v, reaches[v], one)
                for i in range(4):
                    for j in range(4):
                        m[i, j] += weight[v, k] / total * one[i] * one[j]
        for i in range(1, 4):
            m[i, i] += ridge
        m[0, 4] = 1
        _solve(m)
        total = 0.0
        for k in range(count):
            if weight[v, k] > 0:
                _away(points, places, number[v, k], v, reaches[v], one)
                out[v, k] = weight[v, k] * (m[0, 4] + m[1, 4] * one[1] + m[2, 4] * one[2] + m[3, 4] * one[3])
                total += out[v, k]
        for k in range(count):
            out[v, k] /= total if abs(total) > 1e-9 else 1.0


@inline
def _away(points, places, n, v, reach, one):
    """one[1:] becomes the way from a point to a Gaussian, in reaches."""
    for i in range(3):
        one[i + 1] = (places[n, i] - points[v, i]) / reach


@inline
def _solve(m):
    """Make the last column of a symmetric positive matrix [4, 4 + 1] the solution, by elimination."""
    for i in range(4):
        for j in range(4, i - 1, -1):
            m[i, j] /= m[i, i]
        for row in range(4):
            if row != i:
                for j in range(4, i - 1, -1):
                    m[row, j] -= m[row, i] * m[i, j]


def places(position: np.ndarray, motion: np.ndarray, weights: np.ndarray, wanted: np.ndarray, out: np.ndarray) -> None:
    """SurfaceBackend.places()."""
    asserts.places(position, motion, weights, wanted, out)
    run(partial(_places, position, motion, weights, wanted, out), portions(len(position)))


@kernel
def _places(position, motion, weights, wanted, out, begin, end):
    own = 1 if len(weights) > 1 else 0
    for n in range(begin, end):
        if wanted[n]:
            x, y, z = np.float64(position[n, 0]), np.float64(position[n, 1]), np.float64(position[n, 2])
            for k in range(motion.shape[1]):
                w = weights[own * n, k]
                x, y, z = x + w * motion[n, k, 0], y + w * motion[n, k, 1], z + w * motion[n, k, 2]
            out[n, 0], out[n, 1], out[n, 2] = x, y, z


def weighted_sums(values: np.ndarray, number: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """SurfaceBackend.weighted_sums()."""
    asserts.weighted_sums(values, number, weight)
    out = np.zeros((len(number), values.shape[1]))
    run(lambda begin, end: _weighted_sums(values, number, weight, begin, end, out), portions(len(number)))
    return out


@kernel
def _weighted_sums(values, number, weight, begin, end, out):
    for v in range(begin, end):
        for k in range(number.shape[1]):
            if weight[v, k] != 0:
                for i in range(values.shape[1]):
                    out[v, i] += weight[v, k] * values[number[v, k], i]


def support(opacity: np.ndarray, number: np.ndarray, weight: np.ndarray, before: np.ndarray) -> np.ndarray:
    """SurfaceBackend.support()."""
    asserts.support(opacity, number, weight, before)
    out = np.empty(len(number))
    run(lambda begin, end: _support(opacity, number, weight, before, begin, end, out), portions(len(number)))
    return out


@kernel
def _support(opacity, number, weight, before, begin, end, out):
    for v in range(begin, end):
        now = then = 0.0
        for k in range(number.shape[1]):
            now += abs(weight[v, k]) * min(opacity[number[v, k]], before[v, k])
            then += abs(weight[v, k]) * before[v, k]
        out[v] = now / max(then, 1e-12)


def smoothed(values: np.ndarray, first: np.ndarray, other: np.ndarray, rounds: int, share: float) -> np.ndarray:
    """SurfaceBackend.smoothed()."""
    asserts.smoothed(values, first)
    old, new = np.array(values, np.float64), np.empty(values.shape)
    for _ in range(rounds):
        run(partial(_smoothed, old, first, other, share, new), portions(len(old)))
        old, new = new, old
    return old


@kernel
def _smoothed(values, first, other, share, out, begin, end):
    for v in range(begin, end):
        number = max(first[v + 1] - first[v], 1)
        for i in range(values.shape[1]):
            total = 0.0
            for n in range(first[v], first[v + 1]):
                total += values[other[n], i]
            out[v, i] = (1 - share) * values[v, i] + share * (total / number)
