# SPDX-License-Identifier: GPL-3.0-or-later
"""Culls and sorts the Gaussians that a camera sees, front to back, for viewports."""
from __future__ import annotations

import math

import numpy as np

from ...rendering.crops import crop_arrays
from ...rendering.culling import scale_bound, spread
from ...rendering.distance import MARGIN
from ...util.threads import ranges, run
from .crop import crop_share, in_ball
from .jit import exp, kernel
from .look import FAINTEST, OPACITY, SIZED, size_factor
from .project import PIXEL, _moved3, coarsest
from .sort import order_by
from .splats import CHUNK, plain, weights_at
from .temporal import temporal_factor


@kernel
def visible(first, last, offset, look, arrays, times, view, lens, constants, boxes, rank, depth, index):
    """Cull the Gaussians first..last by temporal opacity, depth, window and rank; write what is left from row `first` on.

    offset     added to the indices that are written
    look       [LOOK_NUMBERS] float64, see rendering/looks.py
    arrays     position, scale, opacity, motion, mu_tau, temporal of the model
    times      (t, temporal code, (terms, weights, centred) of the motion)
    view       [4, 3] float64: rows 0-2 model to camera, row 3 its translation
    lens       (fx, fy, cx, cy, near, far, right, bottom, spread x, spread y): the picture is 0..right, 0..bottom; the spreads bound
               the pixels that a unit of standard deviation covers at depth 1
    constants  (blur, alpha cut, orthographic, distance.Sampling.row)
    boxes      crops.crop_arrays of what crops the model; ViewedInstance.ball; which are hidden, [N] bool or [0]
    rank       [N] float32, or [0]; (limit, rank): Gaussians whose rank is not under the limit are left out
    depth      float32, along the view axis; index int32
    Returns the number of rows written.
    """
    position, scale, opacity, motion, mu_tau, temporal = arrays
    t, temporal_code, (terms, weights, centred) = times
    fx, fy, cx, cy, near, far, right, bottom, spread_x, spread_y = lens
    trained_blur, cut, orthographic, sampling = constants
    limit, ranks = rank
    crops, ball, hidden = boxes
    hides, filtered = len(crops[1]) > 0, len(hidden) > 0
    row0, row1, row2, shift = view[0], view[1], view[2], view[3]
    out = first
    for n in range(first, last):
        if len(ranks) > 0 and not (ranks[n] < limit):
            continue
        if (filtered and hidden[n]) or not in_ball(position, n, ball):
            continue
        faintness = 1.0 + exp(-opacity[n])
        if faintness > look[FAINTEST]:
            continue
        sigma = temporal_factor(temporal_code, t, np.float64(mu_tau[n]), temporal, n) / faintness * look[OPACITY]
        if not (sigma >= cut):
            continue
        px, py, pz = _moved3(motion, n, terms, weights, centred, t - np.float64(mu_tau[n]))
        px, py, pz = px + position[n, 0], py + position[n, 1], pz + position[n, 2]
        if hides:
            sigma *= crop_share(px, py, pz, crops)
            if not (sigma >= cut):
                continue
        z = row2[0] * px + row2[1] * py + row2[2] * pz + shift[2]
        if not (z > near and z <= far):
            continue
        x = row0[0] * px + row0[1] * py + row0[2] * pz + shift[0]
        y = row1[0] * px + row1[1] * py + row1[2] * pz + shift[1]
        per_depth = 1.0 if orthographic else 1.0 / z
        mx, my = fx * x * per_depth + cx, fy * y * per_depth + cy
        size = exp(max(scale[n, 0], scale[n, 1], scale[n, 2]))
        if look[SIZED] != 0.0:
            size *= size_factor(size, look)
        size *= per_depth
        blur = trained_blur
        if sampling[PIXEL] > 0.0:
            blur *= max(coarsest(px, py, pz, sampling) / (MARGIN * sampling[PIXEL] * (1.0 if orthographic else z)), 1.0) ** 2
        reach = math.sqrt(2.0 * math.log(sigma / cut))
        radius_x = reach * math.sqrt(size * size * spread_x * spread_x + blur)
        radius_y = reach * math.sqrt(size * size * spread_y * spread_y + blur)
        if not (mx + radius_x >= 0.0 and mx - radius_x <= right and my + radius_y >= 0.0 and my - radius_y <= bottom):
            continue
        depth[out] = z
        index[out] = offset + n
        out += 1
    return out - first


def front_to_back(instances, camera, limit: float = 1.0, ranks=None) -> np.ndarray:
    """rendering.visibility.order() with numba, on all threads: indices [V] int32."""
    keys, index, done = [np.zeros(0, np.float32)], [np.zeros(0, np.int32)], 0
    for instance in instances:
        if len(instance.model) and instance.in_range:
            rank = ranks(instance.model) if limit < 1 else np.zeros(0, np.float32)
            for piece_keys, piece_index in _visible(instance, camera, done, (float(limit), rank)):
                keys.append(piece_keys)
                index.append(piece_index)
        done += len(instance.model)
    return order_by(np.concatenate(keys), np.concatenate(index))


def _visible(instance, camera, offset, rank):
    """(depth [V] float32, index [V] int32) of each piece of an instance."""
    model, raster = instance.model, instance.model.raster
    to_camera = instance.model_to_camera
    view = np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3]])
    spread_x, spread_y = (s * scale_bound(to_camera[:3, :3]) for s in spread(camera))
    lens = tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy, instance.near, instance.far, camera.width,
                                    camera.height, spread_x, spread_y))
    depth, index = np.empty(len(model), np.float32), np.empty(len(model), np.int32)
    arrays = tuple(plain(a) for a in (model.position, model.scale, model.opacity, model.motion, model.mu_tau, model.temporal))
    common = (offset, instance.look, arrays, (instance.t, model.temporal_kind.code, weights_at(model.basis, instance.t)), view, lens,
              (float(raster.blur), float(raster.alpha_cut), bool(camera.orthographic), instance.sampling.row),
              (crop_arrays(instance.settings.crops), instance.ball, instance.hidden), rank, depth, index)
    pieces = ranges(len(model), CHUNK)
    counts = run(lambda first, last: visible(first, last, *common), pieces)
    return [(depth[first:first + n], index[first:first + n]) for (first, _), n in zip(pieces, counts)]
