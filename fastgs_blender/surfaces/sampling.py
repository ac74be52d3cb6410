# SPDX-License-Identifier: GPL-3.0-or-later
"""Spreads points evenly over a triangle mesh, without clumps or holes and without random numbers."""
import itertools
from dataclasses import dataclass

import numpy as np

OVERSAMPLING = 3
"""Number of candidates for each point that is kept."""
FOLDED = 64.0
"""A surface that is stretched by more than this at another time is folded up."""


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """N points on T triangles.

    triangle [N]     which triangle
    weights  [N, 3]  barycentric coordinates, float64
    spacing          distance between neighbours were they a square grid: sqrt(area / N)
    """

    triangle: np.ndarray
    weights: np.ndarray
    spacing: float

    def __len__(self) -> int:
        return len(self.triangle)


def triangle_normals(corners: np.ndarray) -> np.ndarray:
    """Cross products of the first two edges: twice the area long.  corners [..., 3 corners, 3] -> [..., 3]."""
    return np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths [...] of vectors [..., d], several times as fast as numpy.linalg.norm for short ones."""
    return np.sqrt(np.einsum("...d,...d->...", vectors, vectors))


def sample_surface(points: np.ndarray, triangles: np.ndarray, count: int, area: np.ndarray | None = None) -> SurfaceSamples:
    """Exactly `count` points on the surface.

    points [V, 3], triangles [T, 3] indices; area [T]: what each triangle counts for, default its own area (give the
    largest area that it ever has, and a surface is dense enough when it is stretched).

    Three times as many candidates are laid out in strata along a space-filling curve, low-discrepancy within each triangle;
    then those with the nearest neighbours are left out, many at a time (weighted sample elimination: Yuksel 2015, "Sample
    Elimination for Generating Poisson Disk Sample Sets").
    """
    corners = np.asarray(points, np.float64)[triangles]
    normals = triangle_normals(corners)
    true_area = 0.5 * np.linalg.norm(normals, axis=1)
    area = true_area if area is None else np.asarray(area, np.float64)
    candidates, weights = _stratified(corners.mean(1), area, OVERSAMPLING * count)
    # Distances count in the metric in which `area` is the surface's area.
    stretch = np.sqrt(np.divide(area, true_area, out=np.full_like(area, np.inf), where=true_area > 0))[candidates]
    # A triangle that is folded up now, and large at another time, has no distances: its share of the candidates stays.
    folded = stretch > FOLDED
    left = np.flatnonzero(~folded | (np.cumsum(folded) % OVERSAMPLING == 0))
    candidates, weights, stretch = candidates[left], weights[left], stretch[left]
    position = np.einsum("nk,nkd->nd", weights, corners[candidates])
    keep = _eliminate(position, normals[candidates], stretch, count, float(area.sum()))
    return SurfaceSamples(candidates[keep], weights[keep], float(np.sqrt(area.sum() / count)))


def _stratified(centres: np.ndarray, area: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(_morton(centres), kind="stable")
    total = np.cumsum(area[order])
    strata = (np.arange(count) + 0.5) / count * total[-1]
    triangle = order[np.minimum(np.searchsorted(total, strata), len(order) - 1)]
    # Roberts' R2 sequence: neighbours in the sequence share a triangle and fill it evenly.  Their square is folded along its diagonal:
    # a map that bends it, such as a square root, crowds the points into rows in parts of a large triangle.
    i = np.arange(count)[:, None]
    low, high = np.sort((i + 0.5) * (0.7548776662466927, 0.5698402909980532) % 1, axis=1).T
    return triangle, np.stack([high - low, low, 1 - high], 1)


def _morton(points: np.ndarray) -> np.ndarray:
    """Place of each point on a space-filling curve."""
    low, extent = points.min(0), max(np.ptp(points, axis=0).max(), 1e-30)
    cell = ((points - low) / extent * 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit, axis in itertools.product(range(10), range(3)):
        code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _eliminate(position: np.ndarray, normal: np.ndarray, stretch: np.ndarray, count: int, area: float) -> np.ndarray:
    """Indices of the `count` points that are left when the most crowded go first."""
    m = len(position)
    if count >= m:
        return np.arange(m)
    radius = 2 * np.sqrt(area / (2 * np.sqrt(3) * count))
    i, j, crowding = neighbours(position, normal, stretch, radius)
    alive = np.ones(m, bool)
    order = np.arange(m) * 1e-12  # so that no two are equally crowded
    while (surplus := alive.sum() - count) > 0:
        crowd = np.bincount(i, crowding, m) + np.bincount(j, crowding, m) + order
        worst = np.zeros(m)
        np.maximum.at(worst, i, crowd[j])
        np.maximum.at(worst, j, crowd[i])
        # All that are more crowded than their neighbours and than the average can go at once: they do not affect each other.
        out = np.flatnonzero(alive & (crowd >= worst) & (crowd >= np.median(crowd[alive])))
        if len(out) > surplus:
            out = out[np.argsort(-crowd[out], kind="stable")[:surplus]]
        alive[out] = False
        left = alive[i] & alive[j]
        i, j, crowding = i[left], j[left], crowding[left]
    return np.flatnonzero(alive)


def neighbours(position: np.ndarray, normal: np.ndarray, stretch: np.ndarray, radius: float) -> tuple[np.ndarray, ...]:
    """Pairs i, j of points on the same side of a surface nearer than radius, and how much they crowd each other, 0..1.

    position, normal [M, 3]; stretch [M] multiplies distances.  Points of very different stretch are never neighbours.
    """
    level = np.where(stretch > FOLDED, 99, np.round(np.log2(np.maximum(stretch, 1e-9)))).astype(int)
    found = []
    for exponent in np.unique(level[level != 99]):
        own = np.flatnonzero(level == exponent)
        i, j = (own[x] for x in near_pairs(position[own], None, radius / 2.0 ** (exponent - 0.5)))
        distance = np.linalg.norm(position[i] - position[j], axis=1) * np.sqrt(stretch[i] * stretch[j])
        near = (distance < radius) & (np.einsum("nd,nd->n", normal[i], normal[j]) > 0)
        found.append((i[near], j[near], (1 - distance[near] / radius) ** 8))
    nothing = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    return tuple(np.concatenate(x) for x in zip(nothing, *found, strict=True))


def near_pairs(a: np.ndarray, b: np.ndarray | None, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """All i, j for which a[i] and b[j] ([M, 3], [L, 3]) are nearer than radius; without b, those of a with i < j."""
    alone = b is None
    b = a if b is None else b
    low = np.minimum(a.min(0), b.min(0))
    cell_a, cell_b = (np.floor((x - low) / radius).astype(np.int64) + 1 for x in (a, b))
    size = np.maximum(cell_a.max(0), cell_b.max(0)) + 2
    step = np.array([1, size[0], size[0] * size[1]])
    (order_a, key_a), (order_b, key_b) = ((order, key[order]) for key in (cell_a @ step, cell_b @ step)
                                          for order in [np.argsort(key, kind="stable")])
    sorted_a, sorted_b, found = a[order_a], b[order_b], []
    for y, z in itertools.product((-1, 0, 1), repeat=2):  # three cells in a row lie together in the order
        if alone and (z, y) < (0, 0):
            continue
        row = key_a + y * step[1] + z * step[2]
        first = np.arange(1, len(a) + 1) if alone and (z, y) == (0, 0) else np.searchsorted(key_b, row - 1, "left")
        number = np.searchsorted(key_b, row + 1, "right") - first
        i = np.repeat(np.arange(len(a)), number)
        j = np.arange(len(i)) - np.repeat(np.cumsum(number) - number - first, number)
        difference = sorted_a[i] - sorted_b[j]
        near = np.einsum("nd,nd->n", difference, difference) < radius * radius
        found.append((order_a[i[near]], order_b[j[near]]))
    i, j = (np.concatenate(x) for x in zip(*found, strict=True))
    return (np.minimum(i, j), np.maximum(i, j)) if alone else (i, j)
