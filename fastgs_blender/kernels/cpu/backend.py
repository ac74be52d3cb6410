# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU backend: project every part, sort once, list the tiles, rasterise."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, Features
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Buffers, Layout
from ...util.threads import ranges, run, thread_count
from . import raster, raster_backward, tiles
from .clouds import CHUNK, Cloud, plain, project_backward, project_parts
from .decode import decode
from .decode_backward import decode_backward as decode_rows_backward
from .jit import announce

__all__ = ["Cloud", "RasterGradients", "decode_backward", "decode_features", "draw", "project_backward", "project_parts", "rasterise",
           "rasterise_backward", "rasterise_forward"]

TILES = 64
"""Tiles in one piece of work."""
ENTRIES = 48_000_000
"""Tile entries held at once; a picture with more is rasterised in bands."""
BACKWARD_BYTES = 24 << 20
"""Bytes of tile entries' gradients held at once; a picture with more goes backward in bands.  Fresh memory costs more than bands."""


def draw(parts: list[ViewedInstance], camera: Camera, layout: Layout, median: bool, progress) -> Buffers:
    """All parts as one cloud, composited into the layout's channels (scene.py)."""
    announce()
    cloud = project_parts(parts, camera, layout, lambda f: progress(0.3 * f))
    buffers = rasterise(cloud.order(), cloud.geometry, cloud.shade, cloud.channels, camera, median, lambda f: progress(0.35 + 0.6 * f))
    return Buffers(buffers.channels[..., :layout.channels], buffers.alpha, buffers.median)


def rasterise(order, geometry, shade, channels: int, camera: Camera, median: bool, progress=None) -> Buffers:
    """Blend splats (raster.py) in the given order into the camera's window."""
    _, _, width, height = camera.window
    nearest = np.empty((height, width) if median else (0, 0), np.float32)
    listing = Listing.of(order, geometry, shade, camera)
    out, alpha, _ = _blend(listing, geometry, shade, channels, raster.rasteriser(channels, median), nearest, progress)
    return Buffers(out, alpha, nearest if median else None)


@dataclass(frozen=True, eq=False)
class Listing:
    """Which splats touch which tile of a camera's window.

    window   x0, y0, right, bottom in pixels of the image
    grid     first tile in x and y, columns, rows
    segments, counts   the runs of tiles of each segment of the sorted splats, and its splats in each tile; see list_spans()
    """

    window: tuple[int, int, int, int]
    grid: tuple[int, int, int, int]
    segments: list
    counts: np.ndarray

    @classmethod
    def of(cls, order, geometry, shade, camera: Camera) -> Listing:
        """The listing of splats in the given order."""
        x0, y0, width, height = camera.window
        tile_x, tile_y = x0 // raster.TILE, y0 // raster.TILE
        grid = (tile_x, tile_y, (x0 + width - 1) // raster.TILE - tile_x + 1, (y0 + height - 1) // raster.TILE - tile_y + 1)
        return cls((x0, y0, x0 + width, y0 + height), grid, *list_spans(order, geometry, shade, grid))

    def bands(self, limit: int) -> list[tuple[int, int]]:
        """Runs of tiles, whole rows of them, with at most `limit` entries each (one row at least)."""
        columns, rows = self.grid[2:]
        bands, first, total = [], 0, 0
        for row, entries in enumerate(self.counts.sum(0).reshape(rows, columns).sum(1)):
            if row > first and total + entries > limit:
                bands.append((first * columns, row * columns))
                first, total = row, 0
            total += entries
        return [*bands, (first * columns, rows * columns)]

    @property
    def frame(self) -> tuple:
        """columns, x0, y0, right, bottom, tile_x, tile_y, as the kernels take them."""
        return (self.grid[2], *self.window, *self.grid[:2])


def _blend(listing: Listing, geometry, shade, channels: int, kernel, extra, progress=None):
    """Run a kernel of raster.rasteriser over the window; returns its channels, its alpha and the tile lists of the last band."""
    x0, y0, right, bottom = listing.window
    out = np.zeros((bottom - y0, right - x0, channels), np.float32)
    alpha = np.zeros((bottom - y0, right - x0), np.float32)
    total = listing.counts.shape[1]
    for first, last in listing.bands(ENTRIES):
        lists = list_tiles(listing.segments, listing.counts, first, last)
        rest = (*listing.frame, *lists, geometry, shade, out, alpha, extra)
        share = progress and (lambda f, first=first, last=last: progress((first + f * (last - first)) / total))
        run(lambda a, b, rest=rest: kernel(a, b, *rest), _tiles(first, last), share)
    return out, alpha, lists


def _tiles(first: int, last: int) -> list[tuple[int, int]]:
    """The tiles first..last in pieces of work."""
    return [(first + a, first + b) for a, b in ranges(last - first, TILES)]


@dataclass(frozen=True, eq=False)
class Drawn:
    """What rasterise_backward() needs of a forward pass; lists: its tile lists if they were made in one go."""

    order: np.ndarray
    geometry: np.ndarray
    shade: np.ndarray
    band: float
    listing: Listing
    lists: tuple[np.ndarray, np.ndarray] | None
    trace: np.ndarray


@dataclass(frozen=True, eq=False)
class RasterGradients:
    """d loss / d splats, for the M rows of geometry and shade; zeros where nothing was drawn.

    geometry [M, 5] float64, log2_opacity [M] float32, channels [M, C] float32
    absolute [M, 2] float32: sums over pixels of |d loss / d mean_x| and |d loss / d mean_y|
    """

    geometry: np.ndarray
    log2_opacity: np.ndarray
    channels: np.ndarray
    absolute: np.ndarray


def rasterise_forward(order, geometry, shade, channels: int, camera: Camera, band: float = 0.0) -> tuple[Buffers, Drawn]:
    """rasterise(), and what rasterise_backward() needs of it; band: see raster.rasteriser."""
    _, _, width, height = camera.window
    trace = np.empty((height, 2 * width), np.float32)
    listing = Listing.of(order, geometry, shade, camera)
    kernel = raster.rasteriser(channels, False, True, float(band))
    out, alpha, lists = _blend(listing, geometry, shade, channels, kernel, trace)
    whole = len(listing.bands(ENTRIES)) == 1
    return Buffers(out, alpha, None), Drawn(order, geometry, shade, float(band), listing, lists if whole else None, trace)


def rasterise_backward(drawn: Drawn, grad_channels, grad_alpha) -> RasterGradients:
    """From d loss / d channels [h, w, C] and d loss / d alpha [h, w] to d loss / d splats (raster_backward.py).

    The same bytes for any number of threads.  Besides the gradients it holds at most BACKWARD_BYTES of sums at a time.
    """
    rows, channels = len(drawn.geometry), drawn.shade.shape[1] - raster.CHANNEL
    width, listing = raster_backward.columns(channels), drawn.listing
    grad_channels, grad_alpha = (np.ascontiguousarray(g, np.float32) for g in (grad_channels, grad_alpha))
    sums = np.zeros((rows, width), np.float32)
    ends = np.zeros(listing.counts.shape[1], np.int64)
    kernel = raster_backward.rasteriser_backward(channels, drawn.band)
    bands = listing.bands(min(BACKWARD_BYTES // (4 * width), ENTRIES))
    totals = listing.counts.sum(0)
    entries = np.empty((max(totals[first:last].sum() for first, last in bands), width), np.float32)
    for first, last in bands:
        starts, ids = drawn.lists or list_tiles(listing.segments, listing.counts, first, last)
        begin, end = starts[first], starts[last]
        rest = (*listing.frame, starts - begin, ids[begin:end], drawn.geometry, drawn.shade, drawn.trace, grad_channels, grad_alpha,
                ends, entries)
        run(lambda a, b, rest=rest: kernel(a, b, *rest), _tiles(first, last))
        band_starts, cursors = _cursors(listing.counts, first, last)
        rest = (band_starts, ends, entries, sums)
        run(lambda segment, cursor, span=(first, last), rest=rest: raster_backward.collect(*segment, *span, cursor, *rest),
            zip(listing.segments, cursors))
    result = RasterGradients(np.zeros((rows, 5)), np.zeros(rows, np.float32), np.zeros((rows, channels), np.float32),
                             np.zeros((rows, 2), np.float32))
    rest = (np.sort(drawn.order), drawn.geometry, sums, result.geometry, result.log2_opacity, result.channels, result.absolute)
    run(lambda a, b: raster_backward.finish(a, b, *rest), ranges(len(drawn.order), CHUNK))
    return result


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
    starts, cursors = _cursors(counts, first, last)
    ids = np.empty(starts[-1], np.int32)
    run(lambda s, segment: tiles.scatter(*segment, first, last, cursors[s], ids), enumerate(segments))
    return starts, ids


def _cursors(counts, first: int, last: int):
    """Where each tile's list begins, and where in it each segment's splats begin, with the lists of the tiles first..last alone."""
    counts = counts.copy()
    counts[:, :first] = 0
    counts[:, last:] = 0
    starts = np.zeros(counts.shape[1] + 1, np.int64)
    np.cumsum(counts.sum(0), out=starts[1:])
    return starts, starts[:-1] + np.cumsum(counts, 0) - counts


def decode_features(features, weight, part: ViewedInstance, camera: Camera) -> np.ndarray:
    """Premultiplied colour [h, w, 3] of blended features [h, w, C >= 9]; see reference.decode_features."""
    _, _, width, height = camera.window
    out, inputs = np.empty((height, width, 3), np.float32), _decoder_inputs(features, weight, part, camera)
    run(lambda first, last: decode(first, last, *inputs, out), ranges(height, 64))
    return out


def decode_backward(features, weight, part: ViewedInstance, camera: Camera, grad):
    """From d loss / d colour [h, w, 3] to that of features [h, w, C], weight [h, w], w1 [6, 12] and w2 [3, 6].

    Every piece of rows has its own sums for the matrices, added in order: the same bytes for any number of threads.
    """
    pieces = ranges(camera.window[3], 32)
    grad_features, grad_weight = np.empty(features.shape, np.float32), np.empty(weight.shape, np.float32)
    grad_w1, grad_w2 = np.empty((len(pieces), 6, 12)), np.empty((len(pieces), 3, 6))
    rest = (*_decoder_inputs(features, weight, part, camera), np.ascontiguousarray(grad, np.float32), grad_features, grad_weight)
    run(lambda i, piece: decode_rows_backward(*piece, *rest, grad_w1[i], grad_w2[i]), enumerate(pieces))
    return grad_features, grad_weight, grad_w1.sum(0).astype(np.float32), grad_w2.sum(0).astype(np.float32)


def _decoder_inputs(features, weight, part, camera):
    """What decode.decode and its backward pass take between the rows and the picture."""
    appearance: Features = part.model.appearance
    x0, y0, _, _ = camera.window
    to_model = np.ascontiguousarray(np.concatenate([part.camera_to_model[:3, :3], part.camera_to_model[None, :3, 3]]))
    lens = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
    return (np.ascontiguousarray(features), np.ascontiguousarray(weight), plain(appearance.w1), plain(appearance.w2),
            ACTIVATIONS.index(appearance.activation), to_model, lens, x0, y0, bool(camera.orthographic))
