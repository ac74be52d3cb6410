# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that finds in which direction the Gaussians around each Gaussian spread least: the normal of their surface."""
from __future__ import annotations

import numpy as np

from ...util.threads import ranges, run
from .. import asserts
from .jit import inline, kernel

SWEEPS = 4
"""Of Jacobi's rotations; a matrix of three rows is then diagonal to rounding."""
SMALL = 1e-8
"""Share of a matrix's trace beside which an element counts as 0."""
CHUNK = 4096
"""Gaussians in one piece of work."""
FARTHEST = 1 << 20
"""Cells from the first one in which neighbours are told apart."""


def thinnest(places: np.ndarray, spreads: np.ndarray, weights: np.ndarray, reach: float) -> np.ndarray:
    """PictureBackend.thinnest()."""
    asserts.thinnest(places, spreads, weights)
    out = np.zeros((len(places), 3))
    if not len(places):
        return out
    low = places.min(0)
    cell = np.clip((places - low) / reach, 0, FARTHEST).astype(np.int64)
    _, wide, deep = cell.max(0) + 3  # an empty cell at either end, so that every cell has neighbours
    key = (cell[:, 0] * wide + cell[:, 1]) * deep + cell[:, 2]
    beside = (np.arange(-1, 2)[:, None] * wide + np.arange(-1, 2)).ravel() * deep
    order = np.argsort(key, kind="stable")
    args = places[order], spreads[order], weights[order], key[order], beside, float(reach)
    found = np.zeros((len(places), 3))
    run(lambda begin, end: _thinnest(*args, begin, end, found), ranges(len(places), CHUNK))
    out[order] = found
    return out


@kernel
def _thinnest(places, spreads, weights, keys, beside, reach, begin, end, out):
    c, v, first, last = np.empty((3, 3)), np.empty((3, 3)), np.empty(9, np.int64), np.empty(9, np.int64)
    for row in range(9):
        first[row] = last[row] = np.searchsorted(keys, keys[begin] + beside[row] - 1)
    for p in range(begin, end):
        if p == begin or keys[p] != keys[p - 1]:
            for row in range(9):  # keys grow with p, so that the cells beside it only move on
                while first[row] < len(keys) and keys[first[row]] < keys[p] + beside[row] - 1:
                    first[row] += 1
                last[row] = max(last[row], first[row])
                while last[row] < len(keys) and keys[last[row]] <= keys[p] + beside[row] + 1:
                    last[row] += 1
        total = sx = sy = sz = 0.0
        xx = xy = xz = yy = yz = zz = 0.0
        for row in range(9):
            for n in range(first[row], last[row]):
                x, y, z = places[n, 0] - places[p, 0], places[n, 1] - places[p, 1], places[n, 2] - places[p, 2]
                near = 1 - (x * x + y * y + z * z) / (reach * reach)
                if near > 0:
                    w = weights[n] * near * near
                    total += w
                    sx, sy, sz = sx + w * x, sy + w * y, sz + w * z
                    xx, xy, xz = xx + w * (x * x + spreads[n, 0]), xy + w * (x * y + spreads[n, 1]), xz + w * (x * z + spreads[n, 2])
                    yy, yz = yy + w * (y * y + spreads[n, 3]), yz + w * (y * z + spreads[n, 4])
                    zz += w * (z * z + spreads[n, 5])
        total = max(total, 1e-300)
        sx, sy, sz = sx / total, sy / total, sz / total
        c[0, 0], c[0, 1], c[0, 2] = xx / total - sx * sx, xy / total - sx * sy, xz / total - sx * sz
        c[1, 0], c[1, 1], c[1, 2] = c[0, 1], yy / total - sy * sy, yz / total - sy * sz
        c[2, 0], c[2, 1], c[2, 2] = c[0, 2], c[1, 2], zz / total - sz * sz
        _diagonalise(c, v)
        k = 0
        for i in range(1, 3):
            if c[i, i] < c[k, k]:
                k = i
        for i in range(3):
            out[p, i] = v[i, k]


@inline
def _diagonalise(c, v):
    """Turn a symmetric matrix [3, 3] into its eigenvalues, on its diagonal, and the columns of v into its eigenvectors (Jacobi)."""
    for i in range(3):
        for j in range(3):
            v[i, j] = 1.0 if i == j else 0.0
    small = SMALL * (c[0, 0] + c[1, 1] + c[2, 2])
    for _ in range(SWEEPS):
        for i in range(2):
            for j in range(i + 1, 3):
                if abs(c[i, j]) <= small:
                    continue
                ratio = (c[j, j] - c[i, i]) / (2 * c[i, j])
                t = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + np.sqrt(ratio * ratio + 1))
                cosine = 1 / np.sqrt(t * t + 1)
                sine = t * cosine
                for k in range(3):
                    a, b = c[k, i], c[k, j]
                    c[k, i], c[k, j] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(3):
                    a, b = c[i, k], c[j, k]
                    c[i, k], c[j, k] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(3):
                    a, b = v[k, i], v[k, j]
                    v[k, i], v[k, j] = cosine * a - sine * b, sine * a + cosine * b
