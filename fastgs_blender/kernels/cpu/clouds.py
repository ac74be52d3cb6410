# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds: the splats of models at one time before one camera, on the CPU; forward and backward."""
from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import RGB, SH, Features
from ...rendering.crops import crop_arrays
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Layout
from ...util.threads import ranges, run
from . import project, raster
from .project_backward import project_backward as project_rows_backward
from .sort import order_by

if TYPE_CHECKING:
    from .backend import RasterGradients

CODES = {RGB: project.RGB, SH: project.SH, Features: project.FEATURES}
CHUNK = 16_384
"""Gaussians in one piece of work."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The splats of all parts in arrays with a row for every Gaussian, of which only some are written.

    geometry, shade  see raster.py
    depth   [rows] float32, along the view axis
    source  [rows] int32: which Gaussian of its part each row is
    runs    for each part, the first row and the number of rows written for each piece of it
    index   [V] int32: the rows written
    """

    geometry: np.ndarray
    shade: np.ndarray
    depth: np.ndarray
    source: np.ndarray
    runs: list[list[tuple[int, int]]]
    index: np.ndarray

    @property
    def channels(self) -> int:
        """The number of channels, padded to one that the rasteriser has a kernel for."""
        return self.shade.shape[1] - raster.CHANNEL

    def order(self) -> np.ndarray:
        """The rows written [V] int32, front to back."""
        return order_by(self.depth[self.index], self.index)


def project_parts(parts: list[ViewedInstance], camera: Camera, layout: Layout, progress=None) -> Cloud:
    """Slice, cull and project all parts."""
    total = sum(len(part.model) for part in parts)
    shade = np.empty((total, raster.CHANNEL + raster.padded(layout.channels)), np.float32)
    arrays = np.empty((total, 5)), shade, np.empty(total, np.float32), np.empty(total, np.int32)
    runs, done = [], 0
    for part in parts:
        count, inputs = len(part.model), (crop_arrays(part.settings.crops), *_inputs(part, camera, layout))
        rows = tuple(array[done:done + count] for array in arrays)
        pieces = ranges(count, CHUNK)
        share = progress and (lambda f, done=done, count=count: progress((done + f * count) / total))
        counts = run(lambda first, last, rest=(*inputs, *rows): project.project(first, last, *rest), pieces, share)
        runs.append([(done + first, number) for (first, _), number in zip(pieces, counts)])
        done += count
    index = [np.arange(first, first + number, dtype=np.int32) for part in runs for first, number in part]
    return Cloud(*arrays, runs, np.concatenate(index) if index else np.empty(0, np.int32))


def project_backward(part: ViewedInstance, camera: Camera, layout: Layout, cloud: Cloud, gradients: RasterGradients,
                     detach_time: bool = False) -> dict[str, np.ndarray]:
    """d loss / d the model's arrays by name, of the cloud of this part alone, from d loss / d splats.

    detach_time: mu_tau's gradient comes through the temporal opacity alone, as STG trains.
    """
    model = part.model
    out = {name: np.empty_like(array) for name, array in model.arrays.items()}
    slopes = (gradients.geometry, gradients.log2_opacity, gradients.channels)
    rest = (cloud.source, slopes, bool(detach_time), tuple(out.values()), *_inputs(part, camera, layout))
    pieces = ((first, min(first + CHUNK, len(model)), first, first + count) for first, count in cloud.runs[0])
    run(lambda *piece: project_rows_backward(*piece, *rest), pieces)
    return out


def _inputs(part: ViewedInstance, camera: Camera, layout: Layout):
    """arrays, times, view, lens, constants and look of a part, see project.project."""
    model, group = part.model, layout.group_of(part)
    to_camera, to_model = part.model_to_camera, part.camera_to_model
    x0, y0, width, height = camera.window
    view = np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3], to_model[None, :3, 2 if camera.orthographic else 3]])
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, part.near, *camera.tangent_limits(),
            x0 + 0.5, x0 + width - 0.5, y0 + 0.5, y0 + height - 0.5)
    r = model.raster
    return (
        tuple(plain(a) for a in model.arrays.values()),
        (part.t, model.temporal_kind.code, weights_at(model.basis, part.t), weights_at(model.rotation_basis, part.t)),
        np.ascontiguousarray(view), tuple(float(v) for v in lens),
        (float(r.blur), float(r.alpha_max), float(r.alpha_cut), bool(r.antialiased), bool(camera.orthographic)),
        (CODES[type(model.appearance)], getattr(model.appearance, "degree", 0), group.offset,
         -1 if group.weight is None else group.weight, -1 if layout.depth is None else layout.depth),
    )


def weights_at(basis, t):
    """(index, weights, centred) of a basis for the kernel: only the coefficients that count at time t."""
    if basis.centred:
        return np.empty(0, np.int64), np.empty(0), True
    weights = basis.weights(t)
    index = np.flatnonzero(weights)
    return index, weights[index], False


def plain(array: np.ndarray) -> np.ndarray:
    """The same memory as an ordinary array, so that read-only and memory-mapped models need no kernels of their own."""
    if type(array) is np.ndarray and array.flags.writeable:
        return array

    class Memory:
        __array_interface__ = {**array.__array_interface__, "data": (array.__array_interface__["data"][0], False)}
        owner = array

    return np.asarray(Memory()) if array.size else np.zeros(array.shape, array.dtype)
