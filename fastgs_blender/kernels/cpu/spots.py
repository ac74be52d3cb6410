# SPDX-License-Identifier: GPL-3.0-or-later
"""How thick Gaussians are towards a lamp, and places all over them (rendering/spots.py)."""
from __future__ import annotations

import math

import numpy as np

from ...rendering.spots import LEAST
from ...util.threads import portions, run
from .. import asserts
from .jit import kernel


def spread(position: np.ndarray, axes: np.ndarray, place: np.ndarray, parallel: bool, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """PictureBackend.spread()."""
    asserts.spread(position, axes, place, within)
    count = position.shape[1]
    thickness, places = np.empty(count), np.empty((3, len(within), count))
    rest = np.ascontiguousarray(position), np.ascontiguousarray(axes), tuple(place.tolist()), bool(parallel), within, thickness, places
    run(lambda first, last: _spread(first, last, *rest), portions(count))
    return thickness, places


@kernel
def _spread(first, last, position, axes, place, parallel, within, thickness, places):
    """spread() of the Gaussians first..last."""
    for p in range(first, last):
        x, y, z = position[0, p], position[1, p], position[2, p]
        tx, ty, tz = place
        if not parallel:
            tx, ty, tz = tx - x, ty - y, tz - z
        ax, ay, az = axes[0, 0, p], axes[1, 0, p], axes[2, 0, p]
        bx, by, bz = axes[0, 1, p], axes[1, 1, p], axes[2, 1, p]
        cx, cy, cz = axes[0, 2, p], axes[1, 2, p], axes[2, 2, p]
        a, b, c = max(ax * ax + ay * ay + az * az, LEAST), max(bx * bx + by * by + bz * bz, LEAST), max(cx * cx + cy * cy + cz * cz, LEAST)
        u, v, w = (tx * ax + ty * ay + tz * az) / a, (tx * bx + ty * by + tz * bz) / b, (tx * cx + ty * cy + tz * cz) / c
        thickness[p] = math.sqrt((tx * tx + ty * ty + tz * tz) / max(u * u + v * v + w * w, LEAST))
        # the shortest axis is left out; of those as long the first, as NumPy sorts them
        if b < a:
            ax, ay, az, bx, by, bz, a, b = bx, by, bz, ax, ay, az, b, a
        if c < a:
            bx, by, bz, cx, cy, cz = ax, ay, az, bx, by, bz
        elif c < b:
            bx, by, bz, cx, cy, cz = cx, cy, cz, bx, by, bz
        for s in range(len(within)):
            places[0, s, p] = x + within[s, 0] * bx + within[s, 1] * cx
            places[1, s, p] = y + within[s, 0] * by + within[s, 1] * cy
            places[2, s, p] = z + within[s, 0] * bz + within[s, 1] * cz
