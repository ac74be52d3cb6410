# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposures (rendering/exposure.py), with no more samples in each tile than what moves there needs.

A few pictures' splats, at the beginning, the middle and the end of the exposure and through the rim of the lens, tell how far each
moves over the tiles it touches, in units of its own size.  Each tile uses the samples up to the level at which nothing in it moves by
more than STEP from one sample to the next; a sample draws only the tiles that use it, with only the Gaussians that touch these.  Where
all samples that are allowed do not suffice, splats are drawn out over the gaps, so that there is a streak and no row of copies.
"""
from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numba import float32

from ...model.slicing import slice_model, still
from ...rendering import colour
from ...rendering.exposure import Exposure, Film
from ...rendering.layout import Layout
from ...rendering.quantities import shares
from ...util.threads import run
from . import raster
from .jit import inline, kernel
from .project import SCALE
from .rasterise import rasterise
from .splats import ProjectedSplats, project_instances

TILE = raster.TILE
STEP = 1.5
"""Standard deviations by which a splat may move from one sample to the next: a sum of Gaussians so far apart is even to 3e-4."""
ENDS = 4.0
"""Steps for a path of one standard deviation, growing with its root: the sum then has the streak's ends to 3e-3."""
STILL = 0.2
"""Standard deviations of movement up to which the middle of the exposure stands for all of it."""
SHARP = 16.0
"""Samples by square pixel of its blur (radius squared) that make the edge of a mesh, which is sharper than any splat, even to 0.02."""
FADE = 4.0
"""Standard deviations to whose movement a change of opacity from 0 to 1 is equal."""
FAINT = 0.05
"""Opacity below which it does not matter that a splat comes into the picture, or leaves it, while the shutter is open."""
WHOLE = 0.6
"""Share of the Gaussians beyond which all are drawn: picking some costs time, too."""
TABLE = colour.srgb_to_linear(np.linspace(0, 1, 4097)).astype(np.float32)
"""The sRGB curve, to 1e-7 with straight lines between."""


@dataclass(frozen=True, eq=False)
class Paths:
    """The paths of the G Gaussians of all instances during an exposure.

    box     [G, 4] float32: left, top, right, bottom of what its splat covers; right < left where it is never seen
    shift   [G, 2] float32: how far it moves while the shutter is open, in pixels
    blur    [G] float32: radius of the disc over which the lens spreads it, in pixels
    needed  [G] float32: into how many steps the exposure should be divided for it; inf: not known
    """

    box: np.ndarray
    shift: np.ndarray
    blur: np.ndarray
    needed: np.ndarray


def expose(exposure: Exposure, instances, camera, colours: bool, colour_of, progress, holdout=None, objects=(), by_pixel=False):
    """PictureBackend.expose(); colour_of is the backend's colour()."""
    x0, y0, width, height = camera.window
    film = Film(height, width, {instance.model.colour_space for instance in instances}, len(objects))
    if not exposure.moves:
        instances = [_frozen(instance) for instance in instances]
    paths = _paths(exposure, instances, camera)
    left, top = x0 // TILE, y0 // TILE
    grid = left, top, (x0 + width - 1) // TILE - left + 1, (y0 + height - 1) // TILE - top + 1
    levels = np.zeros(grid[2] * grid[3], np.int32)
    for box, needed in [(paths.box, paths.needed)] + ([] if holdout is None else [_edges(exposure, holdout, camera)]):
        paint(box, np.ceil(np.log2(np.clip(needed, 1, 1 << exposure.levels))).astype(np.int32), *grid, levels)
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
            _draw_out(splats, keep, paths, len(samples) - 1)
        weights = np.array(sample.weights, np.float32)[levels]
        runs = _runs(weights > 0)
        hidden_by = exposure.holdout(holdout, sample.time)
        picture = rasterise(splats.order(), splats.geometry, splats.attributes, splats.channels, eye, tiles=runs, holdout=hidden_by,
                            plane=layout.plane, by_pixel=by_pixel)
        buffers = picture.buffers(layout)
        rgb = colour_of(buffers, layout, eye) if colours and moved else None
        if objects:
            film.shares += _of_pixels(weights, grid, camera.window)[..., None] * buffers.sums["shares"]
        _collect(film, rgb, picture.alpha, picture.held, weights, runs, grid, camera.window)
        progress((i + 1) / len(samples))
    rgb, alpha = film.picture()
    return (rgb if colours else None), alpha, None if holdout is None else film.held, film.shares if objects else None


def _snapshot_places(exposure: Exposure) -> tuple[list, list]:
    """(time, point of the lens) of the few snapshots from which paths are measured: over the exposure through the middle of the lens,
    and through two points of its rim."""
    lens = exposure.aperture
    return ([(t, (0.0, 0.0)) for t in ((0.0, 0.5, 1.0) if exposure.moves else (0.5,))],
            [(0.5, (lens.radius / lens.ratio, 0.0)), (0.5, (0.0, lens.radius))] if lens else [])


def _edges(exposure: Exposure, holdout, camera) -> tuple[np.ndarray, np.ndarray]:
    """Of the triangles of a holdout, as of splats: the boxes [T, 4] that they touch, and into how many steps [T] each needs the exposure
    divided; a step is about a pixel, over which an edge is soft anyway."""
    times, rim = _snapshot_places(exposure)
    corners = []
    for time, point in times + rim:
        eye, triangles = exposure.scene([], camera, time, point)[1], exposure.holdout(holdout, time)
        triangles = np.zeros((0, 3, 3)) if triangles is None else triangles
        view = triangles @ eye.world_to_camera[:3, :3].T + eye.world_to_camera[:3, 3]
        corners.append(eye.pixels(np.where(view[..., 2:] > eye.near, view, np.nan)))
    if len({found.shape for found in corners}) > 1:  # other triangles at another time
        corners = [np.concatenate(corners)]
        needed = np.full(len(corners[0]), np.inf, np.float32)
    else:
        path = sum((np.linalg.norm(b - a, axis=-1).max(-1, initial=0) for a, b in itertools.pairwise(corners[:len(times)])),
                   np.zeros(len(corners[0])))
        middle = corners[len(times) // 2]
        blur = np.max([np.linalg.norm(found - middle, axis=-1).max(-1, initial=0) for found in corners[len(times):]] or [0 * path], 0)
        needed = np.maximum(_steps(path, path / STEP), _steps(2 * blur, SHARP * blur**2))
    box = np.concatenate([np.min(corners, (0, 2)), np.max(corners, (0, 2))], -1)
    return np.where(np.isnan(box), [-1e6, -1e6, 1e6, 1e6], box).astype(np.float32), np.where(np.isnan(needed), np.inf, needed)


def _frozen(instance):
    """The instance with its model sliced at its time, for instances that do not move."""
    now = slice_model(instance.model, instance.t)
    return replace(instance.part(now.index, still(instance.model, now)), t=0.0)


def _paths(exposure: Exposure, instances, camera) -> Paths:
    """The Paths of all Gaussians, measured from a few snapshots."""
    times, rim = _snapshot_places(exposure)
    total = sum(len(instance.model) for instance in instances)
    looks = [_Snapshot(exposure, instances, camera, *each, total) for each in times + rim]
    middle = looks[len(times) // 2]
    low, high = np.full((total, 2), np.inf, np.float32), np.full((total, 2), -np.inf, np.float32)
    for look in looks:
        low[look.seen] = np.minimum(low, look.mean - look.size)[look.seen]
        high[look.seen] = np.maximum(high, look.mean + look.size)[look.seen]
    path, blur, area = (np.zeros(total, np.float32) for _ in range(3))
    for a, b in itertools.pairwise(looks[:len(times)]):
        path += a.way_to(b, b.mean - a.mean)
    for look in looks[len(times):]:
        shift = look.mean - middle.mean
        blur = np.maximum(blur, np.where(look.seen & middle.seen, np.linalg.norm(shift, axis=1), 0))
        area = np.maximum(area, middle.way_to(look, shift))
    first, last = looks[0], looks[len(times) - 1]
    shift = np.where((first.seen & last.seen)[:, None], last.mean - first.mean, 0)
    reach = (1.1 * blur + 1)[:, None]
    needed = np.maximum(_steps(path, path / STEP), _steps(2 * area, 3 * area**2))
    return Paths(np.concatenate([low - reach, high + reach], 1), shift, blur, needed)


def _steps(path: np.ndarray, even: np.ndarray) -> np.ndarray:
    """Into how many steps an exposure should be divided for paths of this length, of which so many make an even streak."""
    return np.where(path > STILL, np.maximum(even, ENDS * np.sqrt(path)), 1)


class _Snapshot:
    """The splats of all Gaussians at one time and through one point of the lens: whether each is seen, and its place, size and opacity."""

    def __init__(self, exposure, instances, camera, time, point, total):
        moved, eye = exposure.scene(instances, camera, time, point)
        splats = project_instances(moved, eye, Layout(moved, False))
        at, rows = _gaussians(splats), splats.index
        self.seen, self.mean, self.size = np.zeros(total, bool), np.zeros((total, 2), np.float32), np.zeros((total, 2), np.float32)
        self.root, self.opacity = np.zeros((total, 3), np.float32), np.zeros(total, np.float32)
        self.seen[at], self.mean[at], self.root[at] = True, splats.geometry[rows, :2], splats.geometry[rows, raster.L11:] / SCALE
        self.size[at] = splats.attributes[rows, raster.RADIUS_X:raster.RADIUS_Y + 1]
        self.opacity[at] = np.exp2(splats.attributes[rows, raster.LOG2_OPACITY])

    def way_to(self, other: _Snapshot, shift) -> np.ndarray:
        """How far [G] it is from this look to another, in standard deviations: movement, change of size, and of opacity."""
        a, b = (np.hypot(look.root[:, 0] * shift[:, 0] + look.root[:, 1] * shift[:, 1], look.root[:, 2] * shift[:, 1])
                for look in (self, other))
        size = 3 * np.abs(np.log(np.where(self.seen & other.seen, np.divide(
            other.size.T, self.size.T, out=np.ones_like(self.size.T), where=self.size.T > 0), 1))).max(0)
        both = np.maximum(a, b) + size + FADE * np.abs(other.opacity - self.opacity)
        alone = (self.seen ^ other.seen) & (np.maximum(self.opacity, other.opacity) > FAINT)
        return np.where(self.seen & other.seen, both, np.where(alone, np.inf, 0)).astype(np.float32)


def _gaussians(splats: ProjectedSplats) -> np.ndarray:
    """Which Gaussian, counted through all instances, each row that was written is."""
    parts, offset = [], 0
    for pieces in splats.runs:
        begin = pieces[0][0] if pieces else 0
        parts += [begin + splats.source[first:first + number] for first, number in pieces]
        offset = begin
    return np.concatenate(parts) if parts else np.empty(offset, np.int32)


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


def _draw_out(splats: ProjectedSplats, keep: np.ndarray, paths: Paths, count: int):
    """Widen the splats that move too far between two samples along their way, or all around where the lens spreads them; their optical
    depth spreads with them, so that what is opaque stays so."""
    at = keep[_gaussians(splats)]
    wide = paths.needed[at] > 1.5 * count
    rows, at = splats.index[wide], at[wide]
    if not len(rows):
        return
    (x, y), gap = paths.shift[at].T.astype(np.float64) / count, paths.blur[at].astype(np.float64) ** 2 / count
    l11, l21, l22 = splats.geometry[rows, raster.L11:].T
    s11 = (SCALE / l22) ** 2
    s01 = -l21 / l11 * s11
    det = s11 * (SCALE / l11) ** 2
    s00 = (det + s01**2) / s11 + x * x / 6 + gap / 3
    s01, s11 = s01 + x * y / 6, s11 + y * y / 6 + gap / 3
    wider = s00 * s11 - s01**2
    opacity = np.exp2(splats.attributes[rows, raster.LOG2_OPACITY].astype(np.float64))
    opacity = np.minimum(opacity, splats.attributes[rows, raster.ALPHA_MAX])
    cut = splats.attributes[rows, raster.LOG2_CUT].astype(np.float64)
    log2 = np.maximum(np.log2(-np.expm1(np.log1p(-opacity) * np.sqrt(det / wider))), cut)
    reach = 2 * np.log(2) * (log2 - cut)
    splats.geometry[rows, raster.L11] = SCALE * np.sqrt(s11 / wider)
    splats.geometry[rows, raster.L21] = -SCALE * s01 / np.sqrt(s11 * wider)
    splats.geometry[rows, raster.L22] = SCALE / np.sqrt(s11)
    splats.attributes[rows, raster.LOG2_OPACITY] = log2
    splats.attributes[rows, raster.RADIUS_X] = np.sqrt(reach * s00) + 1e-3
    splats.attributes[rows, raster.RADIUS_Y] = np.sqrt(reach * s11) + 1e-3


def _runs(active: np.ndarray) -> list[tuple[int, int]]:
    """(first, last) of the runs of tiles that are marked."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _of_pixels(tiles: np.ndarray, grid, window) -> np.ndarray:
    """The numbers of the tiles [tiles], repeated for each of their pixels [h, w]."""
    (left, top, columns, _), (x0, y0, width, height) = grid, window
    row, column = np.arange(y0, y0 + height) // TILE - top, np.arange(x0, x0 + width) // TILE - left
    return tiles.reshape(-1, columns)[row[:, None], column]


def _collect(film: Film, rgb, alpha, held, weights, runs, grid, window):
    """Add a picture to the film, each tile with its weight."""
    colours = rgb is not None
    rest = (weights, *grid[:3], *window, rgb if colours else np.zeros((0, 0, 3), np.float32), alpha, film.encoded, colours, TABLE,
            film.rgb, film.alpha, np.zeros((0, 0), np.float32) if held is None else np.ascontiguousarray(held), film.held)
    run(lambda first, last: collect(first, last, *rest), [(a, b) for first, last in runs for a, b in _pieces(first, last)])


def _pieces(first: int, last: int) -> list[tuple[int, int]]:
    return [(a, min(a + 128, last)) for a in range(first, last, 128)]


@kernel
def collect(first, last, weights, left, top, columns, x0, y0, width, height, rgb, alpha, encoded, colours, table, out, out_alpha, held,
            out_held):
    """Add the tiles first..last of a picture, in light, times weights [tiles]; encoded: the picture is in sRGB."""
    ends = float32(len(table) - 1)
    for tile in range(first, last):
        weight = weights[tile]
        begin_x, begin_y = (left + tile % columns) * TILE - x0, (top + tile // columns) * TILE - y0
        for y in range(max(begin_y, 0), min(begin_y + TILE, height)):
            for x in range(max(begin_x, 0), min(begin_x + TILE, width)):
                a = alpha[y, x]
                out_alpha[y, x] += weight * a
                if len(held):
                    out_held[y, x] += weight * held[y, x]
                if not colours or not a > float32(0.0):
                    continue
                for c in range(3):
                    value = rgb[y, x, c]
                    if encoded:
                        straight = value / a
                        if straight >= float32(0.0) and straight < float32(1.0):
                            at = straight * ends
                            i = int(at)
                            value = (table[i] + (at - float32(i)) * (table[i + 1] - table[i])) * a
                        else:
                            size = abs(straight)
                            high = float32(math.pow((size + 0.055) / 1.055, 2.4)) if size > float32(0.04045) else size / float32(12.92)
                            value = math.copysign(high, straight) * a
                    out[y, x, c] += weight * value


@inline
def _tiles(boxes, i, left, top, columns, rows):
    """First and last column, first and last row of the tiles that a box touches."""
    return (max(int(max(boxes[i, 0], -1e6)) // TILE - left, 0), min(int(min(boxes[i, 2], 1e6)) // TILE - left, columns - 1),
            max(int(max(boxes[i, 1], -1e6)) // TILE - top, 0), min(int(min(boxes[i, 3], 1e6)) // TILE - top, rows - 1))


@kernel
def paint(boxes, levels, left, top, columns, rows, out):
    """Raise out [tiles] to the level of each box that touches a tile."""
    for i in range(len(boxes)):
        if not boxes[i, 0] <= boxes[i, 2]:
            continue
        first, last, upper, lower = _tiles(boxes, i, left, top, columns, rows)
        for row in range(upper, lower + 1):
            for tile in range(row * columns + first, row * columns + last + 1):
                out[tile] = max(out[tile], levels[i])


@kernel
def touch(boxes, active, left, top, columns, rows, out):
    """Mark the boxes that touch a marked tile."""
    for i in range(len(boxes)):
        if not boxes[i, 0] <= boxes[i, 2]:
            continue
        first, last, upper, lower = _tiles(boxes, i, left, top, columns, rows)
        for row in range(upper, lower + 1):
            for tile in range(row * columns + first, row * columns + last + 1):
                out[i] |= active[tile]
