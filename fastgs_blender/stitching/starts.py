# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions from which a fit may begin: triples of places that look alike on both surfaces, by what lies around each (RANSAC).

A place is described by how the surface around it is turned towards its own: a histogram over pairs of points of the cosines between their
normals and the way from one to the other (Rusu et al. 2009), of unsigned normals, in shells of distance.
"""
from collections.abc import Callable
from typing import Any

import numpy as np

from ..util.rotations import transformed
from .em_icp import spread
from .skins import Cells

CELLS = 34.0
"""Cells along a surface's spread."""
KEYS = 1400
"""Places of a surface that are described."""
SHELLS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the radius within which a place is described."""
RADIUS = 0.3
"""Of this description, in spreads."""
BINS = 5
"""Of a cosine, 0..1."""
COLOUR = 0.3
"""Weight of a place's colour beside it."""
ALIKE = 3
"""Places of the other surface that a place may belong to: so many that look most like it."""
TRIPLES = 250_000
"""Triples of pairs that are looked at."""
STRETCH = 0.07
"""Sides of two triangles that belong together differ by no more than this share."""
TRIED = 2500
"""Motions that are counted out, of triangles that belong together."""
BEST = 6
"""So many starts are proposed."""
SCALES = (1.0, 0.75, 1.33)
"""Factors on the scale that gives both surfaces the same spread."""


def starts(moving: np.ndarray, fixed: np.ndarray, scale: bool, progress: Callable[[float], Any]) -> list[np.ndarray]:
    """Motions [4, 4] that bring points [P, 3] about onto points [Q, 3], the most promising first; they differ from each other."""
    spread_a, spread_b = (spread(points) for points in (moving, fixed))
    edge = spread_b / CELLS * 2
    cells_b, found = Cells.of(fixed, edge), []
    keys_b, looks_b = _described(cells_b, RADIUS * spread_b)
    factors = [spread_b / spread_a * factor for factor in SCALES] if scale else [1.0]
    for number, factor in enumerate(factors):
        cells_a = Cells.of(moving * [*[factor] * 3, 1, 1, 1], edge)
        keys_a, looks_a = _described(cells_a, RADIUS * spread_b)
        some = cells_a.place[:: max(len(cells_a.place) // 400, 1)]
        for score, motion in _drawn(keys_a, looks_a, keys_b, looks_b, some, cells_b, scale):
            motion[:3, :3] *= factor
            found.append((score, motion))
        progress((number + 1) / len(factors))
    found.sort(key=lambda each: -each[0])
    some = moving[:: max(len(moving) // 300, 1), :3]
    chosen: list[np.ndarray] = []
    for _, motion in found:
        moved = transformed(some, motion)
        if all(np.linalg.norm(moved - transformed(some, m), axis=1).mean() > 0.15 * spread_b for m in chosen):
            chosen.append(motion)
        if len(chosen) == BEST:
            break
    return chosen


def _described(cells: Cells, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Places [K, 3] of a surface and what lies around each [K, D], as unit vectors; where the surface bends first."""
    from ..kernels.cpu.cells import count_turns  # it brings numba, which enabling the add-on must not

    rng = np.random.default_rng(0)
    chosen = rng.choice(len(cells.place), min(2 * KEYS, len(cells.place)), replace=False)
    count = np.zeros((len(chosen), len(SHELLS) - 1, BINS, BINS))
    count_turns(cells.place, cells.normal, chosen, np.array(SHELLS) * radius, count)
    count = count.reshape(*count.shape[:2], -1)
    share = np.sqrt(count / np.maximum(count.sum(2, keepdims=True), 1)).reshape(len(chosen), -1)
    unusual = np.linalg.norm(share - share.mean(0), axis=1)
    best = np.argsort(-unusual, kind="stable")[:KEYS]
    return cells.place[chosen[best]], np.concatenate([share[best], COLOUR * cells.colour[chosen[best]]], 1)


def _drawn(keys_a: np.ndarray, looks_a: np.ndarray, keys_b: np.ndarray, looks_b: np.ndarray, some: np.ndarray, cells: Cells,
           scale: bool) -> list[tuple[float, np.ndarray]]:
    """Motions [4, 4] of triples of pairs, with the share of places [S, 3] that they bring onto the cells: the best of them."""
    likeness = 2 * looks_a @ looks_b.T - (looks_a**2).sum(1)[:, None] - (looks_b**2).sum(1)
    close = np.argpartition(-likeness, ALIKE, 1)[:, :ALIKE]
    back = np.argpartition(-likeness.T, 2 * ALIKE, 1)[:, :2 * ALIKE]
    i, j = np.repeat(np.arange(len(keys_a)), ALIKE), close.ravel()
    mutual = (back[j] == i[:, None]).any(1)
    i, j = i[mutual], j[mutual]
    if len(i) < 3:
        return []
    rng = np.random.default_rng(1)
    three = rng.integers(0, len(i), (TRIPLES, 3))
    a, b = keys_a[i[three]], keys_b[j[three]]
    sides_a, sides_b = (np.linalg.norm(p - np.roll(p, 1, 1), axis=2) for p in (a, b))
    ratio = np.log(np.maximum(sides_b, 1e-12) / np.maximum(sides_a, 1e-12))
    middle = ratio.mean(1, keepdims=True) if scale else 0.0
    good = (np.abs(ratio - middle).max(1) < STRETCH) & (sides_a.min(1) > 8 * cells.edge) & (np.abs(ratio).max(1) < 0.4)
    good = np.flatnonzero(good)[:TRIED]
    if not len(good):
        return []
    a, b = a[good], b[good]
    x, y = a - a.mean(1, keepdims=True), b - b.mean(1, keepdims=True)
    u, s, vt = np.linalg.svd(np.einsum("sni,snj->sij", y, x))
    mirror = np.ones((len(a), 3))
    mirror[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = (u * mirror[:, None]) @ vt
    factor = (s * mirror).sum(1) / (x * x).sum((1, 2)) if scale else np.ones(len(a))
    motions = np.tile(np.eye(4), (len(a), 1, 1))
    motions[:, :3, :3] = factor[:, None, None] * turn
    motions[:, :3, 3] = b.mean(1) - np.einsum("sij,sj->si", motions[:, :3, :3], a.mean(1))
    for count, best in ((100, 120), (len(some), 20)):
        few = some[:: max(len(some) // count, 1)]
        score = np.empty(len(motions))
        for k in range(0, len(motions), 200):
            m = motions[k:k + 200]
            moved = np.einsum("sij,nj->sni", m[:, :3, :3], few) + m[:, None, :3, 3]
            score[k:k + 200] = (cells.nearest(moved.reshape(-1, 3))[1] < cells.edge).reshape(len(m), -1).mean(1)
        first = np.argsort(-score, kind="stable")[:best]
        motions, score = motions[first], score[first]
    return list(zip(score.tolist(), motions))
