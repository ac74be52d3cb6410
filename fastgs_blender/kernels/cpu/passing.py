# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light from a camera's place comes to points: past splats, and past triangles (rendering/passing.py).

Splats and triangles are listed by tile, as for a picture; the points of a tile ask its list alone.
"""
from __future__ import annotations

import numpy as np
from numba import float32

from ...rendering.holdout import EDGE
from ...rendering.layout import Layout
from ...rendering.passing import BEHIND
from ...util.threads import ranges, run, thread_count
from .. import asserts
from . import raster
from .holdout import Occluder
from .jit import inline, kernel
from .rasterise import ENTRIES, TILES
from .sort import order_by
from .splats import project_instances
from .tile_lists import TileLists, list_tiles

TILE = 64
"""Pixels of a tile's side: large splats, which stand near a lamp, are in few lists."""
PART = 8
"""Pixels of the side of the squares by which a tile's points are sorted, so that those side by side ask for much the same splats."""
PARTS = (TILE // PART) ** 2
CHUNK = 16_384
"""Points in one piece of work."""
BATCH = 8
"""Points of a tile that go past its splats together, of neighbouring depths."""
LAYERS = 2047
"""By which points are sorted: what is sorted has as many bits as one pass takes."""
DARK = 1e-3
"""Share of the light at which it counts as stopped."""
EXP2 = (0.999999945, 0.693143204, 0.240179499, 0.0552996223, 0.00921088407, 0.00094755432)
"""2^x for x in -1..0 as a polynomial, to 1e-6."""


def past_splats(instances, camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """PictureBackend.past_splats()."""
    asserts.past_splats(points, over)
    layout, out = Layout(instances, False, plane=True), np.ones(len(points), np.float32)
    splats = project_instances(instances, camera, layout)
    listing = TileLists.of(splats.order(), splats.geometry, splats.attributes, camera, TILE)
    seen, begins, asked = _by_tile(listing.grid, TILE, camera, points, over)
    for first, last in listing.bands(ENTRIES):
        lists = list_tiles(listing.segments, listing.counts, first, last)
        plane = raster.CHANNEL + layout.places["plane"].start
        rest = (*listing.grid[:3], *lists, splats.geometry, splats.attributes, plane, begins, asked, seen, camera.width / 2,
                camera.height / 2, out)
        run(lambda a, b, first=first, rest=rest: transmitted(first + a, first + b, *rest), _pieces(last - first, 1))
    return out


def past_triangles(triangles, camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """PictureBackend.past_triangles()."""
    asserts.past_splats(points, over)
    occluder = Occluder.of(triangles, camera)
    seen, begins, asked = _by_tile(occluder.listing.grid, raster.TILE, camera, points, over, False)
    out = np.ones(len(points), np.float32)
    rest = (*occluder.lists, occluder.screen, bool(occluder.orthographic), begins, asked, seen, out)
    run(lambda a, b: open_ways(a, b, *rest), _pieces(len(begins) - 1))
    return out


def _pieces(tiles: int, least: int = TILES) -> list[tuple[int, int]]:
    """A number of tiles in pieces of work: few, because there are many such pictures, and they are small."""
    return ranges(tiles, max(least, -(-tiles // (4 * thread_count()))))


def _by_tile(grid, size: int, camera, points: np.ndarray, over: np.ndarray, by_depth: bool = True):
    """Points by part of tiles: x and y in pixels and the depth that counts of each [P, 3], where each part's points begin in a list of
    their indices, [parts + 1], and the list, by about their depth, where that is asked for.

    size: pixels of a tile's side; its parts, one after another, have PART if by_depth.  Points beside the window are in the nearest part,
    those behind the camera in none.
    """
    split = size // PART if by_depth else 1
    seen, part, parts = np.zeros((len(points), 3)), np.empty(len(points), np.int32), split**2
    rest = (points, over, np.ascontiguousarray(camera.world_to_camera[:3]),
            tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)), bool(camera.orthographic), *grid,
            split, size // split, seen, part)
    run(lambda a, b: place(a, b, *rest), ranges(len(points), CHUNK))
    order, depth = np.arange(len(points), dtype=np.int32), seen[:, 2]
    if by_depth:
        low, high = depth.min(), depth.max()
        order = order_by((LAYERS / max(high - low, 1e-30) * (depth - low)).astype(np.uint32).view(np.float32), order)
    return seen, *list_points(order, part, grid[2] * grid[3] * parts)


@kernel
def place(first, last, points, over, view, lens, orthographic, tile_x, tile_y, columns, rows, split, side, seen, part):
    """Where the points first..last are seen, and in which part of which tile, split x split of each, as _by_tile() says; the number after
    the last for those in none."""
    fx, fy, cx, cy = lens
    for p in range(first, last):
        x = view[0, 0] * points[p, 0] + view[0, 1] * points[p, 1] + view[0, 2] * points[p, 2] + view[0, 3]
        y = view[1, 0] * points[p, 0] + view[1, 1] * points[p, 1] + view[1, 2] * points[p, 2] + view[1, 3]
        z = view[2, 0] * points[p, 0] + view[2, 1] * points[p, 1] + view[2, 2] * points[p, 2] + view[2, 3]
        part[p] = columns * rows * split * split
        if not z > BEHIND:
            continue
        unit = 1.0 if orthographic else 1.0 / z
        seen[p, 0], seen[p, 1], seen[p, 2] = fx * x * unit + cx, fy * y * unit + cy, z - over[p]
        column = np.int64(min(max(seen[p, 0] / side - tile_x * split, 0.0), columns * split - 1.0))
        row = np.int64(min(max(seen[p, 1] / side - tile_y * split, 0.0), rows * split - 1.0))
        part[p] = (row // split * columns + column // split) * split * split + row % split * split + column % split


@kernel
def list_points(order, part, parts):
    """A counting sort: where each part's points begin in a list, and the list of the points' indices, in an order."""
    begins = np.zeros(parts + 2, np.int64)
    for p in range(len(part)):
        begins[part[p] + 1] += 1
    for k in range(parts + 1):
        begins[k + 1] += begins[k]
    asked, cursor = np.empty(len(part), np.int32), begins[:-1].copy()
    for p in order:
        asked[cursor[part[p]]] = p
        cursor[part[p]] += 1
    return begins[:-1].copy(), asked


@inline
def exp2(x):
    """2^x for x in -8..0, without a branch."""
    x = x * float32(0.125)
    y = float32(EXP2[5])
    y = y * x + float32(EXP2[4])
    y = y * x + float32(EXP2[3])
    y = y * x + float32(EXP2[2])
    y = y * x + float32(EXP2[1])
    y = y * x + float32(EXP2[0])
    y *= y
    y *= y
    return y * y


@kernel
def transmitted(first, last, tile_x, tile_y, columns, starts, ids, geometry, attributes, plane, begins, asked, seen, middle_x, middle_y,
                out):
    """The transmittance of the splats before each point of the tiles first..last, in out [P]; plane: the first column of their planes."""
    state, box, splat = np.empty((4, BATCH), np.float32), np.empty((4, 0), np.float32), np.empty((0, 12), np.float32)
    near, inside = np.empty(0, np.int32), np.empty(0, np.bool_)
    px, py, limit, light = state[0], state[1], state[2], state[3]
    for tile in range(first, last):
        total = starts[tile + 1] - starts[tile]
        if total == 0 or begins[tile * PARTS] == begins[(tile + 1) * PARTS]:
            continue
        left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
        if len(splat) < total:
            box, splat = np.empty((4, 2 * total), np.float32), np.empty((2 * total, 12), np.float32)
            near, inside = np.empty(2 * total, np.int32), np.empty(2 * total, np.bool_)
        gather(starts[tile], total, ids, geometry, attributes, plane, left, top, left - middle_x, top - middle_y, box, splat)
        for part in range(tile * PARTS, (tile + 1) * PARTS):
            if begins[part] == begins[part + 1]:
                continue
            found = pick(begins[part], begins[part + 1], asked, seen, left, top, total, box, inside, near)
            for begin in range(begins[part], begins[part + 1], BATCH):
                count, farthest = min(BATCH, begins[part + 1] - begin), float32(-np.inf)
                for j in range(BATCH):
                    light[j], px[j], py[j], limit[j] = float32(1.0), float32(0.0), float32(0.0), float32(-np.inf)
                    if j < count:
                        p = asked[begin + j]
                        px[j], py[j], limit[j] = within(seen[p, 0] - left), within(seen[p, 1] - top), seen[p, 2]
                        farthest = max(farthest, limit[j])
                for n in range(found):
                    k = near[n]
                    depth, mx, my, a, b, c = splat[k, 0], splat[k, 1], splat[k, 2], splat[k, 3], splat[k, 4], splat[k, 5]
                    z, slope_x, slope_y, peak, most, cut = splat[k, 6], splat[k, 7], splat[k, 8], splat[k, 9], splat[k, 10], splat[k, 11]
                    if not depth < farthest:
                        break
                    for j in range(BATCH):
                        dx, dy = px[j] - mx, py[j] - my
                        u, v = a * dx + b * dy, c * dy
                        exponent = peak - u * u - v * v
                        before = max(depth, z + slope_x * px[j] + slope_y * py[j])
                        alpha = min(exp2(max(exponent, float32(-8.0))), most)
                        light[j] -= light[j] * (alpha if (exponent >= cut) & (before < limit[j]) else float32(0.0))
                    if n % 8 == 7:
                        brightest = float32(0.0)
                        for j in range(count):
                            brightest = max(brightest, light[j])
                        if brightest < DARK:
                            break
                for j in range(count):
                    out[asked[begin + j]] = light[j]


@inline
def within(x):
    """A coordinate in a tile: its list holds what touches the centres of its pixels, so a point beside them is moved there."""
    return min(max(x, 0.5), TILE - 0.5)


@inline
def pick(begin, end, asked, seen, left, top, total, box, inside, near):
    """Which of a tile's splats reach the box around the points begin..end of a part, into near; returns their number.

    inside [splats] is scratch: what is told first of all of them takes vector instructions.
    """
    west, east, north, south = float32(np.inf), float32(-np.inf), float32(np.inf), float32(-np.inf)
    for q in range(begin, end):
        x, y = float32(within(seen[asked[q], 0] - left)), float32(within(seen[asked[q], 1] - top))
        west, east, north, south = min(west, x), max(east, x), min(north, y), max(south, y)
    for k in range(total):
        inside[k] = (box[0, k] >= west) & (box[1, k] <= east) & (box[2, k] >= north) & (box[3, k] <= south)
    found = 0
    for k in range(total):
        near[found] = k
        found += inside[k]
    return found


@inline
def gather(start, total, ids, geometry, attributes, plane, left, top, from_middle_x, from_middle_y, box, splat):
    """What transmitted() reads of the splats of a tile's list, pixels counted from its corner: the boxes that they fill [4, splats], and
    the rest of each side by side [splats, 12]."""
    for k in range(total):
        i = ids[start + k]
        mx, my = geometry[i, raster.MEAN_X] - left, geometry[i, raster.MEAN_Y] - top
        rx, ry = attributes[i, raster.RADIUS_X], attributes[i, raster.RADIUS_Y]
        box[0, k], box[1, k], box[2, k], box[3, k] = mx + rx, mx - rx, my + ry, my - ry
        splat[k, 0], splat[k, 1], splat[k, 2] = attributes[i, raster.DEPTH], mx, my
        splat[k, 3], splat[k, 4], splat[k, 5] = geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
        slope_x, slope_y = attributes[i, plane + 1], attributes[i, plane + 2]
        splat[k, 6] = attributes[i, plane] + slope_x * from_middle_x + slope_y * from_middle_y
        splat[k, 7], splat[k, 8], splat[k, 9] = slope_x, slope_y, attributes[i, raster.LOG2_OPACITY]
        splat[k, 10], splat[k, 11] = attributes[i, raster.ALPHA_MAX], attributes[i, raster.LOG2_CUT]


@kernel
def open_ways(first, last, starts, ids, screen, orthographic, begins, asked, seen, out):
    """Out [P] is 0 for those points of the tiles first..last before which a triangle lies."""
    box = np.empty((4, 0))
    for tile in range(first, last):
        total = starts[tile + 1] - starts[tile]
        if total == 0 or begins[tile] == begins[tile + 1]:
            continue
        if box.shape[1] < total:
            box = np.empty((4, 2 * total))
        for k in range(total):
            corner = screen[ids[starts[tile] + k]]
            box[0, k] = min(corner[0, 0], corner[1, 0], corner[2, 0]) - 2 * EDGE
            box[1, k] = max(corner[0, 0], corner[1, 0], corner[2, 0]) + 2 * EDGE
            box[2, k] = min(corner[0, 1], corner[1, 1], corner[2, 1]) - 2 * EDGE
            box[3, k] = max(corner[0, 1], corner[1, 1], corner[2, 1]) + 2 * EDGE
        for q in range(begins[tile], begins[tile + 1]):
            p = asked[q]
            x, y, limit = seen[p, 0], seen[p, 1], seen[p, 2]
            for k in range(total):
                if (x < box[0, k]) | (x > box[1, k]) | (y < box[2, k]) | (y > box[3, k]):
                    continue
                corner = screen[ids[starts[tile] + k]]
                area, depth, above, below = 0.0, 0.0, True, True
                for i in range(3):
                    j, m = (i + 1) % 3, (i + 2) % 3
                    ax, ay, bx, by = corner[j, 0] - x, corner[j, 1] - y, corner[m, 0] - x, corner[m, 1] - y
                    part, slack = ax * by - bx * ay, EDGE * (abs(ay - by) + abs(ax - bx))
                    above, below = above and part >= -slack, below and part <= slack
                    area += part
                    depth += part * (1.0 / corner[i, 2] if orthographic else corner[i, 2])
                if not (above or below) or area == 0.0:
                    continue
                depth /= area
                if (depth if orthographic else 1.0 / depth) < limit:
                    out[p] = 0.0
                    break
