# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits the paths and rotations of places on a moving surface by coefficients in time."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..model.fitting import Fit, choose, motion_families, rotation_families
from ..model.motion import Basis, Static
from .borders import distance_to_borders, find_borders
from .sampling import SurfaceSamples, sample_surface, triangle_normals
from .tangents import plane, tangents

STILL = 1e-4
"""Motion of less than this share of the object's size counts as no motion."""
FOLLOW = 0.1
"""However small the motion, the fit leaves at most this share of it: a breathing chest must not freeze within the tolerance."""
TURN = np.radians(1.0)
"""Mean error of rotations, in radians, that the order of their basis is chosen for."""
MARGIN = 0.97
"""Orders are chosen on some of the samples for this share of the tolerance, so that all samples stay within the tolerance."""

WIDTH = 0.85
"""Standard deviation in the surface, as a multiple of the distance of neighbours.  Less leaves the gaps of an even sampling open (an opaque
sheet has at least 96 % alpha everywhere at 0.85, 84 % at 0.7); more blurs texture and outline."""
NARROWEST, WIDEST = 0.3, 3.0
"""Limits of a Gaussian's width, as multiples of the usual one, where the surface is stretched or ends."""
TO_BORDER = 1.2
"""Standard deviation across a border, as a multiple of the distance to it: alpha has fallen to 0.7 there.  The two sides of an edge, or the
layers of a solid, are opaque together, and little sticks out."""

PROBES = 3000
"""Number of samples that orders are chosen by; each part has at least a tenth of so many."""
CHUNK = 16_000_000
"""Numbers held at once while fitting: 128 MB."""


@dataclass(frozen=True, eq=False)
class MovingSurface:
    """Triangles [T, 3] on vertices that are known at S times, positions [S, V, 3].

    part [T] numbers the objects 0 .. P - 1, patch [T] the areas of one colour.
    """

    positions: np.ndarray
    triangles: np.ndarray
    part: np.ndarray
    patch: np.ndarray

    @cached_property
    def _key_times(self) -> np.ndarray:
        return np.unique(np.linspace(0, len(self.positions) - 1, 32).astype(int))

    @cached_property
    def areas(self) -> np.ndarray:
        """Area of each triangle [K, T] at up to 32 of the times."""
        return np.stack([0.5 * np.linalg.norm(triangle_normals(self.corners(slice(None), s)), axis=-1) for s in self._key_times])

    @cached_property
    def pose(self) -> int:
        """The time of reference: that at which the whole surface is largest."""
        return int(self._key_times[self.areas.sum(1).argmax()])

    @cached_property
    def sizes(self) -> np.ndarray:
        """Size of each part [P]: the largest side of its bounding box, the median over the times."""
        return np.array([self._size(np.unique(self.triangles[self.part == p])) for p in range(self.part.max() + 1)])

    def _size(self, vertices) -> float:
        return float(np.median([np.ptp(self.positions[s][vertices], axis=0).max() for s in self._key_times]))

    def corners(self, triangles, times=slice(None)) -> np.ndarray:
        """Corners [S, n, 3 corners, 3] float64 of some triangles."""
        return self.positions[times][..., self.triangles[triangles], :].astype(np.float64)

    def spread(self, count: int) -> SurfaceSamples:
        """Evenly spread places, dense enough for the largest area that each triangle ever has."""
        return sample_surface(self.positions[self.pose], self.triangles, count, self.areas.max(0))

    def follow(self, samples: SurfaceSamples, which) -> np.ndarray:
        """Paths [S, n, 3] of some of the samples."""
        return np.einsum("snkd,nk->snd", self.corners(samples.triangle[which]), samples.weights[which])

    def footprints(self, samples: SurfaceSamples) -> np.ndarray:
        """Barycentric weights [7, N, 3] of a Gaussian's centre and six places around it, over which its colour is the mean.

        None lies outside a large triangle; a small one is taken as a piece of a smooth surface that continues around it.
        """
        corners = self.corners(samples.triangle, self.pose)
        _, inverse, flat = plane(corners[:, 1:] - corners[:, :1])
        large = np.linalg.norm(triangle_normals(corners), axis=1) > 16 * samples.spacing**2
        angles = np.arange(6) * np.pi / 3
        ring = 0.5 * samples.spacing * np.stack([np.cos(angles), np.sin(angles)], 1)
        factors = np.where(flat[:, None], 0, np.einsum("nkm,am->ank", inverse, ring))
        factors /= np.maximum(np.abs(factors).max(-1, keepdims=True) / 4, 1)
        weights = samples.weights + np.concatenate([-factors.sum(-1, keepdims=True), factors], -1)
        inside = np.maximum(weights, 0)
        weights = np.where(large[:, None], inside / inside.sum(-1, keepdims=True), weights)
        return np.concatenate([samples.weights[None], weights])

    def distance_to_borders(self, samples: SurfaceSamples, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """In the pose of reference, the direction [N, 3] across the nearest border and the distances [N, 2]; see borders.py."""
        points = self.positions[self.pose]
        corners = self.corners(samples.triangle, self.pose)
        normal = triangle_normals(corners)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        position = np.einsum("nkd,nk->nd", corners, samples.weights)
        return distance_to_borders(find_borders(points, self.triangles, self.patch), position, normal, reach)


@dataclass(frozen=True, eq=False)
class Paths:
    """The paths of N samples in a basis: constant [N, 3], coefficients [N, K, 3].

    part, mean and largest: of the part that is followed worst for its size, its number and the distances
    from the true paths over all samples and times.
    """

    basis: Basis
    constant: np.ndarray
    coefficients: np.ndarray
    part: int
    mean: float
    largest: float


@dataclass(frozen=True, eq=False)
class Turning:
    """Rotation and in-plane size of flat Gaussians, U different ones.

    row [N]            for each sample, its row below
    constant [U, 4], coefficients [U, R, 4]  of the quaternion in the basis
    width [U, 2]       standard deviations along the frame's x and y
    residual           mean angle between fitted and true rotation, radians
    """

    basis: Basis
    row: np.ndarray
    constant: np.ndarray
    coefficients: np.ndarray
    width: np.ndarray
    residual: float


def fit_paths(surface: MovingSurface, samples: SurfaceSamples, t: np.ndarray, basis: str, tolerance: float, max_order: int,
              progress: Callable[[float], None]) -> Paths:
    """Positions by least squares, in the smallest basis that keeps the mean distance of every part within the tolerance."""
    part = surface.part[samples.triangle]
    probes = _probes(part)
    probe_paths, probe_part = surface.follow(samples, probes), part[probes]
    sizes = surface.sizes

    def means(fit):
        distance = np.linalg.norm(fit(probe_paths)[1] - probe_paths, axis=-1).mean(0)
        return np.bincount(probe_part, distance, len(sizes)) / np.maximum(np.bincount(probe_part, minlength=len(sizes)), 1)

    motion = means(Fit.of(Static(), t))
    allowed = np.maximum(np.minimum(MARGIN * tolerance * sizes, FOLLOW * motion), min(STILL, tolerance) * sizes)
    chosen = choose(motion_families(basis, t) if len(t) > 1 else [], t, lambda fit: (means(fit) / allowed).max(), max_order)

    fit = Fit.of(chosen, t)
    constant = np.empty((len(samples), 3), np.float32)
    coefficients = np.empty((len(samples), chosen.terms, 3), np.float32)
    total, largest = np.zeros(len(sizes)), np.zeros(len(sizes))
    for rows in _chunks(len(samples), 20 * len(t), progress):
        paths = surface.follow(samples, rows)
        solution, fitted = fit(paths)
        constant[rows], coefficients[rows] = solution[0], np.moveaxis(solution[1:], 0, 1)
        distance = np.linalg.norm(fitted - paths, axis=-1)
        total += np.bincount(part[rows], distance.mean(0), len(sizes))
        np.maximum.at(largest, part[rows], distance.max(0))
    mean = total / np.maximum(np.bincount(part, minlength=len(sizes)), 1)
    worst = int((mean / sizes).argmax())
    return Paths(chosen, constant, coefficients, worst, float(mean[worst]), float(largest[worst]))


def fit_turning(surface: MovingSurface, samples: SurfaceSamples, t: np.ndarray, moving: bool, max_order: int,
                progress: Callable[[float], None]) -> Turning:
    """Quaternions of the tangent frames by least squares, in the smallest basis that turns them right to TURN on average.

    Gaussians near a border lie along it and are no wider than reaches it; the others of a triangle are all alike.
    """
    basis: Basis = Static()
    if moving:
        probes = samples.triangle[_probes(np.zeros(len(samples), int))]
        truth = tangents(surface.corners(probes), surface.pose).rotation
        basis = choose(rotation_families(t), t, lambda fit: _angles(fit(truth)[1], truth).mean() / TURN, max_order)

    usual = WIDTH * samples.spacing
    across, distance = surface.distance_to_borders(samples, usual / TO_BORDER)
    bordering = across.any(1)
    row = np.unique(np.where(bordering, len(surface.triangles) + np.arange(len(samples)), samples.triangle), return_inverse=True)[1]
    first = np.empty(row.max() + 1, np.int64)
    first[row] = np.arange(len(samples))
    triangles, across = samples.triangle[first], across[first]
    limit = np.clip(TO_BORDER * distance[first] / usual, NARROWEST, 1)

    fit = Fit.of(basis, t)
    constant = np.empty((len(triangles), 4), np.float32)
    coefficients = np.empty((len(triangles), basis.terms, 4), np.float32)
    stretch = np.empty((len(triangles), 2))
    total = 0.0
    for rows in _chunks(len(triangles), 80 * len(t), progress):
        frames = tangents(surface.corners(triangles[rows]), surface.pose, across[rows])
        solution, fitted = fit(frames.rotation)
        constant[rows], coefficients[rows], stretch[rows] = solution[0], np.moveaxis(solution[1:], 0, 1), frames.stretch
        total += float(_angles(fitted, frames.rotation).sum())
    # Samples were spread by the largest area: in the pose of reference they lie closer than the mean by this factor.
    largest, pose = surface.areas.max(0)[triangles], surface.areas[surface.areas.sum(1).argmax()][triangles]
    stretch *= np.sqrt(np.where(pose > 0, pose / np.maximum(largest, 1e-300), 1))[:, None]
    width = usual * np.clip(stretch, NARROWEST, WIDEST) * limit
    return Turning(basis, row, constant, coefficients, width, total / (len(triangles) * len(t)))


def _angles(fitted, truth) -> np.ndarray:
    """Angles between rotations given as quaternions [..., 4], of which the fitted are not of unit length."""
    length = np.maximum(np.linalg.norm(fitted, axis=-1), 1e-30)
    return 2 * np.arccos(np.clip(np.abs(np.einsum("...d,...d->...", fitted, truth)) / length, 0, 1))


def _probes(part: np.ndarray) -> np.ndarray:
    """Indices of evenly spaced samples of each part."""
    found = []
    for p in np.unique(part):
        own = np.flatnonzero(part == p)
        wanted = max(PROBES * len(own) // len(part), PROBES // 10)
        found.append(own[np.unique(np.linspace(0, len(own) - 1, wanted).astype(int))])
    return np.concatenate(found)


def _chunks(n: int, numbers: int, progress: Callable[[float], None]):
    """Slices of 0..n for which `numbers` a row stay within CHUNK."""
    step = max(CHUNK // max(numbers, 1), 1)
    for start in range(0, n, step):
        progress(start / n)
        yield slice(start, min(start + step, n))
    progress(1.0)
