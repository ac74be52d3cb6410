# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU backend: project every part, sort once, list the tiles, rasterise."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..appearance import ACTIVATIONS, RGB, SH, Features
from ..camera import Camera
from ..scene import Buffers, Layout, Part
from . import project, raster, tiles
from .decode import decode
from .jit import announce
from .sort import order_by
from .threads import ranges, run, thread_count

CODES = {RGB: project.RGB, SH: project.SH, Features: project.FEATURES}
CHUNK = 16_384
"""Gaussians in one piece of work."""
TILES = 64
"""Tiles in one piece of work."""
ENTRIES = 48_000_000
"""Tile entries held at once; a picture with more is rasterised in bands."""


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


def draw(parts: list[Part], camera: Camera, layout: Layout, median: bool, progress) -> Buffers:
    """All parts as one cloud, composited into the layout's channels (scene.py)."""
    announce()
    cloud = project_parts(parts, camera, layout, lambda f: progress(0.3 * f))
    buffers = rasterise(cloud.order(), cloud.geometry, cloud.shade, cloud.channels, camera, median, lambda f: progress(0.35 + 0.6 * f))
    return Buffers(buffers.channels[..., :layout.channels], buffers.alpha, buffers.median)


def project_parts(parts: list[Part], camera: Camera, layout: Layout, progress=None) -> Cloud:
    """Slice, cull and project all parts."""
    total = sum(len(part.model) for part in parts)
    shade = np.empty((total, raster.CHANNEL + raster.padded(layout.channels)), np.float32)
    arrays = np.empty((total, 5)), shade, np.empty(total, np.float32), np.empty(total, np.int32)
    runs, done = [], 0
    for part in parts:
        count, inputs = len(part.model), _inputs(part, camera, layout)
        rows = tuple(array[done:done + count] for array in arrays)
        pieces = ranges(count, CHUNK)
        share = progress and (lambda f, done=done, count=count: progress((done + f * count) / total))
        counts = run(lambda first, last, rest=(*inputs, *rows): project.project(first, last, *rest), pieces, share)
        runs.append([(done + first, number) for (first, _), number in zip(pieces, counts)])
        done += count
    index = [np.arange(first, first + number, dtype=np.int32) for part in runs for first, number in part]
    return Cloud(*arrays, runs, np.concatenate(index) if index else np.empty(0, np.int32))


def _inputs(part: Part, camera: Camera, layout: Layout):
    """arrays, times, view, lens, constants and look of a part, see project.project."""
    model, group = part.model, layout.group_of(part)
    to_camera, to_model = part.model_to_camera, part.camera_to_model
    x0, y0, width, height = camera.window
    view = np.concatenate([to_camera[:3, :3], to_camera[None, :3, 3], to_model[None, :3, 2 if camera.orthographic else 3]])
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, part.near(camera), *camera.tangent_limits(),
            x0 + 0.5, x0 + width - 0.5, y0 + 0.5, y0 + height - 0.5)
    r = model.raster
    return (
        tuple(_plain(a) for a in model.arrays.values()),
        (part.t, model.temporal_kind.code, _weights(model.basis, part.t), _weights(model.rotation_basis, part.t)),
        np.ascontiguousarray(view), tuple(float(v) for v in lens),
        (float(r.blur), float(r.alpha_max), float(r.alpha_cut), bool(r.antialiased), bool(camera.orthographic)),
        (CODES[type(model.appearance)], getattr(model.appearance, "degree", 0), group.offset,
         -1 if group.weight is None else group.weight, -1 if layout.depth is None else layout.depth),
    )


def rasterise(order, geometry, shade, channels: int, camera: Camera, median: bool, progress=None) -> Buffers:
    """Blend splats (raster.py) in the given order into the camera's window."""
    x0, y0, width, height = camera.window
    tile_x, tile_y = x0 // raster.TILE, y0 // raster.TILE
    columns = (x0 + width - 1) // raster.TILE - tile_x + 1
    rows = (y0 + height - 1) // raster.TILE - tile_y + 1
    out = np.zeros((height, width, channels), np.float32)
    alpha = np.zeros((height, width), np.float32)
    nearest = np.empty((height, width) if median else (0, 0), np.float32)
    grid = (tile_x, tile_y, columns, rows)
    segments, counts = list_spans(order, geometry, shade, grid)
    kernel = raster.rasteriser(channels, median)
    for first, last in _bands(counts.sum(0).reshape(rows, columns).sum(1)):
        starts, ids = list_tiles(segments, counts, first * columns, last * columns)
        rest = (columns, x0, y0, x0 + width, y0 + height, tile_x, tile_y, starts, ids, geometry, shade, out, alpha, nearest)
        tiles_of_band = [(first * columns + a, first * columns + b) for a, b in ranges((last - first) * columns, TILES)]
        share = progress and (lambda f, first=first, last=last: progress((first + f * (last - first)) / rows))
        run(lambda a, b, rest=rest: kernel(a, b, *rest), tiles_of_band, share)
    return Buffers(out, alpha, nearest if median else None)


def list_spans(order, geometry, shade, grid):
    """Runs of tiles for each segment of the sorted splats (tiles.spans), and how many splats of it each tile has.

    grid: first tile in x and y, columns, rows.  Returns the segments' runs and counts [segments, tiles] int64.
    """
    pieces = ranges(len(order), max(CHUNK, -(-len(order) // (2 * thread_count()))))
    counts = np.zeros((max(len(pieces), 1), grid[2] * grid[3]), np.int64)
    return run(lambda s, first, last: tiles.spans(first, last, order, geometry, shade, *grid, counts[s]),
               [(s, *piece) for s, piece in enumerate(pieces)]), counts


def list_tiles(segments, counts, first: int, last: int):
    """Lists of the tiles first..last: starts [tiles + 1] int64 and ids int32, front to back within each tile."""
    counts = counts.copy()
    counts[:, :first] = 0
    counts[:, last:] = 0
    starts = np.zeros(counts.shape[1] + 1, np.int64)
    np.cumsum(counts.sum(0), out=starts[1:])
    cursors = starts[:-1] + np.cumsum(counts, 0) - counts
    ids = np.empty(starts[-1], np.int32)
    run(lambda s, segment: tiles.scatter(*segment, first, last, cursors[s], ids), enumerate(segments))
    return starts, ids


def decode_features(features, weight, part: Part, camera: Camera) -> np.ndarray:
    """Premultiplied colour [h, w, 3] of blended features [h, w, 9]; see reference.decode_features."""
    appearance: Features = part.model.appearance
    x0, y0, width, height = camera.window
    out = np.empty((height, width, 3), np.float32)
    to_model = np.ascontiguousarray(np.concatenate([part.camera_to_model[:3, :3], part.camera_to_model[None, :3, 3]]))
    lens = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
    features, weight = np.ascontiguousarray(features), np.ascontiguousarray(weight)
    run(lambda first, last: decode(first, last, features, weight, appearance.w1, appearance.w2,
                                   ACTIVATIONS.index(appearance.activation), to_model, lens, x0, y0, camera.orthographic, out),
        ranges(height, 64))
    return out


def _bands(row_totals) -> list[tuple[int, int]]:
    """Runs of rows of tiles with at most ENTRIES entries each (one row at least)."""
    bands, first, total = [], 0, 0
    for row, entries in enumerate(row_totals):
        if row > first and total + entries > ENTRIES:
            bands.append((first, row))
            first, total = row, 0
        total += entries
    return [*bands, (first, len(row_totals))]


def _weights(basis, t):
    """(index, weights, centred) of a basis for the kernel: only the coefficients that count at time t."""
    if basis.centred:
        return np.empty(0, np.int64), np.empty(0), True
    weights = basis.weights(t)
    index = np.flatnonzero(weights)
    return index, weights[index], False


def _plain(array: np.ndarray) -> np.ndarray:
    """The same memory as an ordinary array, so that read-only and memory-mapped models need no kernels of their own."""
    if type(array) is np.ndarray and array.flags.writeable:
        return array

    class Memory:
        __array_interface__ = {**array.__array_interface__, "data": (array.__array_interface__["data"][0], False)}
        owner = array

    return np.asarray(Memory()) if array.size else np.zeros(array.shape, array.dtype)
