# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes: the inside of a closed mesh as a grid of depths under its surface."""
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

RESOLUTION = 64
"""Nodes of the grid along each axis; the surface is off by a small part of a cell, edges and corners by up to half of one."""
PAIRS = 2_000_000
"""Pairs of a triangle and a node, or a column, that are computed at once."""


@dataclass(frozen=True, eq=False)
class Volume:
    """The inside of a closed mesh.

    depth [R, R, R] float32, x first, at the nodes of a grid whose corners are at -1 and 1 along each axis: the distance to the surface,
    by half of the bounds' smallest extent; positive within, negative outside
    """

    depth: np.ndarray

    @cached_property
    def digest(self) -> str:
        """The same for volumes with the same depths."""
        return hashlib.blake2b(np.ascontiguousarray(self.depth).tobytes(), digest_size=16).hexdigest()

    def depth_at(self, x: np.ndarray) -> np.ndarray:
        """Depths [M] at places [M, 3] in the volume's own space; -1 beyond its bounds."""
        last = self.depth.shape[0] - 1
        within = (np.abs(x) <= 1).all(1)
        g = np.where(within[:, None], (np.nan_to_num(x) + 1) * 0.5 * last, 0)
        low = np.minimum(g.astype(np.int64), last - 1)
        f = g - low
        out = np.zeros(len(x))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(np.array(corner), f, 1 - f).prod(1)
            out += weight * self.depth[tuple((low + corner).T)]
        return np.where(within, out, -1.0)


def mesh_volume(points: np.ndarray, triangles: np.ndarray, low: np.ndarray, high: np.ndarray) -> Volume:
    """The Volume of a closed mesh, points [V, 3] and triangles [T, 3], within the bounds from low [3] to high [3].

    Each node has its distance to a triangle: the nearest one next to the surface, elsewhere that of the nearest such node.  What is
    inside is told by how often a line along z crosses the surface; a mesh with holes has no clear inside.
    """
    half = np.maximum(0.5 * (np.asarray(high, np.float64) - low), 1e-30)
    unit = half.min()
    corners = ((np.asarray(points, np.float64) - low) / half - 1)[triangles]  # the grid's space
    stretch, step = half / unit, 2 / (RESOLUTION - 1)
    triangle = _nearest(_near_surface(corners, stretch, step), stretch * step).ravel()
    places = np.stack(np.unravel_index(np.arange(len(triangle)), (RESOLUTION,) * 3), 1) * step - 1
    distance = np.sqrt(_distance2(places * stretch, corners[triangle] * stretch)).reshape((RESOLUTION,) * 3)
    return Volume(np.where(_inside(corners, step), distance, -distance).astype(np.float32))


def _near_surface(corners: np.ndarray, stretch: np.ndarray, step: float) -> np.ndarray:
    """The nearest triangle [R, R, R] of nodes that are next to the surface; -1 elsewhere."""
    squared, nearest = np.full(RESOLUTION**3, 3 * (stretch * step).max() ** 2), np.full(RESOLUTION**3, -1)
    first = np.clip(np.floor((corners.min(1) + 1) / step).astype(np.int64) - 1, 0, RESOLUTION - 1)
    last = np.clip(np.ceil((corners.max(1) + 1) / step).astype(np.int64) + 1, 0, RESOLUTION - 1)
    for chunk, which, node in _nodes(first, last - first + 1):
        place = np.stack(node, 1) * step - 1
        d = _distance2(place * stretch, corners[chunk][which] * stretch)
        at = np.ravel_multi_index(node, (RESOLUTION,) * 3)
        order = np.lexsort((d, at))
        at, d, which = at[order], d[order], which[order]
        best = np.r_[True, at[1:] != at[:-1]] & (d < squared[at])
        squared[at[best]], nearest[at[best]] = d[best], chunk.start + which[best]
    return nearest.reshape((RESOLUTION,) * 3)


def _nodes(first: np.ndarray, count: np.ndarray) -> Iterator[tuple[slice, np.ndarray, tuple[np.ndarray, ...]]]:
    """Yields (slice of the rows, row of each node within it, the node's indices (x, y, z)) for boxes of `count` nodes from `first` on."""
    sizes = count.prod(1)
    start = 0
    while start < len(sizes):
        total = np.cumsum(sizes[start:])
        stop = start + max(int(np.searchsorted(total, PAIRS, side="right")), 1)
        own = sizes[start:stop]
        which = np.repeat(np.arange(stop - start), own)
        number = np.arange(own.sum()) - np.repeat(np.cumsum(own) - own, own)
        box, begin = count[start:stop][which], first[start:stop][which]
        x, y, z = number // (box[:, 1] * box[:, 2]), number // box[:, 2] % box[:, 1], number % box[:, 2]
        yield slice(start, stop), which, (begin[:, 0] + x, begin[:, 1] + y, begin[:, 2] + z)
        start = stop


def _distance2(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Squared distances [n] of points [n, 3] to triangles [n, 3 corners, 3]."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    out = np.full(len(p), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along, offset = end - start, p - start
        share = np.clip((offset * along).sum(1) / np.maximum((along * along).sum(1), 1e-30), 0, 1)
        out = np.minimum(out, ((offset - share[:, None] * along) ** 2).sum(1))
    normal = np.cross(b - a, c - a)
    length2 = np.maximum((normal * normal).sum(1), 1e-30)
    over = np.ones(len(p), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        over &= (np.cross(end - start, p - start) * normal).sum(1) >= 0
    return np.where(over, np.minimum(out, ((p - a) * normal).sum(1) ** 2 / length2), out)


def _nearest(found: np.ndarray, size: np.ndarray) -> np.ndarray:
    """What is found [R, R, R] at the nearest node where it is not -1, axis by axis; size [3] of a cell."""
    squared = np.where(found >= 0, 0.0, np.inf)
    for axis in range(3):
        near, what = np.moveaxis(squared, axis, 0), np.moveaxis(found, axis, 0)
        best, chosen = near.copy(), what.copy()
        for node in range(RESOLUTION):
            away = ((np.arange(RESOLUTION) - node) * size[axis]) ** 2
            new = near[node][None] + away[:, None, None]
            better = new < best
            np.copyto(best, new, where=better)
            np.copyto(chosen, what[node][None], where=better)
        squared, found = np.moveaxis(best, 0, axis), np.moveaxis(chosen, 0, axis)
    return np.maximum(found, 0)


def _inside(corners: np.ndarray, step: float) -> np.ndarray:
    """Which nodes [R, R, R] a line along z enters the mesh before more often than it leaves it: an odd number of crossings."""
    crossings = np.zeros((RESOLUTION, RESOLUTION, RESOLUTION + 1), np.int64)
    first = np.clip(np.ceil((corners[..., :2].min(1) + 1) / step - 1e-9).astype(np.int64), 0, RESOLUTION)
    last = np.clip(np.floor((corners[..., :2].max(1) + 1) / step + 1e-9).astype(np.int64), -1, RESOLUTION - 1)
    count = np.c_[np.maximum(last - first + 1, 0), np.ones(len(corners), np.int64)]
    for chunk, which, (x, y, _) in _nodes(np.c_[first, np.zeros(len(first), np.int64)], count):
        # columns beside the nodes, so that none runs through a vertex or along an edge of a mesh made of round numbers
        px, py = x * step - 1 + 1.234567e-5 * step, y * step - 1 + 2.345678e-5 * step
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners[chunk][which].transpose(1, 2, 0)
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        v, w = (px - ax) * (cy - ay) - (py - ay) * (cx - ax), (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        with np.errstate(divide="ignore", invalid="ignore"):
            v, w = v / area, w / area
            hit = (v >= 0) & (w >= 0) & (v + w <= 1)
            z = (az + v * (bz - az) + w * (cz - az))[hit]
        above = np.clip(np.ceil((z + 1) / step).astype(np.int64), 0, RESOLUTION)
        np.add.at(crossings, (x[hit], y[hit], above), 1)
    return np.cumsum(crossings[..., :RESOLUTION], axis=2) % 2 == 1
