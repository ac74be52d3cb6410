# SPDX-License-Identifier: GPL-3.0-or-later
"""How the capture's cameras and a view sample a Gaussian (rendering/distance.py)."""
from __future__ import annotations

import math

from ...rendering.distance import BOX, MARGIN, STEEP
from .jit import inline
from .lanes import anywhere

PIXEL = 4
"""Place of a view's pixel size in distance.Sampling.row."""


@inline
def coarsest(px, py, pz, row):
    """distance.Sampling.coarsest() of one Gaussian; row: Sampling.row."""
    cx, cy, cz, radius, _, coarse, least, _, _, _ = row
    x, y, z = px - cx, py - cy, pz - cz
    return max(least, coarse * (radius + math.sqrt(x * x + y * y + z * z)))


@inline
def blurs(px, py, pz, depth, largest, blur, sampling):
    """distance.Sampling.blurs() of one Gaussian."""
    row, cameras = sampling
    _, _, _, _, pixel, _, least, reach, fades, zoom = row
    size, found = pixel * depth, coarsest(px, py, pz, row)
    here = max(min(found, zoom * size), least)
    for i in range(len(cameras)):
        if not anywhere(found > here):
            break
        x, y, z = px - cameras[i, 0], py - cameras[i, 1], pz - cameras[i, 2]
        along = x * cameras[i, 4] + y * cameras[i, 5] + z * cameras[i, 6]
        if not anywhere(abs(along) * cameras[i, 3] < found):
            continue
        r = math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
        outside = max((r - reach * largest) * cameras[i, 7] - along, 0.0)
        found = min(found, (abs(along) + STEEP * outside) * cameras[i, 3])
    ratio = max(found, here) / size
    finer, shrunk = max(ratio / MARGIN, 1.0), min(ratio * MARGIN, 1.0) if fades > 0.0 else 1.0
    shrunk *= shrunk
    small = blur * finer * finer * shrunk
    return small + min(BOX, blur) * (1.0 - shrunk), small


@inline
def far_squared(px, py, pz, row):
    """At least the square of coarsest() / MARGIN, without a root."""
    cx, cy, cz, radius, _, coarse, least, _, _, _ = row
    x, y, z = px - cx, py - cy, pz - cz
    return max(least * least, 2.0 * coarse * coarse * (radius * radius + x * x + y * y + z * z))
