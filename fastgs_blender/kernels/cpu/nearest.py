# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest neighbours by several turned k-d trees: among the points of each one's leaf."""
from __future__ import annotations

from functools import partial

import numpy as np

from ...util.threads import ranges, run
from .. import asserts
from .jit import kernel

CHUNK = 64
"""Leaves of a piece of work."""


def nearest(points: np.ndarray, turns: list[np.ndarray], count: int, leaf: int) -> tuple[np.ndarray, np.ndarray]:
    """TrainingBackend.nearest()."""
    asserts.nearest(points, turns)
    index, squared = np.full((len(points), count), -1, np.int32), np.full((len(points), count), np.inf, np.float32)
    turned = [np.ascontiguousarray(points @ turn, np.float32) for turn in turns]
    for tree, (order, ends) in zip(turned, run(lambda i: leaves(turned[i], leaf), [(i,) for i in range(len(turned))])):
        run(partial(among_leaves, tree, order, ends, index, squared), ranges(len(ends) - 1, CHUNK))
    return index, squared


@kernel
def leaves(points, leaf):
    """The points' numbers [P] int32 in the order of the leaves, of at most `leaf` points, of a k-d tree of points [P, D]; and where the
    leaves end, from 0 on [L + 1]."""
    order = np.arange(len(points)).astype(np.int32)
    ends = [0]
    stack = [(0, len(points))]
    while stack:
        first, last = stack.pop()
        if last - first <= leaf:
            if last > first:
                ends.append(last)
            continue
        axis, widest = 0, -1.0
        for k in range(points.shape[1]):
            low = high = points[order[first], k]
            for i in range(first + 1, last):
                value = points[order[i], k]
                low = value if value < low else low
                high = value if value > high else high
            if high - low > widest:
                axis, widest = k, high - low
        middle = first + (last - first) // 2
        a, b = first, last - 1
        while a < b:  # Hoare's selection: what lies below the middle one comes before it
            pivot = points[order[(a + b) // 2], axis]
            i, j = a, b
            while i <= j:
                while points[order[i], axis] < pivot:
                    i += 1
                while points[order[j], axis] > pivot:
                    j -= 1
                if i <= j:
                    order[i], order[j] = order[j], order[i]
                    i, j = i + 1, j - 1
            if middle <= j:
                b = j
            elif middle >= i:
                a = i
            else:
                break
        stack.append((middle, last))
        stack.append((first, middle))
    return order, np.array(ends)


@kernel
def among_leaves(points, order, ends, index, squared, first, last):
    """Take nearer neighbours from the leaves first..last into index and squared [P, count], which are sorted by distance."""
    count, width = index.shape[1], points.shape[1]
    for cell in range(first, last):
        begin, number = ends[cell], ends[cell + 1] - ends[cell]
        inside, apart = np.empty((width, number), np.float32), np.empty(number, np.float32)
        for i in range(number):
            for k in range(width):
                inside[k, i] = points[order[begin + i], k]
        for i in range(number):
            row = order[begin + i]
            nearest, others = squared[row], index[row]
            new = others[0] < 0  # nothing is known from another tree
            for j in range(number):
                apart[j] = 0
            for k in range(width):
                line, mine = inside[k], inside[k, i]
                for j in range(number):
                    apart[j] += (line[j] - mine) ** 2
            farthest = nearest[count - 1]
            for j in range(number):
                if i == j or not (apart[j] < farthest):
                    continue
                distance, other, known = apart[j], order[begin + j], False
                if not new:
                    for k in range(count):
                        known = known or others[k] == other
                if known:
                    continue
                place = count - 1
                while place > 0 and nearest[place - 1] > distance:
                    nearest[place], others[place] = nearest[place - 1], others[place - 1]
                    place -= 1
                nearest[place], others[place] = distance, other
                farthest = nearest[count - 1]
