# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that pictures use one after the other: the system clears fresh pages, which takes a tenth of a frame."""
from __future__ import annotations

import math
import threading
import weakref

import numpy as np

from ...util.threads import portions, run

SPLATS = 800_000
"""Splats up to which memory is kept: that of more would be much of what a process holds."""
LEAST = 1 << 18
"""Bytes of an array from which on it is worth a search."""
ROWS = 65_536
"""Rows that are cleared at once, at most."""
MOST = 96 << 20
"""Bytes that are kept at most."""

_lock = threading.Lock()
_blocks: list[tuple[np.ndarray, weakref.ref[np.ndarray]]] = []
"""Blocks of bytes, the one in use for longest first, and the array whose views lie in each: gone where nobody has any of them."""


def empty(shape: tuple[int, ...], dtype: type, splats: int) -> np.ndarray:
    """np.empty() for a picture of so many splats, in the memory of arrays before that nobody has any more."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if splats > SPLATS or size < LEAST:
        return np.empty(shape, dtype)
    with _lock:
        free = [k for k, (block, user) in enumerate(_blocks) if size <= len(block) <= 2 * size and user() is None]
        block = _blocks.pop(min(free, key=lambda k: len(_blocks[k][0])))[0] if free else np.empty(size + size // 8, np.uint8)
        whole = np.frombuffer(block.data[:size], np.uint8)  # the base of all views
        _blocks.append((block, weakref.ref(whole)))
        while sum(len(block) for block, _ in _blocks) > MOST:
            del _blocks[0]
    return whole.view(dtype).reshape(shape)


def zeros(shape: tuple[int, ...], dtype: type, splats: int) -> np.ndarray:
    """np.zeros() in such memory, on all threads."""
    array = empty(shape, dtype, splats)
    run(lambda first, last: array[first:last].fill(0), portions(len(array), ROWS, ROWS // 4))
    return array
