# SPDX-License-Identifier: GPL-3.0-or-later
"""A stable sort of positive floats by their bits, on several threads (radix sort)."""
from __future__ import annotations

import numpy as np

from ...util.threads import ranges, run, thread_count
from .jit import kernel
from .memory import empty

DIGIT = 11
"""The most bits of a digit."""


@kernel
def histogram(keys, low, shift, mask, counts):
    """Count into counts how often each digit (key - low >> shift & mask) occurs."""
    for i in range(len(keys)):
        counts[np.intp((keys[i] - low) >> shift & mask)] += 1


@kernel
def scatter(keys, order, low, shift, mask, begins, keys_out, order_out):
    """One pass of a radix sort; begins holds where each digit's next key goes."""
    for i in range(len(keys)):
        key = keys[i]
        digit = np.intp((key - low) >> shift & mask)
        at = begins[digit]
        begins[digit] = at + 1
        keys_out[at] = key
        order_out[at] = order[i]


def order_by(depth: np.ndarray, index: np.ndarray) -> np.ndarray:
    """index [V] int32, reordered so that depth [V] float32 >= 0 ascends; equal depths keep their order.

    Only the bits in which the keys differ are sorted.
    """
    keys = np.ascontiguousarray(depth, np.float32).view(np.uint32)
    if len(keys) < 2:
        return index
    low = keys.min()
    bits = int(keys.max() - low).bit_length()
    passes = -(-bits // DIGIT)
    digit = -(-bits // max(passes, 1))
    pieces = ranges(len(keys), max(-(-len(keys) // thread_count()), 16_384))
    mask = np.uint32((1 << digit) - 1)
    buffers = [empty(index.shape, kind, len(index)) for kind in (np.uint32, np.uint32, np.int32, np.int32)]
    for number in range(passes):
        shift = np.uint32(number * digit)
        counts = np.zeros((len(pieces), 1 << digit), np.int32)
        run(lambda p, first, last: histogram(keys[first:last], low, shift, mask, counts[p]),  # noqa: B023 (run here and now)
            [(p, *piece) for p, piece in enumerate(pieces)])
        by_digit = counts.T.ravel()
        begins = np.ascontiguousarray((np.cumsum(by_digit) - by_digit).reshape(-1, len(pieces)).T.astype(np.int32))
        keys_out, index_out = buffers[number % 2], buffers[2 + number % 2]
        run(lambda p, first, last: scatter(keys[first:last], index[first:last], low, shift, mask, begins[p],  # noqa: B023
                                           keys_out, index_out),  # noqa: B023
            [(p, *piece) for p, piece in enumerate(pieces)])
        keys, index = keys_out, index_out
    return index
