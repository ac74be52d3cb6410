# SPDX-License-Identifier: GPL-3.0-or-later
"""On a graph: the random walker's potential, by conjugate gradients, and what hangs together."""
from __future__ import annotations

import numpy as np

from .jit import kernel

CLOSE, MOST = 0.01, 600
"""Steps end where the residual is this share of the first one, or after so many."""


def potential(ends: np.ndarray, weight: np.ndarray, ground: np.ndarray, source: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The y [N] float32 for which sum_e weight (y_i - y_j)^2 + sum_i ground_i y_i^2 - 2 source_i y_i is least.

    ends [E, 2], weight [E] are the graph's edges; ground [N] > 0, source [N]; order [N] puts neighbours side by side in memory
    """
    count = len(order)
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


def gathered(ends: np.ndarray, values: np.ndarray) -> np.ndarray:
    """For each node the sum of its own values [N, S, K] float32 and of those that edges, ends [E, 2], join it with."""
    total = values.copy()
    add_neighbours(ends, values, total)
    return total


@kernel
def add_neighbours(ends, values, total):
    """Add to each node's total [N, S, K] the values [N, S, K] of those that edges join it with."""
    for e in range(len(ends)):
        a, b = ends[e, 0], ends[e, 1]
        for s in range(values.shape[1]):
            for k in range(values.shape[2]):
                total[a, s, k] += values[b, s, k]
                total[b, s, k] += values[a, s, k]


@kernel
def distances(ends, places, seen, low, high):
    """The least and the greatest distance, low and high [E], that the two ends of each edge have at moments at which both are seen.

    places [N, S, 3] and seen [N, S] are by moments; low and high begin as inf and 0
    """
    for e in range(len(ends)):
        a, b = ends[e, 0], ends[e, 1]
        for s in range(seen.shape[1]):
            if seen[a, s] and seen[b, s]:
                x, y, z = places[a, s, 0] - places[b, s, 0], places[a, s, 1] - places[b, s, 1], places[a, s, 2] - places[b, s, 2]
                apart = np.sqrt(x * x + y * y + z * z)
                low[e], high[e] = min(low[e], apart), max(high[e], apart)
