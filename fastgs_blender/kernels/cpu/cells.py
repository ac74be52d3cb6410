# SPDX-License-Identifier: GPL-3.0-or-later
"""Cubes that hold a surface's points, by sorted numbers: what lies in those around a place."""
from __future__ import annotations

import numpy as np

from .jit import inline, kernel

OFFSET = 1 << 20
"""Cubes are numbered from minus to plus this along each axis."""


@inline
def begin_of(keys, key):
    """Where the first of sorted keys stands that is no less than a key."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@inline
def number_of(value, edge):
    """Of the cube that holds a value along an axis."""
    return np.int64(max(min(np.floor(value / edge), OFFSET - 3.0), 3.0 - OFFSET)) + OFFSET


@inline
def column_of(place, edge, x, y):
    """The number of the lowest cube of a column: that beside the cube around a place [3], by -1, 0 or 1 along two axes, and below it."""
    return ((number_of(place[0], edge) + x) << 42) | ((number_of(place[1], edge) + y) << 21) | (number_of(place[2], edge) - 1)


@kernel
def nearest_places(keys, place, edge, points, found, away):
    """For points [Q, 3] which of the places [C, 3] in the cubes around each is nearest: found [Q] int64, and away [Q], inf for none."""
    for q in range(len(points)):
        at, least = 0, np.inf
        for x in range(-1, 2):
            for y in range(-1, 2):
                key = column_of(points[q], edge, x, y)
                c = begin_of(keys, key)
                while c < len(keys) and keys[c] <= key + 2:
                    squared = ((place[c, 0] - points[q, 0]) ** 2 + (place[c, 1] - points[q, 1]) ** 2) + (place[c, 2] - points[q, 2]) ** 2
                    if squared < least:
                        at, least = c, squared
                    c += 1
        found[q], away[q] = at, np.sqrt(least)


@kernel
def add_around(keys, place, edge, values, sums):
    """Add to sums [C, V] the values [C, V] of the cubes around each, its own among them."""
    for q in range(len(place)):
        for x in range(-1, 2):
            for y in range(-1, 2):
                key = column_of(place[q], edge, x, y)
                c = begin_of(keys, key)
                while c < len(keys) and keys[c] <= key + 2:
                    for k in range(values.shape[1]):
                        sums[q, k] += values[c, k]
                    c += 1


@kernel
def count_turns(place, normal, chosen, limits, counts):
    """Count into counts [K, S, B, B] how the surface around chosen [K] of the places [C, 3] is turned, see stitching/starts.py: in shells
    between limits [S + 1], by two cosines, that between the normals [C, 3] and that of the chosen one's to the way to the other."""
    shells, bins = counts.shape[1], counts.shape[2]
    far = limits[shells] ** 2
    for k in range(len(chosen)):
        i = chosen[k]
        for j in range(len(place)):
            x, y, z = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1], place[j, 2] - place[i, 2]
            squared = x * x + y * y + z * z
            if squared >= far or squared <= 1e-18:
                continue
            d = np.sqrt(squared)
            shell = 0
            while shell < shells - 1 and d >= limits[shell + 1]:
                shell += 1
            turned = abs(normal[i, 0] * normal[j, 0] + normal[i, 1] * normal[j, 1] + normal[i, 2] * normal[j, 2])
            aside = abs(normal[i, 0] * x + normal[i, 1] * y + normal[i, 2] * z) / d
            counts[k, shell, min(int(turned * bins), bins - 1), min(int(aside * bins), bins - 1)] += 1
