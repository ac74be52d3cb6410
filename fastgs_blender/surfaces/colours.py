# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of Gaussians on a surface, and where the surface's colour has an edge: a Gaussian must not straddle it."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util.arguments import numbers, shown
from ..util.errors import FastGSError
from .borders import Edges
from .sampling import SurfaceSamples, lengths, triangle_normals
from .tangents import plane

Colours = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function of triangles [n] and barycentric weights [n, 3]: colours [n, C], sRGB 0..1 with opacity as an optional fourth."""

WANTED = "(3,) or (4,) for all, (triangles, 3 or 4), or (triangles, 3 corners, 3 or 4)"
CONTRAST = 0.12
"""Two places whose colours differ by more than this in a channel lie on two sides of an edge of colour."""
AROUND = 0.5
"""Radius of the ring of places over which a Gaussian's colour is the mean, by the distance of neighbours."""
RING = 6
"""Number of places on the ring."""
HALVINGS = 5
"""An edge is found to this power of 1/2 of the ring's radius."""
ALONG = (0.15, 0.5, 0.85)
"""Places on a mesh edge, on both sides of which the colour is looked up; more than half of them must differ for an edge of colour."""
ASIDE = 0.25
"""Distance of these places from the mesh edge, by the distance of neighbours; at most this share of the triangle's height."""


@dataclass(frozen=True, eq=False)
class Painted:
    """The colours of N samples, and the edges of colour about them.

    rgba      [N, 4]  sRGB and opacity
    across    [N, 3]  in the pose of reference, the direction across the nearest edge of colour within the triangles, away from it; 0: none
    distance  [N]     to it
    seam      [T, 3]  bool: whether the colour changes across a triangle's side k, from its corner k to the next
    """

    rgba: np.ndarray
    across: np.ndarray
    distance: np.ndarray
    seam: np.ndarray

    def take(self, which: np.ndarray) -> Painted:
        """Those of some of the samples."""
        return Painted(self.rgba[which], self.across[which], self.distance[which], self.seam)


def paint(colours: Any, corners: np.ndarray, edges: Edges, samples: SurfaceSamples, for_samples: bool) -> Painted:
    """What bake() takes as `colours`, at the samples.

    corners      [T, 3 corners, 3] of the triangles in the pose of reference
    for_samples  whether an array [N, C] is for the samples rather than for the triangles
    """
    count, sampled = len(corners), len(samples)
    across, distance, function = np.zeros((sampled, 3)), np.full(sampled, np.inf), None
    if callable(colours):
        function = colours
        values, across, distance = _footprints(colours, corners[samples.triangle], samples)
    else:
        values = numbers(colours, "colours", WANTED)
        if values.ndim == 3 and values.shape[:2] == (count, 3):
            function = lambda triangle, weights, corner=values: np.einsum("nkc,nk->nc", corner[triangle], weights)  # noqa: E731
        elif values.ndim == 2 and len(values) == count and not for_samples:
            function = lambda triangle, weights, flat=values: flat[triangle]  # noqa: E731
        elif values.ndim == 1:
            values = np.broadcast_to(values, (sampled, len(values)))
        if function:
            values = function(samples.triangle, samples.weights)
    if values.ndim != 2 or len(values) != sampled or values.shape[1] not in (3, 4) or not np.isfinite(values).all():
        given = "those of a function" if callable(colours) else shown(np.asarray(colours))
        raise FastGSError(f"colours must be finite numbers of the shape {WANTED}, not {given}; there are {count} triangles.")
    rgba = values if values.shape[1] == 4 else np.c_[values, np.ones(sampled)]
    seam = np.zeros((count, 3), bool) if function is None else _seams(function, corners, edges, samples.spacing)
    return Painted(rgba, across, distance, seam)


def _footprints(colours: Colours, corners: np.ndarray, samples: SurfaceSamples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(colours [N, C], across [N, 3], distance [N]): the mean around each sample, on its own side of an edge of colour; see Painted.

    The places around a sample do not leave a large triangle; a small one is taken as a piece of a smooth surface that goes on around it.
    """
    axes, inverse, flat = plane(corners[:, 1:] - corners[:, :1])
    large = lengths(triangle_normals(corners)) > 16 * samples.spacing**2
    angles = np.arange(RING) * 2 * np.pi / RING
    ring = AROUND * samples.spacing * np.stack([np.cos(angles), np.sin(angles)], 1)
    factors = np.where(flat[:, None], 0, np.einsum("nkm,am->ank", inverse, ring))
    factors /= np.maximum(np.abs(factors).max(-1, keepdims=True) / 4, 1)
    around = samples.weights + np.concatenate([-factors.sum(-1, keepdims=True), factors], -1)
    inside = np.maximum(around, 0)
    around = np.where(large[:, None], inside / inside.sum(-1, keepdims=True), around)

    centre = numbers(colours(samples.triangle, samples.weights), "the colours of a function", "(places, 3 or 4)")
    if centre.shape not in ((len(samples), 3), (len(samples), 4)):
        raise FastGSError(f"the function of colours must give the shape ({len(samples)}, 3 or 4) for {len(samples)} places, not "
                          f"{centre.shape}.")
    found = np.stack([np.asarray(colours(samples.triangle, weights), np.float64) for weights in around])
    other = np.abs(found - centre).max(-1) > CONTRAST
    # An edge has the sample's own colour behind the sample; in a speckled texture a Gaussian takes the mean.
    edge = other & ~np.roll(other, RING // 2, 0)
    sided = edge.any(0)
    own = ~(other & sided)
    values = (centre + np.where(own[..., None], found, 0).sum(0)) / (1 + own.sum(0))[:, None]
    across, distance = np.zeros((len(centre), 3)), np.full(len(centre), np.inf)
    rows = np.flatnonzero(sided)
    if len(rows):
        across[rows], distance[rows] = _nearest_edge(colours, corners[rows], axes[rows], samples, rows, centre[rows], around[:, rows],
                                                     edge[:, rows])
    return values, across, distance


def _nearest_edge(colours: Colours, corners: np.ndarray, axes: np.ndarray, samples: SurfaceSamples, rows: np.ndarray, centre: np.ndarray,
                  around: np.ndarray, edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(direction [n, 3], distance [n]): a line through the places where the colour changes on the ways to places around."""
    ways, which = np.nonzero(edge)
    triangle, start = samples.triangle[rows][which], samples.weights[rows][which]
    step = around[ways, which] - start
    low, high = np.zeros(len(which)), np.ones(len(which))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = np.abs(np.asarray(colours(triangle, start + middle[:, None] * step), np.float64) - centre[which]).max(-1) > CONTRAST
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    offset = np.einsum("nk,nkd->nd", 0.5 * (low + high)[:, None] * step, corners[which])
    p = np.einsum("nad,nd->na", axes[which], offset) / samples.spacing
    n = len(rows)
    # The line u . p = 1 nearest to the places p in the sense of least squares.
    matrix = np.zeros((n, 2, 2)) + 1e-6 * np.eye(2)
    np.add.at(matrix, which, p[:, :, None] * p[:, None, :])
    total = np.zeros((n, 2))
    np.add.at(total, which, p)
    u = np.linalg.solve(matrix, total[..., None])[..., 0]
    size = np.maximum(lengths(u), 1e-12)
    return np.einsum("na,nad->nd", -u / size[:, None], axes), samples.spacing / size


def _seams(colours: Colours, corners: np.ndarray, edges: Edges, spacing: float) -> np.ndarray:
    """Which sides [T, 3] of triangles have another colour beyond; sides that are shorter than a Gaussian are not looked at."""
    seam = np.zeros(3 * len(corners), bool)
    one, other = edges.shared()
    t, k = np.divmod(one, 3)
    long = lengths(corners[t, (k + 1) % 3] - corners[t, k]) > spacing
    one, other = one[long], other[long]
    if not len(one):
        return seam.reshape(-1, 3)
    area = lengths(triangle_normals(corners))
    places, triangles = [], []
    both: tuple[tuple[np.ndarray, Any], ...] = (one, ALONG), (other, edges.mirrored(one, other, ALONG))
    for sides, shares in both:
        t, k = np.divmod(sides, 3)
        height = area[t] / np.maximum(lengths(corners[t, (k + 1) % 3] - corners[t, k]), 1e-30)
        inwards = np.minimum(ASIDE, ASIDE * spacing / np.maximum(height, 1e-30))
        weights = np.zeros((len(ALONG), len(sides), 3))
        n = np.arange(len(sides))
        for row, share in enumerate(shares):
            weights[row, n, (k + 2) % 3] = inwards
            weights[row, n, k] = (1 - inwards) * (1 - share)
            weights[row, n, (k + 1) % 3] = (1 - inwards) * share
        places.append(weights.reshape(-1, 3))
        triangles.append(np.tile(t, len(ALONG)))
    first, second = (np.asarray(colours(t, w), np.float64) for t, w in zip(triangles, places, strict=True))
    differs = (np.abs(first - second).max(-1) > CONTRAST).reshape(len(ALONG), -1).sum(0) > len(ALONG) / 2
    seam[one[differs]] = seam[other[differs]] = True
    return seam.reshape(-1, 3)
