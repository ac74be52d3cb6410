# SPDX-License-Identifier: GPL-3.0-or-later
"""align(): moves one capture onto another so that the surfaces which both of them show lie on each other.

It is iterated closest points from coarse to fine: point to plane (Chen and Medioni 1992) in both directions, so that a scale does not
shrink, with weights that leave out what has no partner.  If it does not fit from where the capture stands, starts.py proposes other
places to begin from.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..rendering.instances import Instance
from ..util.errors import FastGSError
from ..util.rotations import exp, to_matrices, transform, transformed
from .em_icp import em_icp
from .similarity import Similarity
from .skins import Cells, moved, skin
from .starts import starts

LEVELS = (6, 11, 20, 40, 100)
"""Cells along the smaller of the two captures, from coarse to fine."""
WAYS = ((0.0, 2), (0.3, 2), (0.12, 2), (0.0, 0))
"""Ways to begin, each with the size of EM-ICP's cloud in spreads, 0 without it, and the first level."""
HOPELESS = {2: (0.35, -1.0), 3: (0.55, 0.4)}
"""Agreement, and that of colours, below which no finer level is tried after a level: much less than sure fits had there (docs/notes)."""
CLEAR = 0.85
"""Agreement from which on no other way is tried."""
STEPS = 30
"""The most steps of a level."""
SAMPLE = 4000
"""Cells of either surface that a step looks at."""
STILL = 2e-3
"""A level ends when a step moves everything by less, in cells."""
POINT = 0.02
"""Weight of the distance along a surface, by that across it: it keeps from sliding what nothing else holds."""
TURNED = 0.6
"""Cosine of the normals of two cells from which on they may be one surface."""
NEAR = 0.35
"""Distance across the surface, in finest cells, up to which two surfaces are one."""
UNLIKE = 1.0
"""Difference of colours, in their standard deviations, that makes a pair count little."""
LEAST_OVERLAP, LEAST_AGREEMENT, LEAST_COLOURED, LOOSE = 0.1, 0.72, 0.6, 0.02
"""Less is no sure fit: the share of the smaller surface that lies on the other; of what lies near the other, the share that lies on it; how
much of its colours the other's tell; how firmly the surfaces hold the weakest of all motions, by what holds the strongest."""
NOISE, QUALITY_NOISE = 0.02, 0.15
"""A fit that has no more than these shares less residual and more quality than no motion has moved by its own noise: so much they differ
between captures that lie on each other already."""
RIVAL = 0.85
"""Another fit that is so nearly as good makes both unsure."""


@dataclass(frozen=True, eq=False)
class Alignment(Similarity):
    """A fit of one capture to another: the motion of the world that it needs, and how sure it is.

    residual   root mean squared distance across the surfaces where they overlap, in the world's units
    overlap    share of the smaller capture's surface that lies on the other, 0..1
    agreement  of what lies near the other's surface, the share that lies on it, 0..1: a wrong fit crosses surfaces and has little

    Example:
        found = fg.align(fg.Instance(model, np.eye(4), 0.0), fg.Instance(model, np.eye(4), 0.0))
    """

    overlap: float
    agreement: float


def align(moving: Instance, fixed: Instance, *, scale: bool = False, search: bool = True,
          progress: Callable[[float], Any] | None = None) -> Alignment:
    """The motion of the world that lays one capture on another where both show the same surfaces, each at its instance's time.

    It is none, exactly, where no fit is better by more than its noise.

    scale     whether it may scale, too
    search    whether other places to begin from are tried where it does not fit from its own
    progress  called with 0..1 between pieces of work; what it raises stops the work and passes through

    Raises FastGSError where no fit is sure, and says why.

    Example:
        moved = np.eye(4)
        moved[:3, 3] = 0.05, 0.02, 0.0
        found = fg.align(fg.Instance(model, moved, 0.0), fg.Instance(model, np.eye(4), 0.0))
        print(found.matrix, found.residual, found.overlap)
    """
    progress = progress or (lambda share: None)
    a, b = skin(moving), skin(fixed)
    sizes = [_size(points) for points in (a, b)]
    fit = _Fit(a, b, scale, min(sizes) if not scale else sizes[1])
    progress(0.05)
    found = fit.refined(np.eye(4))
    progress(0.2 if search else 1.0)
    trouble = _doubt(found)
    if trouble and search:
        tried = [found]
        begins = starts(a, b, scale, lambda share: progress(0.2 + 0.3 * share))
        for k, start in enumerate(begins):
            tried.append(fit.refined(start, WAYS[2:3]))
            progress(0.5 + 0.5 * (k + 1) / len(begins))
        tried.sort(key=_quality, reverse=True)
        found, trouble = tried[0], _doubt(tried[0])
        rivals = [other for other in tried[1:] if _apart(found.matrix, other.matrix, a) > 0.08]
        if not trouble and rivals and _quality(rivals[0]) > RIVAL * _quality(found):
            trouble = "they fit in more than one way"
    if trouble:
        raise FastGSError(f"no sure fit was found: {trouble}. Pick three pairs of places instead, or move one nearly onto the other first.")
    still = fit.judged(np.eye(4))
    better = found.residual < (1 - NOISE) * still.residual or _quality(found) > (1 + QUALITY_NOISE) * _quality(still)
    return found if better or _doubt(still) else still


def _quality(found: _Found) -> float:
    """How good a fit is.  One that was given up comes after all others: coarse cells agree more easily."""
    return found.overlap * found.agreement**4 * max(found.coloured, 0.0) ** 2 * (1e-6 if found.coarse else 1)


def _doubt(found: _Found) -> str:
    """Why a fit is not sure; "": it is."""
    if found.overlap < LEAST_OVERLAP or found.agreement < LEAST_AGREEMENT:
        return (f"{found.overlap:.0%} of the surfaces lie on each other, and of those that come near each other "
                f"{found.agreement:.0%}")
    if found.coloured < LEAST_COLOURED:
        return f"the surfaces that lie on each other have other colours, which agree by {max(found.coloured, 0):.0%}"
    return "the surfaces slide on each other, like two floors" if found.firmness < LOOSE else ""


def _size(points: np.ndarray) -> float:
    """The diagonal of the box of points [P, 3] without their outer hundredths."""
    points = points[:, :3]
    return float(np.linalg.norm(np.percentile(points, 99, axis=0) - np.percentile(points, 1, axis=0)))


def _apart(one: np.ndarray, other: np.ndarray, points: np.ndarray) -> float:
    """How far two motions take points [P, 3] apart, by their size after the first."""
    some = points[:: max(len(points) // 200, 1)]
    a, b = moved(some, one), moved(some, other)
    return float(np.linalg.norm((a - b)[:, :3], axis=1).mean() / max(_size(a), 1e-30))


@dataclass(frozen=True, eq=False)
class _Found(Alignment):
    firmness: float
    coloured: float
    """How much of one surface's colours the other's tell where they lie on each other: R^2 of the best affine map; 1 if all are alike."""
    coarse: bool
    """Whether it was given up before the finest level."""


class _Fit:
    """Two surfaces, points [P, 3] and [Q, 3] in the world, of which the first moves."""

    def __init__(self, moving: np.ndarray, fixed: np.ndarray, scale: bool, size: float):
        self.moving, self.fixed, self.scale, self.size = moving, fixed, scale, size
        self.levels = [Cells.of(fixed, size / count) for count in LEVELS]

    def refined(self, start: np.ndarray, ways: tuple[tuple[float, int], ...] = WAYS) -> _Found:
        """The fit that is reached from a motion [4, 4]: the best one of several ways to begin."""
        found: list[_Found] = []
        for cloud, level in ways:
            motion = em_icp(start, self.moving, self.fixed, self.scale, cloud) if cloud else start
            for number in range(level, len(LEVELS)):
                motion = self._level(motion, self.levels[number]) @ motion
                if number in HOPELESS:
                    rough, (agreement, coloured) = self.judged(motion, number), HOPELESS[number]
                    if rough.agreement < agreement or rough.coloured < coloured:
                        found.append(rough)
                        break
            else:
                found.append(self.judged(motion))
            if found[-1].agreement > CLEAR and not _doubt(found[-1]):
                break
        return max(found, key=_quality)

    def _level(self, motion: np.ndarray, fixed: Cells) -> np.ndarray:
        """The motion that a level of cells adds."""
        moving = Cells.of(moved(self.moving, motion), fixed.edge)
        added = np.eye(4)
        for _ in range(STEPS):
            normal, at, off, weight = _pairs(moving, fixed, added, fixed.edge)
            if weight.sum() < 12:
                break
            step, _ = _solved(normal, at, off, weight, self.scale, fixed.edge)
            added = step @ added
            if np.linalg.norm(at @ (step[:3, :3] - np.eye(3)).T + step[:3, 3], axis=1).max() < STILL * fixed.edge:
                break
        return added

    def judged(self, motion: np.ndarray, level: int = -1) -> _Found:
        """A motion with how well it fits, in the cells of a level."""
        fine, coarse = self.levels[level], self.levels[level - 1]
        there = moved(self.moving, motion)
        moving = [Cells.of(there, cells.edge) for cells in (fine, coarse)]
        overlap, on, near, squares, count, colours = [], 0, 0, 0.0, 0, []
        for one, other, wide in ((moving[0], fine, coarse), (fine, moving[0], moving[1])):
            found, away = other.nearest(one.place)
            off = np.abs(((one.place - other.place[found]) * other.normal[found]).sum(1))
            alike = np.abs((one.normal * other.normal[found]).sum(1)) > TURNED
            lies = np.isfinite(away) & (off < NEAR * fine.edge) & (alike | (one.flat < 0.5) | (other.flat[found] < 0.5))
            colours.append((one.colour[lies], other.colour[found[lies]]))
            beside = np.isfinite(wide.nearest(one.place)[1])
            overlap.append(lies.mean())
            on, near, squares, count = on + (lies & beside).sum(), near + beside.sum(), squares + (off[lies] ** 2).sum(), count + lies.sum()
        pairs = _pairs(moving[0], fine, np.eye(4), fine.edge)
        firmness = _solved(*pairs, self.scale, fine.edge)[1] if pairs[3].sum() >= 12 else 0.0
        return _Found(motion, float(np.sqrt(squares / max(count, 1))), max(overlap), on / max(near, 1), firmness,
                      _colour_agreement(*colours[0]), level != -1)


def _colour_agreement(colours: np.ndarray, others: np.ndarray) -> float:
    """R^2 of the best affine map from colours [M, 3] to others."""
    if len(colours) < 30 or others.std(0).max() < 0.05:
        return 1.0 if len(colours) >= 30 else 0.0
    known = np.concatenate([colours, np.ones((len(colours), 1))], 1)
    left = others - known @ np.linalg.lstsq(known, others, rcond=None)[0]
    return float(1 - (left**2).sum() / max(((others - others.mean(0)) ** 2).sum(), 1e-30))


def _pairs(moving: Cells, fixed: Cells, motion: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cells of one surface with those nearest to them on the other, in both directions.

    Returns the normals [M, 3] across which they are apart, the moved places [M, 3], how far these are from the fixed ones [M, 3], and
    weights [M].
    """
    rows = [np.arange(0, len(cells.keys), max(len(cells.keys) // SAMPLE, 1)) for cells in (moving, fixed)]
    place = transformed(moving.place, motion)
    factor = np.cbrt(np.linalg.det(motion[:3, :3]))
    normals = moving.normal @ motion[:3, :3].T / factor
    there, _ = fixed.nearest(place[rows[0]])
    back = np.linalg.inv(motion)
    here, _ = moving.nearest(transformed(fixed.place[rows[1]], back))
    i, j = np.concatenate([rows[0], here]), np.concatenate([there, rows[1]])
    across = np.concatenate([fixed.normal[there], normals[here]])
    off = place[i] - fixed.place[j]
    side = (off * across).sum(1)
    away = np.linalg.norm(off, axis=1)
    alike = np.abs((normals[i] * fixed.normal[j]).sum(1))
    flat = np.minimum(moving.flat[i], fixed.flat[j])
    weight = np.maximum(1 - (away / (1.5 * reach)) ** 2, 0) ** 2 / (1 + (side / (0.25 * reach)) ** 2)
    weight = weight * np.exp(-((moving.colour[i] - fixed.colour[j]) ** 2).sum(1) / (2 * UNLIKE**2))
    return across, place[i], off, weight * np.where((alike > TURNED) | (flat < 0.5), 0.1 + flat, 0)


def _solved(normal: np.ndarray, at: np.ndarray, off: np.ndarray, weight: np.ndarray, scale: bool,
            edge: float) -> tuple[np.ndarray, float]:
    """The small motion [4, 4] that makes the squares of distances least, and how firmly the pairs hold the weakest motion."""
    middle = (weight[:, None] * at).sum(0) / weight.sum()
    x = at - middle
    reach = np.sqrt((weight[:, None] * x * x).sum() / weight.sum()) + 1e-12 * edge
    x = x / reach

    def rows(n: np.ndarray) -> np.ndarray:
        return np.concatenate([np.cross(x, n), n, (x * n).sum(1, keepdims=True)], 1)

    columns = 7 if scale else 6
    total, wanted, hold = np.zeros((7, 7)), np.zeros(7), np.zeros((7, 7))
    for n, share in ((normal, 1.0), *((np.broadcast_to(axis, normal.shape), POINT) for axis in np.eye(3))):
        jacobian = rows(n)
        product = (jacobian * weight[:, None]).T @ jacobian
        total += share * product
        hold += product if share == 1 else 0
        wanted -= share * (jacobian * weight[:, None]).T @ (off * n).sum(1)
    firm = np.linalg.eigvalsh(hold[:columns, :columns] / weight.sum())
    solved = np.zeros(7)
    solved[:columns] = np.linalg.solve(total[:columns, :columns] + 1e-9 * weight.sum() * np.eye(columns), wanted[:columns])
    solved /= reach  # turns in radians, the scale's logarithm; the move in reaches
    turn = np.exp(np.clip(solved[6], -0.2, 0.2)) * to_matrices(exp(np.clip(solved[:3], -0.5, 0.5) / 2))
    return transform(turn, middle + solved[3:6] * reach - turn @ middle), float(max(firm[0], 0) / max(firm[-1], 1e-30))
