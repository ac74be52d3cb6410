# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing: from a few Gaussians of a thing to all of it, by what lies together, moves together and looks alike.

It is a cut through the joins of neighbours (joins.py), each with a weight that is small where its two Gaussians drift apart or differ in
colour.  A minimal cut (Boykov and Jolly 2001) obeys every Gaussian of a stroke, those of the floor beside a foot too, and cuts off what
is long and thin.  So the squares of the differences are made least instead of their sizes: the random walker (Grady 2006), a potential
that strokes pull to 1 and -1 and everything else weakly to 0.  A few wrong Gaussians of a stroke are outvoted by those around them.
"""
from __future__ import annotations

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from .joins import joins

PULL, REST = 0.1, 0.06
"""How strongly a stroke's Gaussian is pulled, by a join's weight, and all Gaussians to 0, divided by the root of their number: a stroke
crosses about so many of a thing's."""
NEAREST = 0.3
"""Joins get no stronger below this distance, in units of the usual one."""
LOOSE = 1e-6
"""Least weight of a join."""
BORDER, ALONE = 0.3, 0.5
"""Potential from which on a Gaussian belongs to the thing; and where no stroke says what does not."""


def grow(model: GaussianModel, yes: np.ndarray, no: np.ndarray | None = None) -> np.ndarray:
    """Which Gaussians [N] bool belong to the thing that strokes went over, on all frames.

    yes  [N] bool, Gaussians of strokes over the thing, at any times and from any views (shapes.touched())
    no   [N] bool, of strokes over what does not belong to it; None: whatever is hardly joined to it does not

    Joins are kept while the model lives, so that further strokes take less time.  Raises FastGSError where `yes` is empty.
    """
    from ..kernels.cpu.walk import potential  # it brings numba, which enabling the add-on must not

    if not yes.any():
        raise FastGSError("nothing of the thing is marked yet; draw a stroke over it first.")
    pulled = yes.astype(np.float32) - (0 if no is None else no)
    found = joins(model)
    weight = np.exp(-found.differ) / np.maximum(found.near, NEAREST) ** 2 + LOOSE
    ground = PULL * np.abs(pulled) + REST / np.sqrt(len(model))
    y = potential(found.ends, weight.astype(np.float32), ground, PULL * pulled, model.position)
    return y > (BORDER if no is not None and no.any() else ALONE)


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
