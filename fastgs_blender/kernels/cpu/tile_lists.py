# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the lists of splats that touch each tile of a camera's window, front to back, on all threads."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...util.threads import ranges, run, thread_count
from . import raster, tiles
from .memory import empty

FEW = 1024
"""Splats in one piece of work, at least."""


@dataclass(frozen=True, eq=False)
class TileLists:
    """Which splats touch which tile of a camera's window, as runs from which the lists of any band of tiles can be made.

    window   x0, y0, right, bottom in pixels of the image
    grid     first tile in x and y, columns, rows
    segments, counts   the runs of tiles of each segment of the sorted splats, and its splats in each tile; see list_spans()
    """

    window: tuple[int, int, int, int]
    grid: tuple[int, int, int, int]
    segments: list
    counts: np.ndarray

    @classmethod
    def of(cls, order, geometry, attributes, camera: Camera, tile: int = raster.TILE, wanted=None) -> TileLists:
        """The tile lists of splats in the given order: order [V] int32, geometry [M, 5], attributes [M, 6 + C] (raster.py).

        tile    pixels of its side, a power of two
        wanted  [tiles] bool, of which there are lists; None: of all
        """
        x0, y0, width, height = camera.window
        grid = grid_of(camera, tile)
        return cls((x0, y0, x0 + width, y0 + height), grid, *list_spans(order, geometry, attributes, grid, tile, wanted))

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


def grid_of(camera: Camera, tile: int) -> tuple[int, int, int, int]:
    """TileLists.grid of a camera's window."""
    x0, y0, width, height = camera.window
    tile_x, tile_y = x0 // tile, y0 // tile
    return tile_x, tile_y, (x0 + width - 1) // tile - tile_x + 1, (y0 + height - 1) // tile - tile_y + 1


def list_spans(order, geometry, attributes, grid, tile, wanted=None):
    """Runs of tiles for each segment of the sorted splats (tiles.spans), and how many splats of it each tile has.

    grid: first tile in x and y, columns, rows; tile: pixels of a tile's side; wanted: as in TileLists.of().  Returns the segments' runs
    and counts [segments, tiles] int32.
    """
    pieces = ranges(len(order), max(FEW, -(-len(order) // (2 * thread_count()))))
    changes = np.zeros((max(len(pieces), 1), grid[2] * grid[3] + 1), np.int32)
    rest = (order, geometry, attributes, *grid, tile.bit_length() - 1, tiles.which_tiles(wanted, *grid[2:]))

    def segment(s, first, last):
        runs, n = empty((4 * (last - first) + grid[3], 3), np.int32, len(order)), 0
        while True:
            first, n = tiles.spans(first, last, *rest, changes[s], runs, n)
            if first == last:
                changes[s].cumsum(dtype=np.int32, out=changes[s])
                return runs[:n]
            runs = np.concatenate([runs, np.empty((n + grid[3], 3), np.int32)])

    segments = run(segment, [(s, *piece) for s, piece in enumerate(pieces)])
    return segments, changes[:, :-1]


def tiles_of(wanted: np.ndarray | None, camera: Camera, tile: int = raster.TILE) -> np.ndarray | None:
    """In which tiles of a camera's window there are pixels of a mask [h, w] of it: [tiles] bool; None, which is for all, without one."""
    if wanted is None:
        return None
    (x0, y0), (height, width) = camera.window[:2], wanted.shape
    whole = np.pad(wanted, ((y0 % tile, -(y0 + height) % tile), (x0 % tile, -(x0 + width) % tile)))
    return whole.reshape(len(whole) // tile, tile, -1, tile).any((1, 3)).ravel()


def list_tiles(segments, counts, first: int, last: int):
    """Lists of the tiles first..last: starts [tiles + 1] int64 and ids int32, front to back within each tile."""
    starts, cursors = tile_cursors(counts, first, last)
    ids = empty((starts[-1],), np.int32, starts[-1] // 6)
    run(lambda s, segment: tiles.scatter(segment, first, last, cursors[s], ids), enumerate(segments))
    return starts, ids


def tile_cursors(counts, first: int, last: int):
    """Where each tile's list begins [tiles + 1] int64, and where in it each segment's splats do [segments, tiles] uint32, with the lists of
    the tiles first..last alone."""
    starts = np.zeros(counts.shape[1] + 1, np.int64)  # where no kernel runs (aside.py), lists are empty
    cursors = np.empty(counts.shape, np.uint32)
    tiles.begins(counts, first, last, starts, cursors)
    return starts, cursors
