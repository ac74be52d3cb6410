# SPDX-License-Identifier: GPL-3.0-or-later
"""Stable sort of floats that are not negative, by their bits."""
from __future__ import annotations

import numpy as np

from .jit import kernel

BITS = 11
BUCKETS = 1 << BITS


@kernel
def _scatter(keys, order, shift, counts, keys_out, order_out):
    """One pass of a radix sort: by the BITS bits from `shift` on; counts [BUCKETS] holds where each bucket begins."""
    mask = np.uint32(BUCKETS - 1)
    for i in range(len(keys)):
        bucket = np.intp((keys[i] >> np.uint32(shift)) & mask)
        at = counts[bucket]
        counts[bucket] = at + 1
        keys_out[at] = keys[i]
        order_out[at] = order[i]


@kernel
def _histograms(keys):
    """How often each value of each digit occurs, [3, BUCKETS]."""
    counts = np.zeros((3, BUCKETS), np.int64)
    mask = np.uint32(BUCKETS - 1)
    for i in range(len(keys)):
        for digit in range(3):
            counts[digit, np.intp((keys[i] >> np.uint32(digit * BITS)) & mask)] += 1
    return counts


def order_by(depth: np.ndarray, index: np.ndarray) -> np.ndarray:
    """index [V] int32, reordered so that depth [V] float32 >= 0 ascends; equal depths keep their order."""
    keys = np.ascontiguousarray(depth, np.float32).view(np.uint32)
    counts = _histograms(keys)
    for digit in range(3):
        if counts[digit].max(initial=0) == len(keys):
            continue  # all alike
        begins = np.zeros(BUCKETS, np.int64)
        np.cumsum(counts[digit, :-1], out=begins[1:])
        keys_out, index_out = np.empty_like(keys), np.empty_like(index)
        _scatter(keys, index, digit * BITS, begins, keys_out, index_out)
        keys, index = keys_out, index_out
    return index
