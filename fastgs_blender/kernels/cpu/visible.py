# SPDX-License-Identifier: GPL-3.0-or-later
"""Culls and sorts the Gaussians that a camera sees, front to back, for viewports."""
from __future__ import annotations

import math

import numpy as np

from ...rendering.crops import crop_arrays
from ...rendering.culling import coarse_depths, heaviest, scale_bound, spread
from ...rendering.distance import MARGIN
from ...util.threads import portions, run
from .crop import crop_share, in_ball
from .jit import kernel
from .lanes import exp
from .look import FAINTEST, OPACITY, SIZED, size_factor
from .project import _moved3
from .sampling import PIXEL, coarsest
from .sort import order_by
from .splats import plain, weights_at
from .temporal import temporal_factor


@kernel
def visible(first, last, offset, look, arrays, times, view, lens, constants, boxes, depth, index, rows):
    """Cull the Gaussians first..last by temporal opacity, depth and window; write what is left from row `first` on.

    offset     added to the indices that are written
    look       [LOOK_NUMBERS] float64, see rendering/looks.py
    arrays     position, scale, opacity, motion, mu_tau, temporal of the model
    times      (t, temporal code, (terms, weights, centred) of the motion)
    view       [4, 3] float64: rows 0-2 model to camera, row 3 its translation
    lens       (fx, fy, cx, cy, near, far, right, bottom, spread x, spread y): the picture is 0..right, 0..bottom; the spreads bound
               the pixels that a unit of standard deviation covers at depth 1
    constants  (blur, alpha cut, orthographic, distance.Sampling.row)
    boxes      crops.crop_arrays of what crops the model; ViewedInstance.ball; which are hidden, [N] bool or [0]
    depth      float32, along the view axis; index int32
    rows       [0]; or float32 in place of the depth, for seen(), and then whoever looks
    Returns the number of rows written.
    """
    position, scale, opacity, motion, mu_tau, temporal = arrays
    t, temporal_code, (terms, weights, centred) = times
    crops, ball, hidden = boxes
    hides, filtered = len(crops[1]) > 0, len(hidden) > 0
    fx, fy, cx, cy, near, far, right, bottom, spread_x, spread_y = lens
    trained_blur, cut, orthographic, sampling = constants
    row0, row1, row2, shift = view[0], view[1], view[2], view[3]
    out = first
    for n in range(first, last):
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
        if len(rows) > 0:
            longest, shortest = max(scale[n, 0], scale[n, 1], scale[n, 2]), min(scale[n, 0], scale[n, 1], scale[n, 2])
            size, middle = exp(longest), exp(scale[n, 0] + scale[n, 1] + scale[n, 2] - longest - shortest)
            factor = 1.0 if look[SIZED] == 0.0 else size_factor(size, look)
            rows[out, 0], rows[out, 1], rows[out, 2], rows[out, 3] = px, py, pz, sigma
            rows[out, 4], rows[out, 5], rows[out, 6] = factor * size, factor * middle, math.sqrt(2.0 * math.log(sigma / cut))
            index[out] = n
            out += 1
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


@kernel
def seen(first, last, offset, rows, at, view, lens, constants, depth, index, weight):
    """The rest of visible() for its rows first..last; none is left out that the window shows, but for what close-ups blur.

    rows       position, opacity, the longest and the middle standard deviation, how many of these it reaches
    at         [M] int32: which Gaussians they are
    constants  (blur, orthographic, the most by which the view makes anything larger)
    weight     float32, how much they count in the picture: opacity times area in pixels, squared
    """
    fx, fy, cx, cy, near, far, right, bottom, spread_x, spread_y = lens
    blur, orthographic, stretch = constants
    row0, row1, row2, shift = view[0], view[1], view[2], view[3]
    focal, margin = abs(fx * fy) * stretch * stretch, math.sqrt(blur)
    out = first
    for n in range(first, last):
        px, py, pz = rows[n, 0], rows[n, 1], rows[n, 2]
        z = row2[0] * px + row2[1] * py + row2[2] * pz + shift[2]
        if not (z > near and z <= far):
            continue
        per_depth = 1.0 if orthographic else 1.0 / z
        mx = fx * (row0[0] * px + row0[1] * py + row0[2] * pz + shift[0]) * per_depth + cx
        my = fy * (row1[0] * px + row1[1] * py + row1[2] * pz + shift[1]) * per_depth + cy
        size, middle, reach = rows[n, 4] * per_depth, rows[n, 5] * per_depth, rows[n, 6]
        radius_x, radius_y = reach * (size * spread_x + margin), reach * (size * spread_y + margin)
        if not (mx + radius_x >= 0.0 and mx - radius_x <= right and my + radius_y >= 0.0 and my - radius_y <= bottom):
            continue
        depth[out] = z
        index[out] = offset + at[n]
        weight[out] = rows[n, 3] * rows[n, 3] * (size * size * focal + blur) * (middle * middle * focal + blur)
        out += 1
    return out - first


def front_to_back(instances, camera, share: float = 1.0, standing: dict | None = None) -> np.ndarray:
    """rendering.visibility.order() with numba, on all threads: indices [V] int32."""
    found, done, used = [(np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))], 0, set()
    standing = {} if standing is None else standing
    for instance in instances:
        if len(instance.model) and instance.in_range:
            if share < 1:
                key = instance.model, instance.origin, instance.t, instance.settings, instance.ball
                used.add(key)
                if key not in standing:
                    standing[key] = _stand(instance)
                found += _seen(instance, camera, done, standing[key])
            else:
                found += _visible(instance, camera, done)
        done += len(instance.model)
    depth, index, weight = (np.concatenate(each) for each in zip(*found))
    if share >= 1:
        return order_by(depth, index)
    for key in standing.keys() - used:
        del standing[key]
    kept = np.flatnonzero(heaviest(weight, index, share))
    return order_by(coarse_depths(depth[kept]).view(np.float32), index[kept])


def _visible(instance, camera, offset):
    """(depth [V] float32, index [V] int32, no weight) of each piece of an instance."""
    pieces = _culled(instance, camera, offset, np.empty(len(instance.model), np.float32), np.empty((0, 7), np.float32))
    return [(depth, index, rows[:, 0]) for depth, index, rows in pieces]


def _stand(instance):
    """(nothing, index [M] int32, rows [M, 7] float32, see seen()) of an instance."""
    pieces = _culled(instance, instance.camera, 0, np.empty(0, np.float32), np.empty((len(instance.model), 7), np.float32))
    return tuple(np.concatenate(each) for each in zip(*pieces))


def _culled(instance, camera, offset, depth, rows):
    model, (view, lens, _) = instance.model, _view(instance, camera)
    index = np.empty(len(model), np.int32)
    arrays = tuple(plain(a) for a in (model.position, model.scale, model.opacity, model.motion, model.mu_tau, model.temporal))
    rest = (offset, instance.look, arrays, (instance.t, model.temporal_kind.code, weights_at(model.basis, instance.t)), view, lens,
            (float(model.raster.blur), float(model.raster.alpha_cut), bool(camera.orthographic), instance.sampling.row),
            (crop_arrays(instance.settings.crops), instance.ball, instance.hidden), depth, index, rows)
    return _pieces(lambda first, last: visible(first, last, *rest), len(model), depth, index, rows)


def _seen(instance, camera, offset, standing):
    """(depth [V] float32, index [V] int32, weight [V] float32) of each piece of an instance that stands."""
    (_, at, rows), (view, lens, stretch) = standing, _view(instance, camera)
    out = np.empty(len(at), np.float32), np.empty(len(at), np.int32), np.empty(len(at), np.float32)
    rest = rows, at, view, lens, (float(instance.model.raster.blur), bool(camera.orthographic), stretch), *out
    return _pieces(lambda first, last: seen(first, last, offset, *rest), len(at), *out)


def _pieces(work, count, *arrays):
    """What work(first, last) has written into arrays, of each piece of `count`."""
    pieces = portions(count)
    return [tuple(each[first:first + n] for each in arrays) for (first, _), n in zip(pieces, run(work, pieces))]


def _view(instance, camera):
    """The view and the lens of visible(), and the most by which the view makes anything larger."""
    to_camera = instance.model_to_camera
    view, stretch = np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3]]), scale_bound(to_camera[:3, :3])
    lens = tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy, instance.near, instance.far, camera.width,
                                    camera.height, *(s * stretch for s in spread(camera))))
    return view, lens, stretch
