# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view shows, front to back: the part of rendering that a viewport does on the CPU while the GPU draws.

With numba on all threads; without it in NumPy, with the same result.
"""
from __future__ import annotations

from contextlib import suppress

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from .crops import crop_arrays, kept_by
from .instances import LIMIT, ViewedInstance

CHUNK = 16_384
"""Gaussians in one piece of work."""


def order(instances: list[ViewedInstance], camera: Camera, limit: float = 1.0, ranks=None, numba: bool = True) -> np.ndarray:
    """Indices [V] int32 of the Gaussians that a camera shows, the nearest first, counted through all instances in their order.

    Left out is what cannot touch a pixel: by temporal opacity, before the near plane, off the picture, cropped.
    numba          whether to use it, where it is installed
    limit, ranks   ranks(model) gives [N] float32; Gaussians whose rank is not under the limit are left out as well (1: none is)
    """
    order_by, find = _order_by, _visible_numpy
    if numba:
        with suppress(ImportError):
            from ..kernels.cpu.parallel_sort import order_by

            find = _visible
    keys, index, done = [np.zeros(0, np.float32)], [np.zeros(0, np.int32)], 0
    for instance in instances:
        if len(instance.model) and instance.in_range:
            rank = ranks(instance.model) if limit < 1 else np.zeros(0, np.float32)
            for piece_keys, piece_index in find(instance, camera, done, (float(limit), rank)):
                keys.append(piece_keys)
                index.append(piece_index)
        done += len(instance.model)
    return order_by(np.concatenate(keys), np.concatenate(index))


def importance_rank(model: GaussianModel) -> np.ndarray:
    """[N] float32 from 0, the most important Gaussian, up to 1: by the area that it covers at most, times its opacity."""
    size = np.sort(model.scale, axis=1)
    weight = np.nan_to_num(size[:, 1] + size[:, 2] + np.log(sigmoid(model.opacity) + 1e-12), nan=-np.inf)
    rank = np.empty(len(model), np.float32)
    rank[np.argsort(-weight, kind="stable")] = np.arange(len(model)) / max(len(model), 1)
    return rank


def spread(camera: Camera) -> tuple[float, float]:
    """The most pixels, in x and in y, that a unit of standard deviation covers at depth 1 anywhere in the picture."""
    if camera.orthographic:
        return abs(camera.fx), abs(camera.fy)
    x_low, x_high, y_low, y_high = camera.tangent_limits()
    return (abs(camera.fx) * np.hypot(1, max(abs(x_low), abs(x_high))), abs(camera.fy) * np.hypot(1, max(abs(y_low), abs(y_high))))


def _scale_bound(matrix: np.ndarray) -> float:
    """By how much a placement makes things larger at most."""
    return float(np.linalg.norm(matrix, 2))


def _visible(instance: ViewedInstance, camera: Camera, offset: int, rank):
    from ..kernels.cpu.clouds import plain, weights_at
    from ..kernels.cpu.visible import visible
    from ..util.threads import ranges, run

    model, raster = instance.model, instance.model.raster
    to_camera = instance.model_to_camera
    view = np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3]])
    spread_x, spread_y = (s * _scale_bound(to_camera[:3, :3]) for s in spread(camera))
    lens = tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy, instance.near, camera.width, camera.height,
                                    spread_x, spread_y))
    depth, index = np.empty(len(model), np.float32), np.empty(len(model), np.int32)
    arrays = tuple(plain(a) for a in (model.position, model.scale, model.opacity, model.motion, model.mu_tau, model.temporal))
    common = (offset, arrays,
              (instance.t, model.temporal_kind.code, weights_at(model.basis, instance.t)), view, lens,
              (float(raster.blur), float(raster.alpha_cut), bool(camera.orthographic)),
              crop_arrays(instance.settings.crops), rank, depth, index)
    pieces = ranges(len(model), CHUNK)
    counts = run(lambda first, last: visible(first, last, *common), pieces)
    return [(depth[first:first + n], index[first:first + n]) for (first, _), n in zip(pieces, counts)]


def _visible_numpy(instance: ViewedInstance, camera: Camera, offset: int, rank):
    model, raster = instance.model, instance.model.raster
    with np.errstate(all="ignore"):
        sigma = sigmoid(model.opacity) * model.temporal_kind.factor(instance.t, model.mu_tau, model.temporal)
        kept = sigma >= raster.alpha_cut
        if len(rank[1]):
            kept &= rank[1] < rank[0]
        at = np.flatnonzero(kept)
        moved, _ = model.basis.evaluate(model.motion[at], instance.t, model.mu_tau[at])
        to_camera = instance.model_to_camera
        position = model.position[at] + moved
        p = position @ to_camera[:3, :3].T + to_camera[:3, 3]
        z = p[:, 2]
        per_depth = np.ones_like(z) if camera.orthographic else 1 / z
        centre = p[:, :2] * (camera.fx, camera.fy) * per_depth[:, None] + (camera.cx, camera.cy)
        size = np.exp(model.scale[at].max(1).astype(np.float64)) * per_depth * _scale_bound(to_camera[:3, :3])
        reach = 2 * np.log(sigma[at] / raster.alpha_cut)
        radius = np.sqrt(reach[:, None] * ((size[:, None] * spread(camera)) ** 2 + raster.blur))
        seen = (z > instance.near) & (z <= LIMIT) & kept_by(instance.settings.crops, position)
        seen &= ((centre + radius >= 0) & (centre - radius <= (camera.width, camera.height))).all(1)
    return [(z[seen].astype(np.float32), (offset + at[seen]).astype(np.int32))]


def _order_by(depth: np.ndarray, index: np.ndarray) -> np.ndarray:
    return index[np.argsort(depth, kind="stable")]
