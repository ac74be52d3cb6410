# SPDX-License-Identifier: GPL-3.0-or-later
"""How each Gaussian lies among its nearest neighbours: whether it is alone, and whether it has another colour than all of them."""
from dataclasses import dataclass

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at, positions_at
from ..rendering.filters import base_colours
from ..util.kept import kept
from .neighbours import nearest

TIMES = 9
"""Moments of the clip; a Gaussian is looked at where it is at that moment at which it is most opaque."""
COUNT = 8
"""Neighbours of a Gaussian."""


@dataclass(frozen=True, eq=False)
class Strays:
    """N Gaussians among their neighbours; float32.

    alone  [N]  distance to the nearest, divided by the usual one among them: about 1 in a surface
    tint   [N]  difference from the median colour of the neighbours (largest channel, 0..1), less how much these differ from it themselves
    """

    alone: np.ndarray
    tint: np.ndarray


@kept
@np.errstate(all="ignore")
def strays(model: GaussianModel) -> Strays:
    """How the Gaussians of a model lie among each other, kept while it lives."""
    n = len(model)
    if n <= COUNT:
        return Strays(np.ones(n, np.float32), np.zeros(n, np.float32))
    place, best = np.zeros((n, 3)), np.full(n, -1.0)
    for t in (np.arange(TIMES) + 0.5) / TIMES:
        sigma = opacities_at(model, t)
        at = np.flatnonzero(sigma > best)
        best[at], place[at] = sigma[at], positions_at(model, t, at)
    index, squared = nearest(np.nan_to_num(place), COUNT, trees=2)
    index = np.where(index < 0, np.arange(n)[:, None], index)
    away = np.sqrt(np.where(np.isfinite(squared), squared, 0)[:, :COUNT // 2].mean(1))
    usual = np.median(away[index], axis=1)
    colour = base_colours(model)
    around = colour[index]
    middle = np.median(around, axis=1)
    spread = np.median(np.abs(around - middle[:, None]).max(2), axis=1)
    tint = np.abs(colour - middle).max(1) - spread
    return Strays((away / np.maximum(usual, 1e-12)).astype(np.float32), np.nan_to_num(tint).astype(np.float32))
