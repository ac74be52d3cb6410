# SPDX-License-Identifier: GPL-3.0-or-later
"""Blends splats into a camera's window, forward and backward: makes tile lists, runs kernels, and cuts large pictures into bands."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...rendering.layout import PROBES, Buffers, Layout
from ...util.threads import portions, run
from . import raster, raster_backward, raster_by_pixel
from .holdout import Occluder
from .memory import empty, zeros
from .tile_lists import TileLists, list_tiles, tile_cursors

NONE = np.zeros((0, 0), np.float32)
TILES = 64
"""Tiles in one piece of work, at most."""
ENTRIES = 48_000_000
"""Tile entries held at once; a picture with more is rasterised in bands."""
BACKWARD_BYTES = 24 << 20
"""Bytes of tile entries' gradients held at once; a picture with more goes backward in bands.  Fresh memory costs more than bands."""


@dataclass(frozen=True, eq=False)
class Picture:
    """The blended picture: channels [h, w, C] float32, premultiplied, alpha [h, w], each probe's picture [h, w] by its name, and of a
    holdout the light that it stops and the share of the pixel that it covers [h, w], or None."""

    channels: np.ndarray
    alpha: np.ndarray
    probes: dict[str, np.ndarray]
    held: np.ndarray | None = None
    covered: np.ndarray | None = None

    def buffers(self, layout: Layout) -> Buffers:
        """The picture by what its channels mean."""
        sums = {name: self.channels[..., where] for name, where in layout.places.items()}
        return Buffers(self.channels[..., :layout.channels], self.alpha, sums, self.probes, self.held, self.covered)


def rasterise(order, geometry, attributes, channels: int, camera: Camera, probes=(), progress=None, wanted=None,
              holdout: np.ndarray | None = None, plane: int | None = None, by_pixel: bool = False,
              core: tuple[int, int] = (0, 0), decode=None) -> Picture:
    """Blend splats (raster.py) in the given order into the camera's window.

    probes   which of layout.PROBES to compute
    wanted   [tiles] bool: which tiles to draw, the others stay empty; None: all
    holdout  triangles [F, 3, 3] float32 that hide splats
    plane    with a holdout or by_pixel, the first of the channels of the splats' planes (layout.Layout.plane)
    by_pixel each pixel sorts its splats by the depths of these planes
    core     from which channel to which they are summed over the core of each pixel (layout.py)
    decode   what takes the channels and alpha of rows of pixels, the first one's place in y, and where to write their colour, which takes
             the channels' place
    """
    _, _, width, height = camera.window
    probes = tuple(name for name in PROBES if name in probes)
    extra = np.empty((height, len(probes) * width), np.float32)
    listing = TileLists.of(order, geometry, attributes, camera, wanted=wanted)
    occluder = None if holdout is None else Occluder.of(holdout, camera)
    held = np.zeros((height, 2 * width), np.float32) if occluder else NONE
    if by_pixel:
        kernel = raster_by_pixel.rasteriser(probes, plane, core)
    else:
        kernel = raster.rasteriser(channels, probes, plane=plane if occluder else None, core=core)
    middle = camera.width / 2, camera.height / 2
    out, alpha, _ = _blend(listing, geometry, attributes, channels, kernel, extra, progress, wanted, occluder, held, middle, True, decode)
    return Picture(out, alpha, {name: extra[:, i * width:(i + 1) * width] for i, name in enumerate(probes)},
                   *((held[:, :width], held[:, width:]) if occluder else ()))


def _blend(listing: TileLists, geometry, attributes, channels: int, kernel, extra, progress=None, wanted=None,
           occluder: Occluder | None = None, held=NONE, middle=(0.0, 0.0), once: bool = False, decode=None):
    """Run a kernel of raster.rasteriser over the window; returns its channels, its alpha and the tile lists of the last band.

    once: the listing's segments are given up when their lists have been made.  decode: as in rasterise().
    """
    x0, y0, right, bottom = listing.window
    tile_x, tile_y, columns, rows = listing.grid
    size = bottom - y0, right - x0
    out, alpha = (empty(shape, np.float32, len(geometry)) for shape in ((*size, 3 if decode else channels), size))
    hiding = occluder.depths if occluder else lambda *_: raster.NOTHING
    wanted = np.ones(columns * rows, np.bool_) if wanted is None else wanted

    def blend(first, last, lists):
        top, end = (min(max((tile_y + tile // columns) * raster.TILE, y0), bottom) for tile in (first, last))
        part = slice(top - y0, end - y0)
        drawn = empty((end - top, right - x0, channels), np.float32, len(geometry)) if decode else out[part]
        if not wanted[first:last].all():
            drawn.fill(0)
            alpha[part].fill(0)
        kernel(first, last, columns, x0, top, right, end, tile_x, tile_y, *lists, geometry, attributes, drawn, alpha[part], extra[part],
               hiding(first, last, wanted), held[part], *middle, wanted)
        if decode:
            decode(drawn, alpha[part], top, out[part])

    for first, last in listing.bands(ENTRIES):
        lists = list_tiles(listing.segments, listing.counts, first, last)
        if once and last == columns * rows:
            listing.segments.clear()
        share = progress and (lambda f, first=first, last=last: progress((first + f * (last - first)) / (columns * rows)))
        pieces = [(first + a * columns, first + b * columns) for a, b in portions((last - first) // columns, -(-TILES // columns), 1)]
        run(lambda a, b, lists=lists: blend(a, b, lists), pieces, share)
    return out, alpha, lists


def _tiles(first: int, last: int) -> list[tuple[int, int]]:
    """The tiles first..last in pieces of work."""
    return [(first + a, first + b) for a, b in portions(last - first, TILES, 1)]


@dataclass(frozen=True, eq=False)
class RasterState:
    """The values of a forward pass that rasterise_backward() needs; lists: its tile lists if they were made in one go."""

    order: np.ndarray
    geometry: np.ndarray
    attributes: np.ndarray
    band: float
    listing: TileLists
    lists: tuple[np.ndarray, np.ndarray] | None
    trace: np.ndarray


@dataclass(frozen=True, eq=False)
class RasterGradients:
    """d loss / d splats, for the M rows of geometry and attributes; zeros for splats that were not drawn.

    geometry [M, 5] float64, log2_opacity [M] float32, channels [M, C] float32
    absolute [M, 2] float32: sums over pixels of |d loss / d mean_x| and |d loss / d mean_y|, times the pixel's emphasis
    """

    geometry: np.ndarray
    log2_opacity: np.ndarray
    channels: np.ndarray
    absolute: np.ndarray


def rasterise_forward(order, geometry, attributes, channels: int, camera: Camera, band: float = 0.0) -> tuple[Picture, RasterState]:
    """rasterise(), and what rasterise_backward() needs of it; band: see raster.rasteriser."""
    _, _, width, height = camera.window
    trace = np.empty((height, 2 * width), np.float32)
    listing = TileLists.of(order, geometry, attributes, camera)
    kernel = raster.rasteriser(channels, (), True, float(band))
    out, alpha, lists = _blend(listing, geometry, attributes, channels, kernel, trace)
    whole = len(listing.bands(ENTRIES)) == 1
    return Picture(out, alpha, {}), RasterState(order, geometry, attributes, float(band), listing, lists if whole else None, trace)


def rasterise_backward(state: RasterState, grad_channels, grad_alpha, emphasis=None) -> RasterGradients:
    """From d loss / d channels [h, w, C] and d loss / d alpha [h, w] to d loss / d splats (raster_backward.py); emphasis [h, w]: None is 1.

    The same bytes for any number of threads.  Besides the gradients it holds at most BACKWARD_BYTES of sums at a time.
    """
    rows, channels = len(state.geometry), state.attributes.shape[1] - raster.CHANNEL
    width, listing = raster_backward.columns(channels), state.listing
    grad_channels, grad_alpha = (np.ascontiguousarray(g, np.float32) for g in (grad_channels, grad_alpha))
    emphasis = np.ones(grad_alpha.shape, np.float32) if emphasis is None else np.ascontiguousarray(emphasis, np.float32)
    sums = zeros((rows, width), np.float32, rows)
    ends = np.zeros(listing.counts.shape[1], np.int64)
    kernel = raster_backward.rasteriser_backward(channels, state.band)
    bands = listing.bands(min(BACKWARD_BYTES // (4 * width), ENTRIES))
    totals = listing.counts.sum(0)
    entries = np.empty((max(totals[first:last].sum() for first, last in bands), width), np.float32)
    for first, last in bands:
        starts, ids = state.lists or list_tiles(listing.segments, listing.counts, first, last)
        begin, end = starts[first], starts[last]
        rest = (*listing.frame, starts - begin, ids[begin:end], state.geometry, state.attributes, state.trace, grad_channels, grad_alpha,
                emphasis, ends, entries)
        run(lambda a, b, rest=rest: kernel(a, b, *rest), _tiles(first, last))
        band_starts, cursors = tile_cursors(listing.counts, first, last)
        rest = (band_starts, ends, entries, sums)
        run(lambda segment, cursor, span=(first, last), rest=rest: raster_backward.collect(segment, *span, cursor, *rest),
            zip(listing.segments, cursors))
    shapes = ((rows, 5), np.float64), ((rows,), np.float32), ((rows, channels), np.float32), ((rows, 2), np.float32)
    result = RasterGradients(*(zeros(shape, kind, rows) for shape, kind in shapes))
    rest = (np.sort(state.order), state.geometry, sums, result.geometry, result.log2_opacity, result.channels, result.absolute)
    run(lambda a, b: raster_backward.finish(a, b, *rest), portions(len(state.order)))
    return result
