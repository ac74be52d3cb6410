# SPDX-License-Identifier: GPL-3.0-or-later
"""Projects instances to splats (slice, crop, cull, project), on all threads; forward and backward pass."""
from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import Appearance, Changing, Features, features_at, momentary
from ...rendering.crops import crop_arrays
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Layout
from ...rendering.looks import Look
from ...rendering.quantities import Shown
from ...util.threads import portions, run
from . import project, raster
from .lanes import LANES
from .memory import empty
from .project_backward import project_backward as project_rows_backward
from .rasterise import RasterGradients
from .reaching import NOWHERE
from .sort import order_by

GAUSSIANS = 65_536
"""Gaussians in one piece of work, at most: it takes two kernels, and calling these takes some 20 us each."""


@dataclass(frozen=True, eq=False)
class ProjectedSplats:
    """The splats of all instances in arrays with room for every Gaussian, of which only the first rows are written, and so take memory.

    geometry, attributes  see raster.py
    depth   [rows] float32, along the view axis
    source  [rows] int32: which Gaussian of its instance each row is
    runs    for each instance, the first row and the number of rows written for each piece of it; pieces lie in any order
    index   [V] int32: the rows written, in the order of their Gaussians
    """

    geometry: np.ndarray
    attributes: np.ndarray
    depth: np.ndarray
    source: np.ndarray
    runs: list[list[tuple[int, int]]]
    index: np.ndarray

    @property
    def channels(self) -> int:
        """The number of channels, padded to one that the rasteriser has a kernel for."""
        return self.attributes.shape[1] - raster.CHANNEL

    def order(self) -> np.ndarray:
        """The rows written [V] int32, front to back."""
        pieces = [self.depth[first:first + count] for runs in self.runs for first, count in runs]
        return order_by(np.concatenate(pieces) if pieces else self.depth[:0], self.index)


def project_instances(instances: list[ViewedInstance], camera: Camera, layout: Layout, progress=None, cells=NOWHERE) -> ProjectedSplats:
    """Slice, cull and project all instances; cells: of points before which splats must lie, as cells_of() has them."""
    total = sum(len(instance.model) for instance in instances)
    attributes = empty((total, raster.CHANNEL + raster.padded(layout.channels)), np.float32, total)
    arrays = empty((total, 5), np.float64, total), attributes, empty((total,), np.float32, total), empty((total,), np.int32, total)
    runs, done, used, lock = [], 0, 0, threading.Lock()

    def piece(first, last, cut, look, inputs):
        nonlocal used
        found = empty((5, last - first + LANES), np.float64, total)
        number = found[4].view(np.int64)
        count = project.opaque(first, last, cut, look, *inputs[:-1], number, found)
        with lock:
            row, used = used, used + count
        return row, project.project(row, count, number, found, look, *inputs, *arrays)

    for instance in instances:
        cut = crop_arrays(instance.settings.crops), instance.ball, instance.hidden, cells
        look = instance.look.copy()
        look[Look.GRADED] *= not isinstance(instance.model.appearance, Features)  # a decoder's colours are changed when it has made them
        count, rest = len(instance.model), (cut, look, _inputs(instance, camera, layout))
        share = progress and (lambda f, done=done, count=count: progress((done + f * count) / total))
        runs.append(run(lambda first, last, rest=rest: piece(first, last, *rest), portions(count, GAUSSIANS), share))
        if layout.quantities:
            run(lambda first, number, instance=instance: _fill(instance, layout, attributes, arrays[3], first, number), runs[-1])
        done += count
    index = [np.arange(first, first + number, dtype=np.int32) for pieces in runs for first, number in pieces]
    return ProjectedSplats(*arrays, runs, np.concatenate(index) if index else np.empty(0, np.int32))


def _fill(instance, layout, attributes, source, first: int, number: int):
    """Write the layout's quantities into the rows of splats first..first + number, which are the Gaussians source[row]."""
    rows = slice(first, first + number)
    shown = Shown(instance, source[rows])
    for name, quantity in layout.quantities.items():
        where = layout.places[name]
        attributes[rows, raster.CHANNEL + where.start:raster.CHANNEL + where.stop] = quantity.of(shown)


def project_backward(instance: ViewedInstance, camera: Camera, layout: Layout, splats: ProjectedSplats, gradients: RasterGradients,
                     detach_time: bool = False) -> dict[str, np.ndarray]:
    """d loss / d the model's arrays by name, from d loss / d splats, where project_instances() projected this instance alone.

    detach_time: mu_tau's gradient comes through the temporal opacity alone, as STG trains.
    """
    model = instance.model
    look = momentary(model.appearance)
    out = {name: np.empty_like(array) for name, array in model.arrays.items()}
    out["features"] = np.empty((len(model), look.width), np.float32)
    slopes = (gradients.geometry, gradients.log2_opacity, gradients.channels)
    rest = (splats.source, slopes, bool(detach_time), tuple(out.values()), *_inputs(instance, camera, layout))
    runs = [(row, row + count) for row, count in splats.runs[0] if count] or [(0, 0)]
    begins = [int(splats.source[row]) for row, _ in runs[1:]]
    run(lambda first, last, rows: project_rows_backward(first, last, *rows, *rest), zip([0, *begins], [*begins, len(model)], runs))
    if isinstance(model.appearance, Changing):
        _spread_colours(model, instance.t, out, detach_time)
    return out


def _spread_colours(model, t: float, out: dict[str, np.ndarray], detach_time: bool) -> None:
    """Turn the gradient of features at t into that of colours which change in time: constants, coefficients, and mu_tau."""
    basis, now = model.appearance.basis, out["features"].astype(np.float64)
    mu_tau = model.mu_tau.astype(np.float64)
    weights = np.atleast_2d(basis.weights(t - mu_tau if basis.centred else t))
    if basis.centred and not detach_time:
        coefficients = model.features[:, now.shape[1]:].reshape(len(model), basis.terms, now.shape[1])
        out["mu_tau"] -= np.einsum("nf,nf->n", now, basis.rate(coefficients, t, mu_tau)).astype(np.float32)
    slopes = (weights[:, :, None] * now[:, None]).reshape(len(model), basis.terms * now.shape[1])  # of no Gaussians, too
    out["features"] = np.concatenate([now, slopes], 1).astype(np.float32)


def _inputs(instance: ViewedInstance, camera: Camera, layout: Layout):
    """arrays, times, view, lens, constants and channel plan of an instance, see project.project."""
    model, group = instance.model, layout.group_of(instance)
    to_camera, (x0, y0, width, height) = instance.model_to_camera, camera.window
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, instance.near, instance.far, *camera.tangent_limits(),
            x0 + 0.5, x0 + width - 0.5, y0 + 0.5, y0 + height - 0.5)
    r, look, own = model.raster, momentary(model.appearance), model.arrays
    along = type(look).seen is not Appearance.seen  # the inverse takes as long as a tenth of a small picture
    eye = instance.camera_to_model[:3, 2 if camera.orthographic else 3] if along else np.zeros(3)
    if isinstance(model.appearance, Changing):
        own = own | {"features": features_at(model.appearance, model.features, instance.t, model.mu_tau).astype(np.float32)}
    return (
        tuple(plain(a) for a in own.values()),
        (instance.t, model.temporal_kind.code, weights_at(model.basis, instance.t), weights_at(model.rotation_basis, instance.t)),
        np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3], eye[None]]), tuple(float(v) for v in lens),
        (float(r.blur), float(r.alpha_max), float(r.alpha_cut), bool(r.antialiased), bool(camera.orthographic),
         (instance.sampling.row, instance.sampling.cameras), bool(instance.settings.bends)),
        (look.code, getattr(look, "degree", 0), group.offset,
         -1 if group.weight is None else group.weight, -1 if layout.depth is None else layout.depth,
         (-1 if layout.plane is None else layout.plane, camera.width / 2, camera.height / 2, layout.by_pixel)),
    )


def weights_at(basis, t):
    """(index, weights, centred) of a basis for the kernel: only the coefficients that count at time t."""
    if basis.centred:
        return np.empty(0, np.int64), np.empty(0), True
    weights = basis.weights(t)
    index = np.flatnonzero(weights)
    return index, weights[index], False


def plain(array: np.ndarray) -> np.ndarray:
    """The same memory as an ordinary array, so that read-only models need no kernels of their own."""
    if type(array) is np.ndarray and array.flags.writeable:
        return array

    return np.asarray(_Memory(array)) if array.size else np.zeros(array.shape, array.dtype)


class _Memory:
    """An array's memory, which may be written."""

    def __init__(self, array: np.ndarray):
        known = array.__array_interface__
        self.owner, self.__array_interface__ = array, known | {"data": (known["data"][0], False)}
