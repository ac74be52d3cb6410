# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light from a camera's place comes to points: past splats, and past triangles (rendering/passing.py).

Splats and triangles are listed by tile, as for a picture; the points of a tile ask its list alone.
"""
from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import float32
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from ...rendering.holdout import EDGE
from ...rendering.layout import Layout
from ...rendering.passing import BEHIND
from ...util.threads import portions, run
from .. import asserts
from . import raster, simd
from .holdout import Occluder
from .jit import inline, kernel
from .rasterise import ENTRIES, TILES
from .reaching import cells_of
from .sort import order_by
from .splats import project_instances
from .tile_lists import TileLists, grid_of, list_tiles

TILE = 64
"""Pixels of a tile's side: large splats, which stand near a lamp, are in few lists."""
PART = 8
"""Pixels of the side of the squares by which a tile's points are sorted, so that those side by side ask for much the same splats."""
PARTS = (TILE // PART) ** 2
BATCH = 8
"""Points of a part that go past its splats together."""
LAYERS = 2047
"""Of depth, by which splats are sorted: as many bits as one pass takes."""
BESIDE = 0.01
"""Pixels by which a triangle's box is wider than the triangle: more than EDGE, and than float32 rounds a place in a picture by."""
DARK = 1e-3
"""Share of the light at which it counts as stopped."""
CHOICES = np.array([(*(lane for lane in range(8) if bits >> lane & 1), *[0] * (8 - bits.bit_count())) for bits in range(256)], np.int32)
"""For every choice of eight, by its bits, which they are [256, 8]."""
_NOWHERE = (np.inf,) * 3 + (-np.inf,) * 3
"""The box of no points."""
EXP2 = (0.999999945, 0.693143204, 0.240179499, 0.0552996223, 0.00921088407, 0.00094755432)
"""2^x for x in -1..0 as a polynomial, to 1e-6."""


def view_box(points: np.ndarray, view: np.ndarray, parallel: bool) -> np.ndarray:
    """PictureBackend.view_box()."""
    asserts.view_box(points, view)
    rest = points, np.ascontiguousarray(view), bool(parallel)
    found = np.array(run(lambda a, b: _box(a, b, *rest), portions(points.shape[1])) or [_NOWHERE]).reshape(-1, 2, 3)
    return np.stack([found[:, 0].min(0), found[:, 1].max(0)])


def past_splats(instances, camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """PictureBackend.past_splats()."""
    asserts.past_splats(points, over)
    layout, out = Layout(instances, False, plane=True), np.ones(points.shape[1], np.float32)
    grid = grid_of(camera, TILE)
    seen, begins, asked = _by_tile(grid, TILE // PART, PART, camera, points, over)
    splats = project_instances(instances, camera, layout, cells=cells_of(camera.window, seen, asked[:begins[-1]]))
    order, layer = _by_depth(splats.depth[splats.index], splats.index)
    listing = TileLists.of(order, splats.geometry, splats.attributes, camera, TILE)
    for first, last in listing.bands(ENTRIES):
        lists = list_tiles(listing.segments, listing.counts, first, last)
        plane = raster.CHANNEL + layout.places["plane"].start
        rest = (*listing.grid[:3], *lists, splats.geometry, splats.attributes, plane, layer, begins, asked, seen, camera.width / 2,
                camera.height / 2, out)
        run(lambda a, b, first=first, rest=rest: transmitted(first + a, first + b, *rest), portions(last - first, last - first, 1))
    return out


def past_triangles(triangles, camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
    """PictureBackend.past_triangles()."""
    asserts.past_splats(points, over)
    occluder, out = Occluder.of(triangles, camera), np.ones(points.shape[1], np.float32)
    if not len(occluder.screen):
        return out
    seen, begins, asked = _by_tile(occluder.listing.grid, 1, raster.TILE, camera, points, over)
    rest = (*occluder.lists, occluder.screen, bool(occluder.orthographic), begins, asked, seen, out)
    run(lambda a, b: open_ways(a, b, *rest), portions(len(begins) - 1, len(begins) - 1, TILES))
    return out


def _by_depth(depth: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, float]:
    """index [V] int32 by layers of depth [V], the nearest first, and how deep a layer is."""
    if not len(index):
        return index, 0.0
    low, high = depth.min(), depth.max()
    layer = max(float(high - low), 1e-30) / LAYERS
    return order_by(((depth - low) / layer).astype(np.uint32).view(np.float32), index), layer


def _by_tile(grid, split: int, side: int, camera, points: np.ndarray, over: np.ndarray):
    """Points by part of tiles: x and y in pixels and the depth that counts of each [3, P], where each part's points begin in a list of
    their indices, [parts + 1], and the list.

    A tile has split x split parts of so many pixels' side, one after another.  Points beside the window are in the nearest part, those
    behind the camera in none.
    """
    count = points.shape[1]
    seen, part = np.empty((3, count)), np.empty(count, np.int32)
    rest = (np.ascontiguousarray(points), over, np.ascontiguousarray(camera.world_to_camera[:3]),
            tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)), bool(camera.orthographic), *grid,
            split, split.bit_length() - 1, side, seen, part)
    run(lambda a, b: place(a, b, *rest), portions(count))
    return seen, *list_points(part, grid[2] * grid[3] * split * split)


@kernel
def _box(first, last, points, view, parallel):
    """view_box() of the points first..last, as six numbers."""
    west, north, near, east, south, far = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for p in range(first, last):
        x = view[0, 0] * points[0, p] + view[0, 1] * points[1, p] + view[0, 2] * points[2, p] + view[0, 3]
        y = view[1, 0] * points[0, p] + view[1, 1] * points[1, p] + view[1, 2] * points[2, p] + view[1, 3]
        z = view[2, 0] * points[0, p] + view[2, 1] * points[1, p] + view[2, 2] * points[2, p] + view[2, 3]
        if parallel or z > BEHIND:
            unit = 1.0 if parallel else 1.0 / z
            x, y = x * unit, y * unit
            west, north, near = min(west, x), min(north, y), min(near, z)
            east, south, far = max(east, x), max(south, y), max(far, z)
    return west, north, near, east, south, far


@kernel
def place(first, last, points, over, view, lens, orthographic, tile_x, tile_y, columns, rows, split, shift, side, seen, part):
    """Where the points first..last are seen, and in which part of which tile, as _by_tile() says; the number after the last for those in
    none.  Tiles have split x split parts of so many pixels' side; split is 2^shift."""
    fx, fy, cx, cy = lens
    for p in range(first, last):  # several loops, as each of them becomes vectors
        unit = _unit(points, p, view, orthographic)
        seen[0, p] = fx * _along(points, p, view, 0) * unit + cx
    for p in range(first, last):
        unit = _unit(points, p, view, orthographic)
        seen[1, p] = fy * _along(points, p, view, 1) * unit + cy
    for p in range(first, last):
        seen[2, p] = _along(points, p, view, 2) - over[p]
    per_side, left, top, right, bottom = 1.0 / side, float(tile_x * split), float(tile_y * split), columns * split - 1.0, rows * split - 1.0
    across, bits, mask, none = np.int32(columns), np.int32(shift), np.int32(split - 1), np.int32(columns * rows * split * split)
    for p in range(first, last):
        column = np.int32(min(max(seen[0, p] * per_side - left, 0.0), right))
        row = np.int32(min(max(seen[1, p] * per_side - top, 0.0), bottom))
        number = ((((row >> bits) * across + (column >> bits)) << bits) + (row & mask) << bits) + (column & mask)
        part[p] = number if _along(points, p, view, 2) > BEHIND else none


@inline
def _along(points, p, view, row):
    """A point's place along an axis of a view [3, 4]."""
    return view[row, 0] * points[0, p] + view[row, 1] * points[1, p] + view[row, 2] * points[2, p] + view[row, 3]


@inline
def _unit(points, p, view, orthographic):
    """By what a point's place is multiplied on its way into the picture."""
    z = _along(points, p, view, 2)
    return 1.0 / (1.0 if orthographic or not z > BEHIND else z)


@kernel
def list_points(part, parts):
    """A counting sort: where each part's points begin in a list, and the list of the points' indices, in their order."""
    begins = np.zeros(parts + 2, np.int64)
    for p in range(len(part)):
        begins[part[p] + 1] += 1
    for k in range(parts + 1):
        begins[k + 1] += begins[k]
    asked, cursor = np.empty(len(part), np.int32), begins[:-1].copy()
    for p in range(len(part)):
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
def transmitted(first, last, tile_x, tile_y, columns, starts, ids, geometry, attributes, plane, layer, begins, asked, seen, middle_x,
                middle_y, out):
    """The transmittance of the splats before each point of the tiles first..last, in out [P]; plane: the first column of their planes;
    layer: how deep the layers are in which the splats are listed, the nearest first."""
    state, box, splat = np.empty((4, BATCH), np.float32), np.empty((4, 0), np.float32), np.empty((0, 12), np.float32)
    near = np.empty(0, np.int32)
    px, py, limit, light = state[0], state[1], state[2], state[3]
    for tile in range(first, last):
        total = starts[tile + 1] - starts[tile]
        if total == 0 or begins[tile * PARTS] == begins[(tile + 1) * PARTS]:
            continue
        left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
        if len(splat) < total:
            box, splat = np.empty((4, 2 * total + simd.LANES), np.float32), np.empty((2 * total, 12), np.float32)
            near = np.empty(2 * total + simd.LANES, np.int32)
        deepest = float32(-np.inf)
        for q in range(begins[tile * PARTS], begins[(tile + 1) * PARTS]):
            deepest = max(deepest, float32(seen[2, asked[q]]))
        deepest += float32(1.01 * layer)
        total = gather(starts[tile], total, ids, geometry, attributes, plane, left, top, middle_x, middle_y, deepest, box, splat)
        for part in range(tile * PARTS, (tile + 1) * PARTS):
            if begins[part] == begins[part + 1]:
                continue
            found = pick(begins[part], begins[part + 1], asked, seen, left, top, total, box, near)
            for begin in range(begins[part], begins[part + 1], BATCH):
                count, farthest = min(BATCH, begins[part + 1] - begin), float32(-np.inf)
                for j in range(BATCH):
                    light[j], px[j], py[j], limit[j] = float32(0.0), float32(0.0), float32(0.0), float32(-np.inf)
                    if j < count:
                        p = asked[begin + j]
                        light[j], px[j], py[j], limit[j] = float32(1.0), within(seen[0, p] - left), within(seen[1, p] - top), seen[2, p]
                        farthest = max(farthest, limit[j])
                farthest += float32(1.01 * layer)
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
                    if n % 8 == 7 and not simd.any_from(light, 0, float32(DARK)):
                        break
                for j in range(count):
                    out[asked[begin + j]] = light[j]


@inline
def within(x):
    """A coordinate in a tile: its list holds what touches the centres of its pixels, so a point beside them is moved there."""
    return min(max(x, 0.5), TILE - 0.5)


@inline
def pick(begin, end, asked, seen, left, top, total, box, near):
    """Which of a tile's splats reach the box around the points begin..end of a part, into near; returns their number."""
    west, east, north, south = float32(np.inf), float32(-np.inf), float32(np.inf), float32(-np.inf)
    for q in range(begin, end):
        x, y = float32(within(seen[0, asked[q]] - left)), float32(within(seen[1, asked[q]] - top))
        west, east, north, south = min(west, x), max(east, x), min(north, y), max(south, y)
    found = 0
    for k in range(0, total, simd.LANES):
        found = keep8(box, box.shape[1], k, west, east, north, south, CHOICES, near, found)
    return found


@intrinsic
def keep8(context, box, stride, k, west, east, north, south, choices, near, found):
    """Write those of the splats k..k + 8 that reach a box to near[found:], which has room for eight; returns how many there are then.

    box [4, stride]: the boxes that splats fill, as gather() writes them; choices: CHOICES
    """
    def build(context, b, signature, args):
        memory, at = simd.Memory(context, b, signature.args[0], args[0]), args[2]
        sides = []
        for edge in args[3:7]:
            sides.append((memory.floats(at, 0), simd.broadcast(b, edge)))
            at = b.add(at, args[1])
        inside = [right >= edge if high else edge >= right for (right, edge), high in zip(sides, (True, False, True, False))]
        bits = b.bitcast(b.and_(b.and_(inside[0], inside[1]), b.and_(inside[2], inside[3])), ir.IntType(simd.LANES))
        rows, out = (make_array(signature.args[i])(context, b, args[i]).data for i in (7, 8))
        row = b.mul(b.zext(bits, args[2].type), ir.Constant(args[2].type, simd.LANES))
        chosen = b.load(b.bitcast(b.gep(rows, [row]), simd.INTS.as_pointer()), align=4)
        first = b.insert_element(ir.Constant(simd.INTS, ir.Undefined), b.trunc(args[2], ir.IntType(32)), ir.Constant(ir.IntType(32), 0))
        chosen = b.add(chosen, b.shuffle_vector(first, first, ir.Constant(simd.INTS, [0] * simd.LANES)))
        b.store(chosen, b.bitcast(b.gep(out, [args[9]]), simd.INTS.as_pointer()), align=4)
        return b.add(args[9], b.zext(b.ctpop(bits), args[9].type))

    number = types.float32
    return types.intp(box, types.intp, types.intp, number, number, number, number, choices, near, types.intp), build


@inline
def gather(start, total, ids, geometry, attributes, plane, left, top, middle_x, middle_y, deepest, box, splat):
    """What transmitted() reads of the splats of a tile's list up to a depth, pixels counted from its corner: the boxes that they fill
    [4, splats], with eight empty ones after them, and the rest of each side by side [splats, 12].  Returns how many they are."""
    for k in range(total):
        i = ids[start + k]
        if attributes[i, raster.DEPTH] > deepest:
            total = k
            break
        mx, my = geometry[i, raster.MEAN_X] - left, geometry[i, raster.MEAN_Y] - top
        rx, ry = attributes[i, raster.RADIUS_X], attributes[i, raster.RADIUS_Y]
        box[0, k], box[1, k], box[2, k], box[3, k] = mx + rx, mx - rx, my + ry, my - ry
        splat[k, 0], splat[k, 1], splat[k, 2] = attributes[i, raster.DEPTH], mx, my
        splat[k, 3], splat[k, 4], splat[k, 5] = geometry[i, raster.L11], geometry[i, raster.L21], geometry[i, raster.L22]
        slope_x, slope_y = attributes[i, plane + 1], attributes[i, plane + 2]
        splat[k, 6] = attributes[i, plane] + slope_x * (left - middle_x) + slope_y * (top - middle_y)
        splat[k, 7], splat[k, 8], splat[k, 9] = slope_x, slope_y, attributes[i, raster.LOG2_OPACITY]
        splat[k, 10], splat[k, 11] = attributes[i, raster.ALPHA_MAX], attributes[i, raster.LOG2_CUT]
    for k in range(total, total + simd.LANES):
        box[0, k] = -np.inf
    return total


@kernel
def open_ways(first, last, starts, ids, screen, orthographic, begins, asked, seen, out):
    """Out [P] is 0 for those points of the tiles first..last before which a triangle lies."""
    box, near = np.empty((4, 0), np.float32), np.empty(0, np.int32)
    for tile in range(first, last):
        total = starts[tile + 1] - starts[tile]
        if total == 0 or begins[tile] == begins[tile + 1]:
            continue
        if len(near) < total + simd.LANES:
            box, near = np.empty((4, 2 * total + simd.LANES), np.float32), np.empty(2 * total + simd.LANES, np.int32)
        for k in range(total):
            corner = screen[ids[starts[tile] + k]]
            box[0, k] = max(corner[0, 0], corner[1, 0], corner[2, 0]) + BESIDE
            box[1, k] = min(corner[0, 0], corner[1, 0], corner[2, 0]) - BESIDE
            box[2, k] = max(corner[0, 1], corner[1, 1], corner[2, 1]) + BESIDE
            box[3, k] = min(corner[0, 1], corner[1, 1], corner[2, 1]) - BESIDE
        for k in range(total, total + simd.LANES):
            box[0, k] = -np.inf
        for q in range(begins[tile], begins[tile + 1]):
            p = asked[q]
            x, y, limit, found = seen[0, p], seen[1, p], seen[2, p], 0
            for k in range(0, total, simd.LANES):
                found = keep8(box, box.shape[1], k, float32(x), float32(x), float32(y), float32(y), CHOICES, near, found)
            for n in range(found):
                corner = screen[ids[starts[tile] + near[n]]]
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
