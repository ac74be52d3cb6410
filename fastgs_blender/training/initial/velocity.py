# SPDX-License-Identifier: GPL-3.0-or-later
"""Velocities of points that belong to a moment, from where their surroundings are at the moments before and after.

Clouds of points are registered without a rigid shape: each point takes the nearest one of its colour in the other cloud, and goes where
most of its neighbours go; repeated, with fewer neighbours later.  As FreeTimeGS (Wang et al. 2025), training begins with points that move.
"""
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...model.motion import Basis
from ...model.points import Points
from .neighbours import neighbour_distance

ROUNDS = ((96, 64), (96, 64), (96, 64), (48, 32), (48, 32), (24, 16), (24, 16), (12, 8), (12, 8))
"""Points that go together, and what a colour's whole range (0..1) counts as, in distances of neighbours: at first, when the other cloud's
points are still far away, colours tell most."""
COMPANY = max(company for company, _ in ROUNDS)
MOST = 2000
"""Points of a cloud that are registered; others go with the nearest of them."""
ROWS = 64
"""Points whose distances to all others are held at once, in a processor's cache."""


def in_motion(clouds: list[Points], k: int, seen: Callable[[Points, int], np.ndarray]) -> Points:
    """The k-th of some clouds, each of one moment, in the order of time, with velocities per unit of time, 0 where none is found.

    A velocity is that of the straight line through the point that is nearest to its places at the moments before and after.
    seen(cloud, k): which of the points [P] are where the pictures of the k-th moment show something of their colours
    """
    cloud = clouds[k]
    along, square = np.zeros((len(cloud), 3)), np.zeros((len(cloud), 1))
    for other in (k - 1, k + 1):
        if not 0 <= other < len(clouds) or min(len(cloud), len(clouds[other])) < COMPANY:
            continue
        step, now, then = displacements(cloud, clouds[other]), cloud.t, clouds[other].t
        assert now is not None and then is not None
        found = seen(replace(cloud, xyz=cloud.xyz + step), other)[:, None]
        apart = float(then[0] - now[0])
        along += np.where(found, step * apart, 0)
        square += np.where(found, apart**2, 0)
    return replace(cloud, velocity=along / np.maximum(square, 1e-12))


def displacements(cloud: Points, other: Points) -> np.ndarray:
    """Where the points [P, 3] of a cloud have gone in another one, as steps; both have at least as many as go together at first."""
    some, there = (each.take(np.unique(np.linspace(0, len(each) - 1, MOST).astype(int))) for each in (cloud, other))
    unit = max(float(np.median(neighbour_distance(some.xyz))), 1e-12)
    xyz, goal = some.xyz / unit, there.xyz / unit
    beside = _nearest(xyz, xyz, COMPANY)
    step = np.zeros_like(xyz)
    for company, colour in ROUNDS:
        found = _nearest(np.concatenate([xyz + step, colour * some.rgb], 1), np.concatenate([goal, colour * there.rgb], 1), 1)[:, 0]
        step = np.median((goal[found] - xyz).T[:, beside[:, :company]], axis=2).T
    return step[_nearest(cloud.xyz / unit, xyz, 1)[:, 0]] * unit


def _nearest(wanted: np.ndarray, known: np.ndarray, count: int) -> np.ndarray:
    """Indices [n, count] of the rows of known [m, D] that are nearest to those of wanted [n, D], the nearest first."""
    found, middle = np.empty((len(wanted), count), np.int64), known.mean(0)
    # |known|^2 - 2 wanted . known as one product, around the middle, so that float32 is enough
    wanted, known = (np.asarray(values - middle, np.float32) for values in (wanted, known))
    left = np.column_stack([wanted, np.ones(len(wanted), np.float32)])
    right = np.column_stack([-2 * known, np.square(known).sum(1)]).T.copy()
    for first in range(0, len(left), ROWS):
        rows = slice(first, first + ROWS)
        away = left[rows] @ right
        some = np.argpartition(away, count - 1, axis=1)[:, :count] if count > 1 else away.argmin(1)[:, None]
        found[rows] = np.take_along_axis(some, np.take_along_axis(away, some, 1).argsort(1), 1) if count > 1 else some
    return found


def straight(basis: Basis, moment: float, life: float, last: float) -> np.ndarray:
    """Coefficients [K] of the calmest motion that passes at a moment, and for a life around it, nearly through 0 with speed 1.

    last: the time of the clip's last frame, beyond which nothing is asked of it
    """
    times = moment + life * np.array([-1, -0.5, 0.5, 1])
    times = times[(times >= -1e-6) & (times <= last + 1e-6)]
    zero = moment if basis.centred else 0.0
    rows = basis.weights(times - zero) - basis.weights(moment - zero)
    bends = np.square(basis.curvature()).sum(0)
    calm = 1 / np.sqrt(np.maximum(bends, 1e-3 * bends.max(initial=1e-9)))
    gram = rows * calm @ rows.T
    return calm * (rows.T @ np.linalg.solve(gram + 1e-3 * np.trace(gram) / max(len(gram), 1) * np.eye(len(gram)), times - moment))
