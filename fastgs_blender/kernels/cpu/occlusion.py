# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns the depths at which a holdout hides splats (holdout.py) into events for the rasteriser of splats.

An event says in front of which splat of a tile's list which pixel loses one of its points: from there on it has that much less light
to give.  So the rasteriser's inner loop is the same with a holdout and without.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from .jit import inline


@inline
def losses(depths, depth, begin, end, ids, attributes):
    """When pixels of a tile lose points: of each event, which of the splats begin..end is the first behind, and the pixel; in order.

    depths [pixels, points], inf where nothing is; depth: the column of attributes that is a splat's depth.
    `end` stands for no splat.
    """
    count = end - begin
    splat = np.empty(count, np.float32)
    for k in range(count):
        splat[k] = attributes[ids[begin + k], depth]
    ends = np.zeros(count + 2, np.int64)
    place = np.empty(depths.shape, np.int32)
    for p in range(depths.shape[0]):
        for s in range(depths.shape[1]):
            d = depths[p, s]
            if not d < float32(np.inf):
                place[p, s] = -1
                continue
            low, high = 0, count
            while low < high:
                middle = (low + high) // 2
                if splat[middle] > d:
                    high = middle
                else:
                    low = middle + 1
            place[p, s] = low
            ends[low + 1] += 1
    for k in range(count + 1):
        ends[k + 1] += ends[k]
    when, pixel = np.empty(ends[count + 1], np.int64), np.empty(ends[count + 1], np.int64)
    for p in range(depths.shape[0]):
        for s in range(depths.shape[1]):
            k = place[p, s]
            if k >= 0:
                when[ends[k]], pixel[ends[k]] = begin + k, p
                ends[k] += 1
    return when, pixel


@inline
def farthest(depths, out):
    """Of each pixel that is covered in all of its points, the farthest of their depths [pixels, points]; inf in others."""
    for p in range(depths.shape[0]):
        out[p] = depths[p].max()


@inline
def lose(state, left, held, p):
    """Take one of a pixel's points away: state, which may have its sign turned, keeps the light of the others."""
    before = abs(state[p])
    after = before * float32(left[p] - 1) / float32(left[p])  # exact where no splat has been blended
    left[p] -= 1
    held[p] += before - after
    state[p] = math.copysign(after, state[p])
