# SPDX-License-Identifier: GPL-3.0-or-later
"""Crops one position inside kernels: by boxes, as crops.kept_by does for arrays, and by the ball that the backdrop surrounds."""
from __future__ import annotations

from .jit import inline


@inline
def is_kept(x, y, z, rows, remove):
    """rows [B, 3, 4] and remove [B] of crops.crop_arrays."""
    kept = len(remove) == 0 or remove[0]
    for b in range(len(remove)):
        inside = True
        for axis in range(3):
            inside = inside and abs(rows[b, axis, 0] * x + rows[b, axis, 1] * y + rows[b, axis, 2] * z + rows[b, axis, 3]) <= 1.0
        if inside:
            if remove[b]:
                return False
            kept = True
    return kept


@inline
def in_ball(position, n, ball):
    """Whether the constant position of Gaussian n lies in a ball (centre, squared radius); an infinite one holds everything."""
    dx, dy, dz = position[n, 0] - ball[0], position[n, 1] - ball[1], position[n, 2] - ball[2]
    return not (dx * dx + dy * dy + dz * dz > ball[3])
