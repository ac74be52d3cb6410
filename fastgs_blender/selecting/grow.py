# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing: from a few Gaussians of a thing to all of it, by what lies together, moves together and looks alike.

It is a cut through the joins of neighbours (joins.py), each with a weight that is small where its two Gaussians drift apart or differ in
colour.  A minimal cut (Boykov and Jolly 2001) obeys every Gaussian of a stroke, those of the floor beside a foot too, and cuts off what
is long and thin.  So the squares of the differences are made least instead of their sizes: the random walker (Grady 2006), a potential
that strokes pull to 1 and -1 and everything else weakly to 0.  Gaussians of a stroke whose neighbours say otherwise are then pulled less,
and the potential is found again: in a trained model a stroke always touches some of the haze and of what lies behind.
"""
from __future__ import annotations

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from .joins import joins

PULL = 0.3
"""How strongly a Gaussian of a stroke is pulled, by the sum of the weights that meet in it."""
REST, BORDER = 2.5e-4, 0.2
"""How strongly each Gaussian is pulled to 0, by the same sum; and the share of the strokes' mean potential from which on a Gaussian belongs
to the thing."""
REST_ALONE, BORDER_ALONE = 1e-3, 0.5
"""The same where no stroke says what does not belong to the thing."""
MANY = 20_000
"""With more Gaussians joins are shorter. To reach as far, pulls are weaker there, by the power 1.5 of their number (measured)."""
FEW = 40
"""A stroke over fewer Gaussians, as a click, has less to hold up: each Gaussian is pulled to 0 by so much less."""
LEAST = 0.02
"""What is left at least of the pull of a stroke's Gaussian whose neighbours say otherwise."""
NEAREST = 0.3
"""Joins get no stronger below this distance, in units of the usual one."""
LOOSE = 1e-6
"""Least weight of a join."""


def grow(model: GaussianModel, yes: np.ndarray, no: np.ndarray | None = None) -> np.ndarray:
    """Which Gaussians [N] bool belong to the thing that strokes went over, on all frames.

    yes  [N] bool, Gaussians of strokes over the thing, at any times and from any views (shapes.touched())
    no   [N] bool, of strokes over what does not belong to it; None: whatever is hardly joined to it does not

    Joins are kept while the model lives, so that further strokes take less time.  Raises FastGSError where `yes` is empty.
    """
    from ..kernels.cpu.walk import potential  # it brings numba, which enabling the add-on must not

    if not yes.any():
        raise FastGSError("nothing of the thing is marked yet; draw a stroke over it first.")
    rest, border = (REST, BORDER) if no is not None and no.any() else (REST_ALONE, BORDER_ALONE)
    side = yes.astype(np.float32) - (0 if no is None else no)
    found = joins(model)
    i, j = found.ends.T
    weight = (np.exp(-found.differ) / np.maximum(found.near, NEAREST) ** 2 + LOOSE).astype(np.float32)
    degree = np.bincount(i, weight, len(model)) + np.bincount(j, weight, len(model)) + LOOSE
    pulled = degree * min(MANY / len(model), 1) ** 1.5
    pull, rest = PULL * pulled * np.abs(side), rest * pulled * min(int(yes.sum()) / FEW, 1)
    y = potential(found.ends, weight, pull + rest, pull * side, model.position)
    around = (np.bincount(i, weight * y[j], len(model)) + np.bincount(j, weight * y[i], len(model))) / degree
    pull *= np.maximum(np.clip(0.5 + 0.5 * side * around, 0, 1) ** 2, LEAST)
    y = potential(found.ends, weight, pull + rest, pull * side, model.position)
    return y > border * float(y[yes].mean())


def connected(model: GaussianModel, some: np.ndarray, reach: float = 3.0) -> np.ndarray:
    """Which Gaussians [N] bool lie together with some [N] bool: there is a way from one to the next, none of whose steps is longer than
    `reach` times the usual distance of neighbours, at any moment of the clip."""
    found = joins(model)
    i, j = found.ends[found.near <= reach].T
    out = some.copy()
    while len(i):
        edge = out[i] != out[j]
        if not edge.any():
            break
        out[i[edge]] = out[j[edge]] = True
        open_ = ~(out[i] & out[j])
        i, j = i[open_], j[open_]
    return out
