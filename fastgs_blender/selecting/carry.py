# SPDX-License-Identifier: GPL-3.0-or-later
"""Carries a selection over to the model of a file that was written anew, by place and colour."""
from __future__ import annotations

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import positions_at
from ..rendering.filters import base_colours
from ..util.errors import FastGSError
from .neighbours import nearest

TIMES = 0.1, 0.5, 0.9
COUNT = 12
"""Neighbours, of both models together, that are asked."""
AGREED, FAR, ENOUGH = 0.8, 4.0, 0.9
"""It is sure of a Gaussian if this share of its old neighbours agree, and the nearest is within so many usual distances; and of a selection
if it is sure of this share of the Gaussians that may belong to it."""


def carried(old: GaussianModel, new: GaussianModel, bits: np.ndarray) -> tuple[np.ndarray, float]:
    """(which Gaussians [M] of the new model belong to a selection bits [N] of the old one, for what share of them that is sure).

    A Gaussian belongs where most of its old neighbours do, in place at three moments and in colour.  The same Gaussians keep their bits.
    Raises FastGSError where less than ENOUGH is sure.
    """
    if len(old) == len(new) and np.array_equal(old.position, new.position):
        return bits.copy(), 1.0
    if not bits.any() or not len(new):
        return np.zeros(len(new), bool), 1.0
    at = [np.concatenate([positions_at(model, t) for t in TIMES], 1) for model in (old, new)]
    unit = float(np.median(np.sqrt(nearest(at[0], 4)[1][:, -1])))
    points = np.concatenate([np.concatenate([place / unit, 10 * base_colours(model)], 1) for place, model in zip(at, (old, new))])
    index, squared = (found[len(old):] for found in nearest(points, COUNT))
    known = (index >= 0) & (index < len(old))
    votes = (known & bits[np.where(known, index, 0)]).sum(1) / np.maximum(known.sum(1), 1)
    close = np.where(known, squared, np.inf).min(1) <= FAR**2 * points.shape[1] / 3
    mine, sure = votes > 0.5, close & (np.abs(votes - 0.5) >= AGREED - 0.5)
    asked = mine | (votes > 1 - AGREED)
    share = float(np.mean(sure[asked])) if asked.any() else 0.0
    if share < ENOUGH:
        raise FastGSError(f"the new file's Gaussians differ too much: of the selection only {100 * share:.0f} % is found again for sure; "
                          "select it anew.")
    return mine & close, share
