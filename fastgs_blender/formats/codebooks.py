# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of few values that stand for many: 256 numbers (Lloyd's method on sorted values) and palettes of vectors (splits in two)."""
import heapq

import numpy as np

ENTRIES = 256
ROUNDS = 30
"""Of Lloyd's method; it changes little after ten."""
BINS = 64
MAX_PALETTE = 1 << 16


def codebook(values: np.ndarray) -> tuple[list[float], np.ndarray]:
    """256 rising numbers for all values of an array, and the index (u8, the array's shape) of the one nearest to each value."""
    flat = np.sort(values, axis=None).astype(np.float64)
    distinct = np.unique(flat)
    if len(distinct) <= ENTRIES:
        table = np.concatenate([distinct, np.full(ENTRIES - len(distinct), distinct[-1] if len(distinct) else 0.0)])
    else:
        total = np.concatenate([[0.0], np.cumsum(flat)])
        count, edges = np.histogram(flat, BINS)
        density = np.concatenate([[0.0], np.cumsum((count + 0.01) ** (1 / 3))])  # the best table is as dense as the values' cube root
        table = np.interp((np.arange(ENTRIES) + 0.5) / ENTRIES, density / density[-1], edges)
        for _ in range(ROUNDS):
            ends = np.searchsorted(flat, (table[1:] + table[:-1]) / 2)
            edges = np.concatenate([[0], ends, [len(flat)]])
            count = np.diff(edges)
            mean = np.diff(total[edges]) / np.maximum(count, 1)
            table = np.sort(np.where(count > 0, mean, table))
    table = table.astype(np.float32).astype(np.float64)
    middles = (table[1:] + table[:-1]) / 2
    return table.tolist(), np.minimum(np.searchsorted(middles, values), ENTRIES - 1).astype(np.uint8)


def palette(vectors: np.ndarray, most: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Few vectors [P, D] for many [N, D], and the index [N] of the one that stands for each.

    The group with the largest sum of squared errors is split in two at its mean along the axis that it varies most on, until there
    are `most` groups: by default 1024 for every 1024 vectors up to a power of two, and never more than 65536, as PlayCanvas has it.
    """
    vectors = np.asarray(vectors, np.float32)
    n = len(vectors)
    if most is None:
        most = int(min(MAX_PALETTE, 1024 * 2 ** max(0, np.floor(np.log2(max(n, 1) / 1024)))))
    groups = [np.arange(n)]
    heap: list[tuple[float, int, int]] = []

    def weigh(number: int) -> None:
        part = vectors[groups[number]] - vectors[groups[number][0]]
        spread = np.einsum("nd,nd->d", part, part, dtype=np.float64) - part.sum(0, dtype=np.float64) ** 2 / len(part)
        if spread.max(initial=0) > 1e-12:
            heapq.heappush(heap, (-spread.sum(), number, int(spread.argmax())))

    if n:
        weigh(0)
    while heap and len(groups) < most:
        _, number, axis = heapq.heappop(heap)
        members = groups[number]
        column = vectors[members, axis].astype(np.float64)
        upper = column > column.mean()
        if upper.all() or not upper.any():
            continue
        groups[number] = members[~upper]
        groups.append(members[upper])
        weigh(number)
        weigh(len(groups) - 1)
    label = np.empty(n, np.int64)
    entries = np.empty((len(groups), vectors.shape[1]))
    for number, members in enumerate(groups):
        label[members] = number
        entries[number] = vectors[members].astype(np.float64).mean(0) if len(members) else 0
    return entries, label
