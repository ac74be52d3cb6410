# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians a view shows at a time, and how far away they are: what a viewport sorts before every frame."""
from __future__ import annotations

import math

import numpy as np

from ...rendering.instances import LIMIT
from .crop import is_kept
from .jit import kernel
from .project import _exp, _moved3, _temporal_factor


@kernel
def visible(first, last, offset, arrays, times, view, lens, constants, boxes, rank, depth, index):
    """Cull the Gaussians first..last by temporal opacity, depth, window and rank; write what is left from row `first` on.

    offset     added to the indices that are written
    arrays     position, scale, opacity, motion, mu_tau, temporal of the model
    times      (t, temporal code, (terms, weights, centred) of the motion)
    view       [4, 3] float64: rows 0-2 model to camera, row 3 its translation
    lens       (fx, fy, cx, cy, near, right, bottom, spread x, spread y): the picture is 0..right, 0..bottom; the spreads bound
               the pixels that a unit of standard deviation covers at depth 1
    constants  (blur, alpha cut, orthographic)
    boxes      (rows, remove) of the boxes that crop the model, see crops.crop_arrays
    rank       [N] float32, or [0]; (limit, rank): Gaussians whose rank is not under the limit are left out
    depth      float32, along the view axis; index int32
    Returns the number of rows written.
    """
    position, scale, opacity, motion, mu_tau, temporal = arrays
    t, temporal_code, (terms, weights, centred) = times
    fx, fy, cx, cy, near, right, bottom, spread_x, spread_y = lens
    blur, cut, orthographic = constants
    limit, ranks = rank
    rows, remove = boxes
    row0, row1, row2, shift = view[0], view[1], view[2], view[3]
    out = first
    for n in range(first, last):
        if len(ranks) > 0 and not (ranks[n] < limit):
            continue
        sigma = _temporal_factor(temporal_code, t, np.float64(mu_tau[n]), temporal, n) / (1.0 + _exp(-opacity[n]))
        if not (sigma >= cut):
            continue
        px, py, pz = _moved3(motion, n, terms, weights, centred, t - np.float64(mu_tau[n]))
        px, py, pz = px + position[n, 0], py + position[n, 1], pz + position[n, 2]
        if not is_kept(px, py, pz, rows, remove):
            continue
        z = row2[0] * px + row2[1] * py + row2[2] * pz + shift[2]
        if not (z > near and z <= LIMIT):
            continue
        x = row0[0] * px + row0[1] * py + row0[2] * pz + shift[0]
        y = row1[0] * px + row1[1] * py + row1[2] * pz + shift[1]
        per_depth = 1.0 if orthographic else 1.0 / z
        mx, my = fx * x * per_depth + cx, fy * y * per_depth + cy
        size = _exp(max(scale[n, 0], scale[n, 1], scale[n, 2])) * per_depth
        reach = math.sqrt(2.0 * math.log(sigma / cut))
        radius_x = reach * math.sqrt(size * size * spread_x * spread_x + blur)
        radius_y = reach * math.sqrt(size * size * spread_y * spread_y + blur)
        if not (mx + radius_x >= 0.0 and mx - radius_x <= right and my + radius_y >= 0.0 and my - radius_y <= bottom):
            continue
        depth[out] = z
        index[out] = offset + n
        out += 1
    return out - first


@kernel
def histogram(keys, low, shift, mask, counts):
    """Count into counts how often each digit (key - low >> shift & mask) occurs."""
    for i in range(len(keys)):
        counts[np.intp((keys[i] - low) >> shift & mask)] += 1


@kernel
def scatter(keys, order, low, shift, mask, begins, keys_out, order_out):
    """One pass of a radix sort; begins holds where each digit's next key goes."""
    for i in range(len(keys)):
        key = keys[i]
        digit = np.intp((key - low) >> shift & mask)
        at = begins[digit]
        begins[digit] = at + 1
        keys_out[at] = key
        order_out[at] = order[i]
