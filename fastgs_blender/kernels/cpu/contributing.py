# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians a picture shows: those that are not behind what blocks all light, in any of the pixels that they touch."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.appearance import RGB
from ...rendering.layout import Layout
from ...util.threads import ranges, run
from . import raster
from .jit import kernel
from .rasterise import rasterise_forward
from .splats import project_instances

SMALL, COARSE = 400, 2
"""Pictures with a longer side than this are looked at through one pixel for each COARSE x COARSE."""
WIDER = 2.0
"""Factor to the blur of splats there: with 4 those smaller than a pixel hide too much, with 1 they fall between the pixels."""
BLOCK = 4
"""Pixels of the side of the squares of which the farthest depth is known."""
SLACK = 0.5
"""Radii by which a splat may lie behind what is shown: in another pixel it may come before that."""
CHUNK = 16_384


def contributing(instances, camera) -> list[np.ndarray]:
    """PictureBackend.contributing(): where pictures are large, looked at through fewer pixels, in which splats are a little wider."""
    by, wider = (COARSE, WIDER) if max(camera.width, camera.height) > SMALL else (1, 1.0)
    coarse = camera.stretched(*(-(-side // by) for side in (camera.width, camera.height)))
    width, height = coarse.width + 2, coarse.height + 2  # one more to each side: splats reach in
    coarse = replace(coarse, width=width, height=height, cx=coarse.cx + 1, cy=coarse.cy + 1, window=(0, 0, width, height))
    drawn = []
    for each in instances:
        model, own = each.model, replace(each.model.raster, blur=each.model.raster.blur * wider / by**2)
        model = replace(model, raster=own, appearance=RGB(), features=np.zeros((len(model), 3), np.float32))
        drawn.append(replace(each, camera=coarse, model=model))
    splats = project_instances(drawn, coarse, Layout(drawn, False))
    _, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels, coarse)
    marks = np.ones(len(splats.geometry), np.bool_)
    if state.lists is not None:  # else there are so many that they were listed in bands
        marks[:] = False
        _mark(splats, state, coarse, marks)
    found = [np.zeros(len(each.model), bool) for each in drawn]
    for shown, pieces in zip(found, splats.runs, strict=True):
        for first, number in pieces:
            shown[splats.source[first:first + number]] = marks[first:first + number]
    return found


def _mark(splats, state, camera, marks: np.ndarray) -> None:
    """Mark those splats that a camera's picture may show."""
    width, height = camera.width, camera.height
    unit = (-1 if camera.orthographic else 1) / min(camera.fx, camera.fy)
    farthest = np.full((-(-height // BLOCK), -(-width // BLOCK)), -np.inf, np.float32)
    grid, tiles = state.listing.grid, state.listing.grid[2] * state.listing.grid[3]
    rest = (grid[2], width, height, *state.lists, splats.attributes, state.trace, farthest)
    run(lambda a, b: ends(a, b, *rest), ranges(tiles, 64))
    rest = (splats.index, splats.geometry, splats.attributes, farthest, unit, marks)
    run(lambda a, b: mark(a, b, *rest), ranges(len(splats.index), CHUNK))


@kernel
def ends(first, last, columns, width, height, starts, ids, attributes, trace, farthest):
    """Into farthest [rows, columns of blocks] the depth of the last splat that any pixel of a block shows, of the tiles first..last;
    trace: of raster.rasteriser."""
    for tile in range(first, last):
        left, top = tile % columns * raster.TILE, tile // columns * raster.TILE
        for y in range(top, min(top + raster.TILE, height)):
            for x in range(left, min(left + raster.TILE, width)):
                if trace[y, width + x] >= 0:
                    depth = attributes[ids[starts[tile] + np.int64(trace[y, width + x])], raster.DEPTH]
                    farthest[y // BLOCK, x // BLOCK] = max(farthest[y // BLOCK, x // BLOCK], depth)


@kernel
def mark(first, last, index, geometry, attributes, farthest, unit, marks):
    """Mark those of the splats index[first..last] that are not behind all that is shown where they are by more than a half of their size;
    unit: the size of a pixel at depth 1; of an orthographic picture the negative of a pixel's size."""
    rows, columns = farthest.shape
    for k in range(first, last):
        i = index[k]
        x, y, depth = geometry[i, raster.MEAN_X], geometry[i, raster.MEAN_Y], attributes[i, raster.DEPTH]
        rx, ry = attributes[i, raster.RADIUS_X], attributes[i, raster.RADIUS_Y]
        depth -= SLACK * max(rx, ry) * (-unit if unit < 0.0 else unit * depth)
        low, high = np.int64(max(x - rx, 0.0)) // BLOCK, np.int64(max(x + rx, 0.0)) // BLOCK
        for row in range(np.int64(max(y - ry, 0.0)) // BLOCK, min(np.int64(max(y + ry, 0.0)) // BLOCK, rows - 1) + 1):
            for column in range(low, min(high, columns - 1) + 1):
                if depth <= farthest[row, column]:
                    marks[i] = True
                    break
            if marks[i]:
                break
