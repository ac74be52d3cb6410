# SPDX-License-Identifier: GPL-3.0-or-later
"""Crops one position inside kernels: by shapes, as crops.crop_share does for arrays, and by the ball that the backdrop surrounds."""
from __future__ import annotations

import math

from ...rendering.crops import SPHERE, VOLUME
from .jit import inline
from .lanes import three


@inline
def crop_share(x, y, z, crops):
    """What the shapes leave of the opacity; crops: what crops.crop_arrays returns."""
    rows, remove, kinds, soft, volumes = crops
    share = 1.0 if len(remove) == 0 or remove[0] else 0.0
    for b in range(len(remove)):
        u = rows[b, 0, 0] * x + rows[b, 0, 1] * y + rows[b, 0, 2] * z + rows[b, 0, 3]
        v = rows[b, 1, 0] * x + rows[b, 1, 1] * y + rows[b, 1, 2] * z + rows[b, 1, 3]
        w = rows[b, 2, 0] * x + rows[b, 2, 1] * y + rows[b, 2, 2] * z + rows[b, 2, 3]
        if kinds[b] >= VOLUME:
            depth = _depth(volumes, kinds[b] - VOLUME, u, v, w)
        elif kinds[b] == SPHERE:
            depth = 1.0 - math.sqrt(u * u + v * v + w * w)
        elif abs(u) <= 1.0 and abs(v) <= 1.0 and abs(w) <= 1.0:
            depth = 1.0 - max(abs(u), abs(v), abs(w))
        else:
            depth = -1.0
        if not (depth >= 0.0):
            continue
        inside = 1.0
        if depth < soft[b]:
            s = depth / soft[b]
            inside = s * s * (3.0 - 2.0 * s)
        if remove[b]:
            share *= 1.0 - inside
            if share <= 0.0:
                return 0.0
        else:
            share = max(share, inside)
    return share


@inline
def _depth(volumes, number, u, v, w):
    """volumes.Volume.depth_at."""
    if not (abs(u) <= 1.0 and abs(v) <= 1.0 and abs(w) <= 1.0):
        return -1.0
    last = volumes.shape[1] - 1
    x, y, z = (u + 1.0) * 0.5 * last, (v + 1.0) * 0.5 * last, (w + 1.0) * 0.5 * last
    i, j, k = min(int(x), last - 1), min(int(y), last - 1), min(int(z), last - 1)
    x, y, z = x - i, y - j, z - k
    depth = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
                depth += weight * volumes[number, i + a, j + b, k + c]
    return depth


@inline
def in_ball(position, n, ball):
    """Whether the constant position of Gaussian n lies in a ball (centre, squared radius); an infinite one holds everything."""
    dx, dy, dz = three(position, n)
    dx, dy, dz = dx - ball[0], dy - ball[1], dz - ball[2]
    return dx * dx + dy * dy + dz * dz <= ball[3]
