# SPDX-License-Identifier: GPL-3.0-or-later
"""A stable sort of positive floats by their bits, on several threads (radix sort)."""
from __future__ import annotations

import numpy as np

from ...util.threads import ranges, run, thread_count
from .jit import kernel
from .memory import empty

DIGIT = 12
"""The most bits of a digit."""


@kernel
def histogram(words, shift, mask, counts):
    """Count into counts how often each digit (word >> shift & mask) occurs."""
    for i in range(len(words)):
        counts[np.uintp(words[i] >> shift & mask)] += 1


@kernel
def scatter(words, shift, mask, begins, out):
    """One pass of a radix sort; begins holds where each digit's next word goes."""
    for i in range(len(words)):
        word = words[i]
        digit = np.uintp(word >> shift & mask)
        at = begins[digit]
        begins[digit] = at + np.uint32(1)
        out[at] = word


def order_by(depth: np.ndarray, index: np.ndarray) -> np.ndarray:
    """index [V] int32, reordered so that depth [V] float32 >= 0 ascends; equal depths keep their order.

    Only the bits in which the keys differ are sorted.  A word has a key and its index: one stream to each place, not two.
    """
    keys = np.ascontiguousarray(depth, np.float32).view(np.uint32)
    if len(keys) < 2:
        return index
    low = keys.min()
    bits = int(keys.max() - low).bit_length()
    passes = -(-bits // DIGIT)
    digit = -(-bits // max(passes, 1))
    pieces = ranges(len(keys), max(-(-len(keys) // thread_count()), 16_384))
    mask = np.uint64((1 << digit) - 1)
    words, other = (empty(index.shape, np.uint64, len(index)) for _ in range(2))
    run(lambda first, last: _join(keys[first:last], low, index[first:last], words[first:last]), pieces)
    for number in range(passes):
        shift = np.uint64(32 + number * digit)
        counts = np.zeros((len(pieces), 1 << digit), np.uint32)
        run(lambda p, first, last: histogram(words[first:last], shift, mask, counts[p]),  # noqa: B023 (run here and now)
            [(p, *piece) for p, piece in enumerate(pieces)])
        by_digit = counts.T.ravel()
        begins = np.ascontiguousarray((np.cumsum(by_digit) - by_digit).reshape(-1, len(pieces)).T.astype(np.uint32))
        run(lambda p, first, last: scatter(words[first:last], shift, mask, begins[p], other),  # noqa: B023
            [(p, *piece) for p, piece in enumerate(pieces)])
        words, other = other, words
    return words.astype(np.int32)


def _join(keys, low, index, words):
    """Write keys - low into the high halves of words, and the index into the low ones, which come first in memory."""
    halves = words.view(np.uint32).reshape(-1, 2)
    halves[:, 0] = index
    np.subtract(keys, low, out=halves[:, 1])
