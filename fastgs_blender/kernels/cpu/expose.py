# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures (rendering/exposure.py), with no more samples in each tile than what moves there needs.

Each tile uses as many as paths.py finds; a sample draws only the tiles that use it, with only the Gaussians that touch these.  Where all
samples that are allowed do not suffice, splats are drawn out over the gaps, so that there is a streak and no row of copies.
"""
from __future__ import annotations

import math

import numpy as np
from numba import float32

from ...rendering import colour
from ...rendering.exposure import Exposure, Film
from ...rendering.layout import Exposed, Layout
from ...rendering.quantities import shares
from ...util.threads import portions, run
from . import raster
from .decoder import decoder_of
from .jit import kernel
from .paths import Paths, Snapshot, levels_of, measure, touch
from .project import SCALE
from .rasterise import rasterise
from .splats import ProjectedSplats, project_instances

TILE = raster.TILE
WHOLE = 0.6
"""Share of the Gaussians beyond which all are drawn: picking some costs time, too."""
PIECE = 256
"""Tiles whose light is added up in one piece of work."""
TABLE = colour.srgb_to_linear(np.linspace(0, 1, 4097)).astype(np.float32)
"""The sRGB curve, to 1e-7 with straight lines between."""


def expose(exposure: Exposure, instances, camera, colours: bool, colour_of, progress, holdout=None, objects=(), by_pixel=False):
    """PictureBackend.expose(); colour_of is the backend's colour()."""
    x0, y0, width, height = camera.window
    film = Film(height, width, {instance.model.colour_space for instance in instances}, len(objects))
    if not exposure.moves:
        instances = [instance.frozen() for instance in instances]
    paths = measure(exposure, instances, camera, _snapshot)
    left, top = x0 // TILE, y0 // TILE
    grid = left, top, (x0 + width - 1) // TILE - left + 1, (y0 + height - 1) // TILE - top + 1
    levels = levels_of(exposure, paths, camera, holdout, grid)
    samples = exposure.samples(int(levels.max()))
    picked = {0: (instances, np.arange(len(paths.box)))}
    for i, sample in enumerate(samples):
        if sample.level not in picked:
            touching = np.zeros(len(paths.box), bool)
            touch(paths.box, levels >= sample.level, *grid, touching)
            picked[sample.level] = _picked(instances, touching)
        shown, keep = picked[sample.level]
        moved, eye = exposure.scene(shown, camera, sample.time, sample.point)
        layout = Layout(moved, False, {"shares": shares(moved, objects)} if objects else None, holdout is not None, by_pixel)
        splats = project_instances(moved, eye, layout)
        if len(samples) > 1:
            _draw_out(splats, keep[_gaussians(splats, moved)], paths, len(samples) - 1)
        weights = np.array(sample.weights, np.float32)[levels]
        hidden_by = exposure.holdout(holdout, sample.time)
        picture = rasterise(splats.order(), splats.geometry, splats.attributes, splats.channels, eye, wanted=weights > 0, holdout=hidden_by,
                            plane=layout.plane, by_pixel=by_pixel, decode=decoder_of(layout, eye) if colours else None)
        buffers = picture.buffers(layout)
        rgb = colour_of(buffers, layout, eye) if colours and moved else None
        if objects:
            film.shares += _of_pixels(weights, grid, camera.window)[..., None] * buffers.sums["shares"]
        _collect(film, rgb, picture.alpha, picture.held, weights, grid, camera.window)
        progress((i + 1) / len(samples))
    rgb, alpha = film.picture()
    return Exposed(rgb if colours else None, alpha, None if holdout is None else film.held, film.shares if objects else None)


def _snapshot(moved, eye, total: int) -> Snapshot:
    """The Snapshot of all Gaussians of a scene."""
    splats, look = project_instances(moved, eye, Layout(moved, False)), Snapshot.nothing(total)
    at, rows = _gaussians(splats, moved), splats.index
    look.seen[at], look.mean[at], look.root[at] = True, splats.geometry[rows, :2], splats.geometry[rows, raster.L11:] / SCALE
    look.size[at] = splats.attributes[rows, raster.RADIUS_X:raster.RADIUS_Y + 1]
    look.opacity[at] = np.exp2(splats.attributes[rows, raster.LOG2_OPACITY])
    return look


def _gaussians(splats: ProjectedSplats, instances) -> np.ndarray:
    """Which Gaussian, counted through all instances, each row of splats.index is."""
    counts, sizes = [sum(number for _, number in pieces) for pieces in splats.runs], [len(each.model) for each in instances]
    return splats.source[splats.index] + np.repeat(np.cumsum([0, *sizes[:-1]])[:len(sizes)], counts)


def _picked(instances, touching):
    """The instances with those Gaussians only that are marked, and which these are, counted through all."""
    if touching.sum() > WHOLE * len(touching) or not len(touching):
        return instances, np.arange(len(touching))
    out, keep, done = [], [], 0
    for instance in instances:
        index = np.flatnonzero(touching[done:done + len(instance.model)])
        if len(index):
            out.append(instance.part(index))
            keep.append(done + index)
        done += len(instance.model)
    return out, np.concatenate(keep) if keep else np.empty(0, np.int64)


def _draw_out(splats: ProjectedSplats, at: np.ndarray, paths: Paths, count: int):
    """Widen the splats that move too far between two samples along their way, or all around where the lens spreads them; their optical
    depth spreads with them, so that what is opaque stays so."""
    rest = splats.index, at, paths.needed, paths.shift, paths.blur, count, splats.geometry, splats.attributes
    run(lambda first, last: draw_out(first, last, *rest), portions(len(splats.index)))


@kernel
def draw_out(first, last, index, at, needed, shift, blur, count, geometry, attributes):
    """_draw_out() of the splats index[first:last], which are the Gaussians at[first:last] of the paths."""
    for k in range(first, last):
        i, n = index[k], at[k]
        if not needed[n] > 1.5 * count:
            continue
        x, y, gap = np.float64(shift[n, 0]) / count, np.float64(shift[n, 1]) / count, np.float64(blur[n]) ** 2 / count
        l11, l21, l22 = geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
        s11 = (SCALE / l22) ** 2
        s01 = -l21 / l11 * s11
        det = s11 * (SCALE / l11) ** 2
        s00 = (det + s01**2) / s11 + x * x / 6 + gap / 3
        s01, s11 = s01 + x * y / 6, s11 + y * y / 6 + gap / 3
        wider = s00 * s11 - s01**2
        opacity = min(2.0 ** np.float64(attributes[i, raster.LOG2_OPACITY]), np.float64(attributes[i, raster.ALPHA_MAX]))
        cut = np.float64(attributes[i, raster.LOG2_CUT])
        log2 = max(math.log2(-math.expm1(math.log1p(-opacity) * math.sqrt(det / wider))), cut)
        reach = 2 * math.log(2.0) * (log2 - cut)
        geometry[i, raster.L11] = SCALE * math.sqrt(s11 / wider)
        geometry[i, raster.L21] = -SCALE * s01 / math.sqrt(s11 * wider)
        geometry[i, raster.L22] = SCALE / math.sqrt(s11)
        attributes[i, raster.LOG2_OPACITY] = log2
        attributes[i, raster.RADIUS_X] = math.sqrt(reach * s00) + 1e-3
        attributes[i, raster.RADIUS_Y] = math.sqrt(reach * s11) + 1e-3


def _of_pixels(tiles: np.ndarray, grid, window) -> np.ndarray:
    """The numbers of the tiles [tiles], repeated for each of their pixels [h, w]."""
    (left, top, columns, _), (x0, y0, width, height) = grid, window
    row, column = np.arange(y0, y0 + height) // TILE - top, np.arange(x0, x0 + width) // TILE - left
    return tiles.reshape(-1, columns)[row[:, None], column]


def _collect(film: Film, rgb, alpha, held, weights, grid, window):
    """Add a picture to the film, each tile with its weight."""
    colours = rgb is not None
    rest = (weights, *grid[:3], *window, rgb if colours else np.zeros((0, 0, 3), np.float32), alpha, film.encoded, colours, TABLE,
            film.rgb, film.alpha, np.zeros((0, 0), np.float32) if held is None else np.ascontiguousarray(held), film.held)
    run(lambda first, last: collect(first, last, *rest), portions(len(weights), PIECE, PIECE // 8))


@kernel
def collect(first, last, weights, left, top, columns, x0, y0, width, height, rgb, alpha, encoded, colours, table, out, out_alpha, held,
            out_held):
    """Add the tiles first..last of a picture, in light, times weights [tiles]; encoded: the picture is in sRGB."""
    ends = float32(len(table) - 1)
    for tile in range(first, last):
        weight = weights[tile]
        if not weight > float32(0.0):
            continue
        begin_x, begin_y = (left + tile % columns) * TILE - x0, (top + tile // columns) * TILE - y0
        for y in range(max(begin_y, 0), min(begin_y + TILE, height)):
            for x in range(max(begin_x, 0), min(begin_x + TILE, width)):
                a = alpha[y, x]
                out_alpha[y, x] += weight * a
                if len(held):
                    out_held[y, x] += weight * held[y, x]
                if not colours or not a > float32(0.0):
                    continue
                inverse = float32(1.0) / a
                for c in range(3):
                    value = rgb[y, x, c]
                    if encoded:
                        straight = value * inverse
                        if straight >= float32(0.0) and straight < float32(1.0):
                            at = straight * ends
                            i = int(at)
                            value = (table[i] + (at - float32(i)) * (table[i + 1] - table[i])) * a
                        else:
                            size = abs(straight)
                            high = float32(math.pow((size + 0.055) / 1.055, 2.4)) if size > float32(0.04045) else size / float32(12.92)
                            value = math.copysign(high, straight) * a
                    out[y, x, c] += weight * value
