# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterises the triangles of a holdout (rendering/holdout.py): a small depth buffer for each tile, SAMPLES points a pixel, which is
made just before the tile's splats are blended.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import float32

from ...cameras.camera import Camera
from ...rendering.holdout import EDGE, NEAREST, SAMPLES, points
from ...util.threads import ranges, run, thread_count
from .. import asserts
from .jit import inline, kernel
from .raster import NOTHING, PIXELS, TILE
from .tile_lists import TileLists, list_tiles

CHUNK = 65_536
"""Triangles in one piece of work."""


@dataclass(frozen=True, eq=False)
class Occluder:
    """The triangles of a holdout before a camera.

    screen   [T, 3, 3]: x and y in pixels and the nearness, 1 / depth, of each triangle's corners, cut off at the near plane
    listing  which of them touch which tile
    lists    starts and ids of the tiles, as tile_lists.list_tiles() makes them
    far      depth beyond which nothing is hidden
    orthographic  whether depth itself is linear on the screen, and not nearness
    """

    screen: np.ndarray
    listing: TileLists
    lists: tuple[np.ndarray, np.ndarray]
    far: float
    orthographic: bool

    @classmethod
    def of(cls, triangles: np.ndarray, camera: Camera) -> Occluder:
        """The Occluder of triangles [F, 3, 3] float32 before a camera."""
        asserts.surface(triangles)
        x0, y0, width, height = camera.window
        window = x0, y0, x0 + width, y0 + height
        tile_x, tile_y = x0 // TILE, y0 // TILE
        grid = (tile_x, tile_y, (x0 + width - 1) // TILE - tile_x + 1, (y0 + height - 1) // TILE - tile_y + 1)
        view = np.ascontiguousarray(camera.world_to_camera[:3])
        lens = tuple(float(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy, max(camera.near, NEAREST), camera.far))
        parts = run(lambda a, b: project(triangles[a:b], view, lens, bool(camera.orthographic), window), ranges(len(triangles), CHUNK))
        screen = np.concatenate(parts) if parts else np.empty((0, 3, 3))
        pieces = ranges(len(screen), max(CHUNK, -(-len(screen) // (2 * thread_count()))))
        counts = np.zeros((max(len(pieces), 1), grid[2] * grid[3]), np.int32)
        segments = run(lambda s, a, b: spans(a, b, screen, *grid, counts[s]), [(s, *piece) for s, piece in enumerate(pieces)])
        listing = TileLists(window, grid, segments, counts)
        return cls(screen, listing, list_tiles(segments, counts, 0, counts.shape[1]), camera.far, camera.orthographic)

    def depths(self, first: int, last: int, wanted: np.ndarray | None = None) -> np.ndarray:
        """Of the tiles first..last, the depth of the nearest triangle in each point of each pixel [last - first, PIXELS, SAMPLES]; of those
        that are wanted [tiles] bool, of the others anything."""
        starts, ids = self.lists
        if starts[first] == starts[last]:
            return NOTHING
        out = np.empty((last - first, PIXELS, SAMPLES), np.float32)
        wanted = np.ones(last, np.bool_) if wanted is None else wanted
        cover(first, last, *self.listing.grid[:3], starts, ids, self.screen, POINTS, float(self.far), bool(self.orthographic), wanted, out)
        return out


POINTS = points()


def surface(triangles: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth of the nearest triangle in each pixel of the camera's window [h, w] float32, inf where there is none."""
    occluder = Occluder.of(triangles, camera)
    left, top, columns, rows = occluder.listing.grid
    out = np.full((rows, TILE, columns, TILE), np.inf, np.float32)

    def draw(row: int):
        depths = occluder.depths(row * columns, (row + 1) * columns)
        if len(depths):
            out[row] = depths.min(-1).reshape(columns, TILE, TILE).transpose(1, 0, 2)

    run(draw, [(row,) for row in range(rows)])
    x0, y0, right, bottom = occluder.listing.window
    return out.reshape(rows * TILE, columns * TILE)[y0 - top * TILE:bottom - top * TILE, x0 - left * TILE:right - left * TILE]


@kernel
def project(triangles, view, lens, orthographic, window):
    """The corners of triangles [F, 3, 3] on the screen, Occluder.screen; those that cannot be seen are left out."""
    fx, fy, cx, cy, near, far = lens
    x0, y0, right, bottom = window
    out = np.empty((2 * len(triangles), 3, 3))
    seen, clipped, n = np.empty((3, 3)), np.empty((4, 3)), 0
    for f in range(len(triangles)):
        low, high = np.inf, -np.inf
        for i in range(3):
            for k in range(3):
                seen[i, k] = (view[k, 0] * triangles[f, i, 0] + view[k, 1] * triangles[f, i, 1] + view[k, 2] * triangles[f, i, 2]
                              + view[k, 3])
            low, high = min(low, seen[i, 2]), max(high, seen[i, 2])
        if not (high >= near and low <= far):
            continue
        corners = 0
        for i in range(3):
            j = (i + 1) % 3
            if seen[i, 2] >= near:
                for k in range(3):
                    clipped[corners, k] = seen[i, k]
                corners += 1
            if (seen[i, 2] >= near) != (seen[j, 2] >= near):
                share = (near - seen[i, 2]) / (seen[j, 2] - seen[i, 2])
                clipped[corners, 0] = seen[i, 0] + share * (seen[j, 0] - seen[i, 0])
                clipped[corners, 1] = seen[i, 1] + share * (seen[j, 1] - seen[i, 1])
                clipped[corners, 2] = near
                corners += 1
        left, top, most_x, most_y = np.inf, np.inf, -np.inf, -np.inf
        for i in range(corners):
            unit = 1.0 if orthographic else 1.0 / clipped[i, 2]
            clipped[i, 0], clipped[i, 1] = fx * clipped[i, 0] * unit + cx, fy * clipped[i, 1] * unit + cy
            clipped[i, 2] = 1.0 / clipped[i, 2]
            left, top = min(left, clipped[i, 0]), min(top, clipped[i, 1])
            most_x, most_y = max(most_x, clipped[i, 0]), max(most_y, clipped[i, 1])
        if not (most_x >= x0 and left <= right and most_y >= y0 and top <= bottom):
            continue
        for i in range(1, corners - 1):
            for k in range(3):
                out[n, 0, k], out[n, 1, k], out[n, 2, k] = clipped[0, k], clipped[i, k], clipped[i + 1, k]
            n += 1
    return out[:n].copy()


@inline
def grown(runs):
    """Twice as many runs.  Copied number by number: numba takes two seconds for the messages that a slice could raise."""
    larger = np.empty((2 * len(runs), 3), np.int32)
    for k in range(len(runs)):
        larger[k, 0], larger[k, 1], larger[k, 2] = runs[k, 0], runs[k, 1], runs[k, 2]
    return larger


@kernel
def spans(first, last, screen, tile_x, tile_y, columns, rows, counts):
    """The runs of tiles within a row that the triangles first..last touch: see tiles.spans."""
    runs, n = np.empty((2 * (last - first) + 16, 3), np.int32), 0
    for t in range(first, last):
        top, bottom = np.inf, -np.inf
        for i in range(3):
            top, bottom = min(top, screen[t, i, 1]), max(bottom, screen[t, i, 1])
        upper = max(math.floor(max(top, -1e9) / TILE) - tile_y, 0)
        lower = min(math.floor(min(bottom, 1e9) / TILE) - tile_y, rows - 1)
        for row in range(upper, lower + 1):
            low, high = (tile_y + row) * float(TILE), (tile_y + row + 1) * float(TILE)
            left, right = np.inf, -np.inf
            for i in range(3):  # the part of each edge within the row
                ax, ay, bx, by = screen[t, i, 0], screen[t, i, 1], screen[t, (i + 1) % 3, 0], screen[t, (i + 1) % 3, 1]
                if max(ay, by) < low or min(ay, by) > high:
                    continue
                for y in (min(max(ay, low), high), min(max(by, low), high)):
                    x = ax if ay == by else ax + (y - ay) / (by - ay) * (bx - ax)
                    left, right = min(left, x), max(right, x)
                if ay == by:
                    left, right = min(left, bx), max(right, bx)
            a = max(math.floor((max(left, -1e9) - 1e-3) / TILE) - tile_x, 0)
            b = min(math.floor((min(right, 1e9) + 1e-3) / TILE) - tile_x, columns - 1)
            if a > b:
                continue
            if n == len(runs):
                runs = grown(runs)
            runs[n, 0], runs[n, 1], runs[n, 2] = t, row * columns + a, row * columns + b + 1
            for tile in range(runs[n, 1], runs[n, 2]):
                counts[tile] += 1
            n += 1
    return runs[:n]


@kernel
def cover(first, last, tile_x, tile_y, columns, starts, ids, screen, points, far, orthographic, wanted, out):
    """Occluder.depths: draw the triangles of each tile, the nearest wins."""
    px, py = points[:, 0].copy(), points[:, 1].copy()
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for tile in range(first, last):
        if not wanted[tile]:
            continue
        buffer = out[tile - first]
        buffer[:] = float32(0.0)
        left, top = (tile_x + tile % columns) * TILE, (tile_y + tile // columns) * TILE
        for k in range(starts[tile], starts[tile + 1]):
            corner = screen[ids[k]]
            area = 0.0
            for i in range(3):
                j, m = (i + 1) % 3, (i + 2) % 3
                ux, uy, vx, vy = corner[j, 0] - left, corner[j, 1] - top, corner[m, 0] - left, corner[m, 1] - top
                a[i], b[i], c[i] = uy - vy, vx - ux, ux * vy - vx * uy
                area += c[i]
            if area == 0.0:
                continue
            w0, w1, w2 = corner[0, 2], corner[1, 2], corner[2, 2]
            low, high = min(w0, w1, w2), max(w0, w1, w2)
            if orthographic:
                w0, w1, w2 = 1.0 / w0, 1.0 / w1, 1.0 / w2
            flip = 1.0 / area
            a0, b0, c0, a1, b1, c1 = a[0] * flip, b[0] * flip, c[0] * flip, a[1] * flip, b[1] * flip, c[1] * flip
            a2, b2, c2 = a[2] * flip, b[2] * flip, c[2] * flip
            e0, e1, e2 = -EDGE * (abs(a0) + abs(b0)), -EDGE * (abs(a1) + abs(b1)), -EDGE * (abs(a2) + abs(b2))
            xl = max(0, math.floor(max(min(corner[0, 0], corner[1, 0], corner[2, 0]) - left - 1e-3, -1.0)))
            xh = min(TILE - 1, math.floor(min(max(corner[0, 0], corner[1, 0], corner[2, 0]) - left + 1e-3, float(TILE))))
            yl = max(0, math.floor(max(min(corner[0, 1], corner[1, 1], corner[2, 1]) - top - 1e-3, -1.0)))
            yh = min(TILE - 1, math.floor(min(max(corner[0, 1], corner[1, 1], corner[2, 1]) - top + 1e-3, float(TILE))))
            for y in range(yl, yh + 1):
                for x in range(xl, xh + 1):
                    f0, f1, f2 = a0 * x + b0 * y + c0, a1 * x + b1 * y + c1, a2 * x + b2 * y + c2
                    if (f0 + max(a0, 0.0) + max(b0, 0.0) < e0 or f1 + max(a1, 0.0) + max(b1, 0.0) < e1
                            or f2 + max(a2, 0.0) + max(b2, 0.0) < e2):
                        continue
                    near = buffer[y * TILE + x]
                    for s in range(SAMPLES):
                        g0 = f0 + a0 * px[s] + b0 * py[s]
                        g1 = f1 + a1 * px[s] + b1 * py[s]
                        g2 = f2 + a2 * px[s] + b2 * py[s]
                        w = g0 * w0 + g1 * w1 + g2 * w2
                        w = min(max(1.0 / w if orthographic else w, low), high)
                        inside = (g0 >= e0) & (g1 >= e1) & (g2 >= e2)
                        near[s] = max(near[s], float32(w if inside else 0.0))
        for p in range(PIXELS):
            for s in range(SAMPLES):
                depth = 1.0 / buffer[p, s]
                buffer[p, s] = float32(depth if depth <= far else np.inf)
