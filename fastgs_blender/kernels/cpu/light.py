# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that each Gaussian gives to a picture: the sums of its blending weights over pixels.

Blending is linear in the channels, so that these are the picture's gradients by them (raster_backward.py).
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...rendering.layout import Layout
from ...rendering.ways import without_colours
from ...util.threads import ranges, run
from . import raster
from .jit import announce, kernel
from .rasterise import ENTRIES, RasterState, rasterise_backward, rasterise_forward
from .splats import ProjectedSplats, project_instances
from .tile_lists import list_tiles

SMALL, COARSE = 400, 4
"""Pictures with a longer side than this are looked at through one pixel for each COARSE x COARSE to see what contributes to them."""
WIDER = 12.0
"""Factor to the blur of splats there: with 8 some fall between the pixels, of which a picture shows 0.09 pixels (0.016 with 12); with more
of it those smaller than a pixel hide too much."""
BESIDE = 4
"""Pixels to each side of the picture in which Gaussians are seen, too: they are neighbours of those in it."""
TILES = 8
"""Tiles in one piece of work: such pictures have few."""


@dataclass(frozen=True, eq=False)
class Light:
    """SelectingBackend.light()."""

    splats: ProjectedSplats
    state: RasterState
    sizes: tuple[int, ...]

    def over(self, masks: np.ndarray) -> list[np.ndarray]:
        """protocol.Light.over()."""
        channels = self.splats.channels
        wanted = np.zeros((*masks.shape[:2], channels), np.float32)
        wanted[..., :masks.shape[2]] = masks
        sums = rasterise_backward(self.state, wanted, np.zeros(masks.shape[:2], np.float32)).channels
        return self._by_instance(lambda rows: sums[rows, :masks.shape[2]], (masks.shape[2],))

    def alone(self) -> list[np.ndarray]:
        """protocol.Light.alone()."""
        def area(rows):
            geometry, attributes = self.splats.geometry[rows], self.splats.attributes[rows]
            opacity, cut = (np.exp2(attributes[:, k].astype(np.float64)) for k in (raster.LOG2_OPACITY, raster.LOG2_CUT))
            spread = math.pi / math.log(2) / np.abs(geometry[:, raster.L11] * geometry[:, raster.L22])
            return np.maximum(np.minimum(opacity, attributes[:, raster.ALPHA_MAX]) - cut, 0) * spread

        return self._by_instance(area, ())

    def _by_instance(self, values, shape: tuple[int, ...]) -> list[np.ndarray]:
        """Numbers of rows of splats as those of each instance's Gaussians; 0 for those that are not drawn."""
        found = []
        for size, pieces in zip(self.sizes, self.splats.runs, strict=True):
            out = np.zeros((size, *shape), np.float32)
            for first, number in pieces:
                rows = slice(first, first + number)
                out[self.splats.source[rows]] = values(rows)
            found.append(out)
        return found


def light(instances, camera) -> Light:
    """SelectingBackend.light()."""
    announce()
    splats = project_instances(instances, camera, Layout(instances, False))
    _, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels, camera)
    return Light(splats, state, tuple(len(instance.model) for instance in instances))


def contributing(instances, camera) -> list[tuple[np.ndarray, np.ndarray]]:
    """PictureBackend.contributing(): where pictures are large, looked at through fewer pixels, in which splats are a little wider."""
    by, wider = (COARSE, WIDER) if max(camera.width, camera.height) > SMALL else (1, 1.0)
    coarse = camera.stretched(*(-(-side // by) for side in (camera.width, camera.height)))
    shown = BESIDE - 1, BESIDE - 1, coarse.width + 2, coarse.height + 2  # one more to each side: splats reach in
    width, height = coarse.width + 2 * BESIDE, coarse.height + 2 * BESIDE
    coarse = replace(coarse, width=width, height=height, cx=coarse.cx + BESIDE, cy=coarse.cy + BESIDE, window=(0, 0, width, height))
    drawn = []
    for each in instances:
        model, own = without_colours(each.model), each.model.raster
        drawn.append(replace(each, camera=coarse, model=replace(model, raster=replace(own, blur=own.blur * wider / by**2))))
    splats = project_instances(drawn, coarse, Layout(drawn, False))
    _, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels,
                                 replace(coarse, window=shown))
    marks = np.zeros(len(splats.source), np.bool_)
    for first, last in state.listing.bands(ENTRIES):
        lists = state.lists or list_tiles(state.listing.segments, state.listing.counts, first, last)
        rest = (*state.listing.frame, *lists, splats.geometry, splats.attributes, state.trace, marks)
        run(lambda a, b, first=first, rest=rest: mark(first + a, first + b, *rest), ranges(last - first, TILES))
    found = []
    for pieces in splats.runs:
        rows = np.concatenate([np.arange(first, first + number) for first, number in pieces] or [np.zeros(0, int)])
        found.append((splats.source[rows].astype(np.int64), marks[rows]))
    return found


@kernel
def mark(first, last, columns, x0, y0, right, bottom, tile_x, tile_y, starts, ids, geometry, attributes, trace, marks):
    """Mark the splats of the tiles first..last before which light is left in a pixel of theirs, as a trace (raster.rasteriser) tells."""
    for tile in range(first, last):
        left, top = (tile_x + tile % columns) * raster.TILE, (tile_y + tile // columns) * raster.TILE
        west, east, north, south = max(left, x0), min(left + raster.TILE, right), max(top, y0), min(top + raster.TILE, bottom)
        deepest = -1.0
        for y in range(north, south):
            for x in range(west, east):
                deepest = max(deepest, trace[y - y0, x - 2 * x0 + right])
        for k in range(min(starts[tile + 1] - starts[tile], int(deepest) + 1)):
            i = ids[starts[tile] + k]
            if marks[i]:
                continue
            mx, my, rx, ry = (geometry[i, raster.MEAN_X] - 0.5, geometry[i, raster.MEAN_Y] - 0.5, attributes[i, raster.RADIUS_X],
                              attributes[i, raster.RADIUS_Y])
            y, low, high = max(north, math.ceil(my - ry)), max(west, math.ceil(mx - rx)), min(east, math.floor(mx + rx) + 1)
            while y < min(south, math.floor(my + ry) + 1) and not marks[i]:
                for x in range(low, high):
                    if trace[y - y0, x - 2 * x0 + right] >= k:
                        marks[i] = True  # never False, which could undo what another thread writes for another tile
                y += 1
