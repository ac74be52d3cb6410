# SPDX-License-Identifier: GPL-3.0-or-later
"""Orders points along Hilbert's curve through space: neighbours on the curve are neighbours in space.

On Morton's curve every second step is a jump."""
import numpy as np

BITS = 21
"""Of a coordinate: three make a whole number of 63 bits."""


def hilbert_order(position: np.ndarray) -> np.ndarray:
    """Indices [N] that put positions [N, 3] along the curve (Skilling, Programming the Hilbert curve, 2004)."""
    if not len(position):
        return np.zeros(0, np.intp)
    low, high = position.min(0).astype(np.float64), position.max(0)
    cells = ((position - low) * ((2**BITS - 1) / np.maximum(high - low, 1e-30))).astype(np.uint64)
    x = list(cells.T)
    for bit in range(BITS - 1, 0, -1):
        one, below = np.uint64(1 << bit), np.uint64((1 << bit) - 1)
        for i in range(3):
            up = (x[i] & one) != 0
            swap = np.where(up, np.uint64(0), (x[0] ^ x[i]) & below)
            x[0] = x[0] ^ np.where(up, below, swap)
            if i:
                x[i] = x[i] ^ swap
    x[1] = x[1] ^ x[0]
    x[2] = x[2] ^ x[1]
    turn = np.zeros(len(position), np.uint64)
    for bit in range(BITS - 1, 0, -1):
        turn ^= np.where((x[2] & np.uint64(1 << bit)) != 0, np.uint64((1 << bit) - 1), np.uint64(0))
    key = np.zeros(len(position), np.uint64)
    for bit in range(BITS - 1, -1, -1):
        for i in range(3):
            key = key << np.uint64(1) | ((x[i] ^ turn) >> np.uint64(bit)) & np.uint64(1)
    return np.argsort(key, kind="stable")
