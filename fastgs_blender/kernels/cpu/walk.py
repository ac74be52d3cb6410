# SPDX-License-Identifier: GPL-3.0-or-later
"""On a graph: the random walker's potential, by conjugate gradients, and what hangs together."""
from __future__ import annotations

import numpy as np

from ...util.curve import hilbert_order
from .jit import kernel

CLOSE, MOST = 0.01, 600
"""Steps end where the residual is this share of the first one, or after so many."""


def potential(ends: np.ndarray, weight: np.ndarray, ground: np.ndarray, source: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The y [N] float32 for which sum_e weight (y_i - y_j)^2 + sum_i ground_i y_i^2 - 2 source_i y_i is least.

    ends [E, 2], weight [E] are the graph's edges; ground [N] > 0, source [N]; position [N, 3] puts neighbours side by side in memory
    """
    count, order = len(position), hilbert_order(position)
    rank = np.empty(count, np.int32)
    rank[order] = np.arange(count, dtype=np.int32)
    one = np.concatenate([rank[ends[:, 0]], rank[ends[:, 1]]])
    by = np.argsort(one, kind="stable")
    first = np.searchsorted(one[by], np.arange(count + 1)).astype(np.int32)
    other, pull = np.concatenate([rank[ends[:, 1]], rank[ends[:, 0]]])[by], np.concatenate([weight, weight])[by].astype(np.float32)
    diagonal = np.bincount(one, np.concatenate([weight, weight]), count).astype(np.float32) + ground[order].astype(np.float32)
    y, residual = np.zeros(count, np.float32), source[order].astype(np.float32)
    step = scaled = residual / diagonal
    size = begun = float(residual @ scaled)
    for _ in range(MOST if begun > 0 else 0):
        turned = diagonal * step
        without_neighbours(first, other, pull, step, turned)
        along = np.float32(size / float(step @ turned))
        y += along * step
        residual = residual - along * turned
        scaled = residual / diagonal
        before, size = size, float(residual @ scaled)
        if size <= CLOSE**2 * begun:
            break
        step = scaled + np.float32(size / before) * step
    return y[rank]


@kernel
def without_neighbours(first, other, pull, x, out):
    """Take from out [N] what each row's neighbours pull: first [N + 1] is where a row begins in other and pull [2 E]."""
    for i in range(len(out)):
        total = np.float32(0)
        for e in range(first[i], first[i + 1]):
            total += pull[e] * x[other[e]]
        out[i] -= total


@kernel
def pieces(count, ends):
    """For each of count nodes the first node [N] of its piece: of what the edges, ends [E, 2], join."""
    first = np.arange(count)
    for e in range(len(ends)):
        a, b = ends[e, 0], ends[e, 1]
        while first[a] != a:
            first[a] = first[first[a]]
            a = first[a]
        while first[b] != b:
            first[b] = first[first[b]]
            b = first[b]
        first[max(a, b)] = min(a, b)
    for a in range(count):
        first[a] = first[first[a]]  # the first node of a piece comes before all others
    return first
