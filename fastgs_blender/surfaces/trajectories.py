# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits the paths and rotations of places on a moving surface by coefficients in time."""
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..model.fitting import Fit, choose, motion_families, rotation_families
from ..model.motion import Basis, Static
from ..util.threads import ranges, run
from .borders import CROSSING, FLAT, distance_to_borders, find_borders, mesh_edges
from .colours import Painted, paint
from .sampling import SurfaceSamples, lengths, sample_surface, triangle_normals
from .tangents import tangents

STILL = 1e-4
"""Motion of less than this share of the object's size counts as no motion."""
FOLLOW = 0.1
"""However small the motion, the fit leaves at most this share of it: a breathing chest must not freeze within the tolerance."""
STEP = 3e-5
"""Mean error of the motion from one frame to the next, as a share of the object's size, that more terms are spent on: the Vector pass shows
it.  It is 0.03 pixels where the object is 1000 pixels large."""
CHEAP = 20
"""Number of terms that are spent on it at most, twice as many as the paper's models have, or twice as many as places need."""
ENOUGH = 0.7
"""More terms are worth it if they leave at most this share of that error."""
TURN = np.radians(1.0)
"""Mean error of rotations, in radians, that the order of their basis is chosen for."""
MARGIN = 0.97
"""Orders are chosen on some of the samples for this share of the tolerance, so that all samples stay within the tolerance."""

WIDTH = 0.85
"""Standard deviation in the surface, as a multiple of the distance of neighbours.  Less leaves the gaps of an even sampling open (an opaque
sheet has at least 96 % alpha everywhere at 0.85, 84 % at 0.7); more blurs texture and outline."""
NARROWEST, WIDEST = 0.2, 3.0
"""Limits of a Gaussian's width, as multiples of the usual one, where the surface is stretched or ends."""
TO_BORDER = 0.8
"""Standard deviation across a border, as a multiple of the distance to it: alpha has fallen to 0.46 there (0.7 at flat ones, borders.FLAT).
The two sides of an edge, or the layers of a solid, are opaque together, and little sticks out: with 1.2 half as many pixels again show what
lies before them, beside the outlines of Suzanne; with 0.6 a few pixels along its edges have less than 95 % alpha."""

PROBES = 3000
"""Number of samples that orders are chosen by; each part has at least a tenth of so many."""
TAIL = 99
"""The percentile of the distances that has a tolerance of its own: a mean hides a hand that is followed badly."""
COUNTED = 4_000_000
"""Number of distances that their mean and percentile are taken from, about, where there are more."""
BATCH = 1000
"""Number of samples whose largest distances are looked at together."""
CHUNK = 1_000_000
"""Numbers held at once by a thread while fitting, so that they stay in the processor's cache."""


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
        parts = [np.unique(self.triangles[self.part == p]) for p in range(self.part.max() + 1)]
        return np.array([np.median([np.ptp(self.positions[s][part], axis=0).max() for s in self._key_times]) for part in parts])

    def corners(self, triangles: Any, times: slice | int = slice(None)) -> np.ndarray:
        """Corners [S, n, 3 corners, 3] float64 of some triangles."""
        return self.positions[times][..., self.triangles[triangles], :].astype(np.float64)

    def spread(self, count: int) -> SurfaceSamples:
        """Evenly spread places, dense enough for the largest area that each triangle ever has."""
        return sample_surface(self.positions[self.pose], self.triangles, count, self.areas.max(0))

    def follow(self, samples: SurfaceSamples, which: Any) -> np.ndarray:
        """Paths [S, n, 3] of some of the samples."""
        return np.einsum("snkd,nk->snd", self.corners(samples.triangle[which]), samples.weights[which])

    def painted(self, colours: Any, samples: SurfaceSamples, for_samples: bool) -> Painted:
        """The samples' colours; see colours.paint()."""
        corners = self.corners(slice(None), self.pose)
        return paint(colours, corners, mesh_edges(self.positions[self.pose], self.triangles), samples, for_samples)

    def distance_to_borders(self, samples: SurfaceSamples, painted: Painted, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """In the pose of reference, the direction [N, 3] across the nearest border and the distances [N, 2]; see borders.py.

        Edges of colour are borders too.
        """
        corners = self.corners(samples.triangle, self.pose)
        normal = triangle_normals(corners)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        position = np.einsum("nkd,nk->nd", corners, samples.weights)
        borders = find_borders(self.positions[self.pose], self.triangles, self.patch, painted.seam)
        across, distance = distance_to_borders(borders, position, normal, reach)
        seam = FLAT * painted.distance
        nearer = seam < distance[:, 0]
        crossing = np.abs(np.einsum("nd,nd->n", across, painted.across)) < CROSSING
        distance[:, 1] = np.where(nearer & crossing, np.minimum(distance[:, 0], distance[:, 1]), distance[:, 1])
        distance[:, 0] = np.where(nearer, seam, distance[:, 0])
        return np.where(nearer[:, None], painted.across, across), distance


@dataclass(frozen=True, eq=False)
class Paths:
    """The paths of N samples in a basis: constant [N, 3], coefficients [N, K, 3].

    part, mean, tail, largest  the part that is followed worst for its size, and the mean and the percentile TAIL (of COUNTED where
                               there are more) and the largest of the distances from the true paths over its samples and all times
    sample, time               where on that part and at which of the times the distance is largest
    """

    basis: Basis
    constant: np.ndarray
    coefficients: np.ndarray
    part: int
    mean: float
    tail: float
    largest: float
    sample: int
    time: int


@dataclass(frozen=True, eq=False)
class Turning:
    """Rotation and in-plane size of flat Gaussians, of which U turn differently.

    row [N]            for each sample, its row of the next two
    constant [U, 4], coefficients [U, R, 4]  of the quaternion in the basis
    width [N, 2]       standard deviations along the frame's x and y
    residual           mean angle between fitted and true rotation, radians
    """

    basis: Basis
    row: np.ndarray
    constant: np.ndarray
    coefficients: np.ndarray
    width: np.ndarray
    residual: float


def choose_paths(surface: MovingSurface, samples: SurfaceSamples, t: np.ndarray, frame: float, basis: str, tolerance: float,
                 tail: float, max_order: int) -> tuple[Basis, bool]:
    """The smallest basis of positions that keeps every part within the tolerances of the mean and of the percentile, else the closest one;
    and whether it keeps to them.  Where so many terms as CHEAP says bring the steps from frame to frame within STEP, or are off by ENOUGH
    less, they are taken.  For these steps keyframes compete too: no series follows a steady turn that is not a whole one, because it is not
    smooth where it begins again.

    frame  the length of a frame, in the unit of the times t
    """
    part, sizes = surface.part[samples.triangle], surface.sizes
    probes = _probes(part, PROBES)
    paths, part = surface.follow(samples, probes), part[probes]

    def distances(fit: Callable[[np.ndarray], tuple]) -> np.ndarray:
        return lengths(fit(paths)[1] - paths)

    def means(distance: np.ndarray) -> np.ndarray:
        return np.bincount(part, distance.mean(0), len(sizes)) / np.maximum(np.bincount(part, minlength=len(sizes)), 1)

    def tails(distance: np.ndarray) -> np.ndarray:
        return np.array([np.percentile(distance[:, part == p], TAIL) if (part == p).any() else 0.0 for p in range(len(sizes))])

    def error(fit: Callable[[np.ndarray], tuple]) -> float:
        distance = distances(fit)
        return max((means(distance) / allowed).max(), (tails(distance) / (MARGIN * tail * sizes)).max())

    def steps(fit: Callable[[np.ndarray], tuple]) -> float:
        off = fit(paths)[1] - paths
        return (means(lengths(off[lag:] - off[:-lag])) / (STEP * sizes)).max()

    motion = means(distances(Fit.of(Static(), t)))
    allowed = np.maximum(np.minimum(MARGIN * tolerance * sizes, FOLLOW * motion), min(STILL, tolerance) * sizes)
    moving, lag = len(t) > 1, int(np.clip(round(frame / np.median(np.diff(t))), 1, len(t) - 1)) if len(t) > 1 else 0
    families = motion_families(basis, t if moving else np.array([0.0, 1.0]))
    chosen = choose(families if moving else [], t, error, max_order)
    distance = distances(Fit.of(chosen, t))
    kept = bool((means(distance) <= MARGIN * tolerance * sizes).all() and (tails(distance) <= MARGIN * tail * sizes).all())
    off = steps(Fit.of(chosen, t)) if kept and chosen.terms else 0.0
    if off > 1:
        families = families + (motion_families("keyframes", t) if basis == "auto" else [])
        steadier = Fit.of(choose(families, t, lambda fit: max(error(fit), steps(fit)), max_order, max(2 * chosen.terms, CHEAP)), t)
        chosen = steadier.basis if error(steadier) <= 1 and steps(steadier) <= max(1, ENOUGH * off) else chosen
    return chosen, kept


def fit_paths(surface: MovingSurface, samples: SurfaceSamples, t: np.ndarray, frame: float, basis: str, tolerance: float, tail: float,
              max_order: int, progress: Callable[[float], None]) -> Paths:
    """Positions by least squares, in the basis of choose_paths()."""
    part, sizes = surface.part[samples.triangle], surface.sizes
    chosen, _ = choose_paths(surface, samples, t, frame, basis, tolerance, tail, max_order)
    fit = Fit.of(chosen, t)
    constant = np.empty((len(samples), 3), np.float32)
    coefficients = np.empty((len(samples), chosen.terms, 3), np.float32)
    measured = _probes(part, max(COUNTED // len(t), PROBES))
    distance = np.empty((len(measured), len(t)), np.float32)
    bound = np.empty(len(samples), np.float32)

    def piece(start: int, stop: int) -> None:
        # A fit is linear, so that it commutes with the mean of a triangle's corners: each vertex is fitted once.
        vertices, corner = np.unique(surface.triangles[samples.triangle[start:stop]], return_inverse=True)
        paths = surface.positions[:, vertices].astype(np.float64)
        solution, fitted = fit(paths)
        corner, weights = corner.reshape(-1, 3), samples.weights[start:stop]
        blended = _blend(solution, corner, weights)
        constant[start:stop], coefficients[start:stop] = blended[:, 0], blended[:, 1:]
        off = (fitted - paths).astype(np.float32)
        bound[start:stop] = np.einsum("nk,nk->n", lengths(off).max(0)[corner], weights)
        first, last = np.searchsorted(measured, (start, stop))
        own = measured[first:last] - start
        distance[first:last] = lengths(_blend(off, corner[own], weights[own].astype(np.float32)))

    run(piece, ranges(len(samples), _rows(12 * len(t))), progress)
    errors = [distance[part[measured] == p] for p in range(len(sizes))]
    mean = np.array([values.mean(dtype=np.float64) if values.size else 0.0 for values in errors])
    percentile = np.array([np.percentile(values, TAIL) if values.size else 0.0 for values in errors])
    worst = int((np.maximum(mean / tolerance, percentile / tail) / sizes).argmax())
    largest, sample, time = _farthest(surface, samples, fit, np.flatnonzero(part == worst), bound)
    return Paths(chosen, constant, coefficients, worst, float(mean[worst]), float(percentile[worst]), largest, sample, time)


def _farthest(surface: MovingSurface, samples: SurfaceSamples, fit: Fit, which: np.ndarray, bound: np.ndarray) -> tuple[float, int, int]:
    """(distance, sample, time): of some samples, that which the fit leaves farthest from its path, and when.

    bound [N]  what the distances of each sample do not exceed; most samples need not be looked at
    """
    order = which[np.argsort(-bound[which], kind="stable")]
    best = 0.0, int(order[0]), 0
    for start, stop in ranges(len(order), BATCH):
        rows = order[start:stop]
        if start and bound[rows[0]] <= best[0]:
            break
        paths = surface.follow(samples, rows)
        away = lengths(fit(paths)[1] - paths)
        time, row = np.unravel_index(away.argmax(), away.shape)
        best = max(best, (float(away[time, row]), int(rows[row]), int(time)), key=lambda found: found[0])
    return best


def _blend(values: np.ndarray, corner: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The mean [n, S, 3] of the values [S, V, 3] of three vertices each, corner [n, 3], with weights [n, 3]."""
    rows = np.ascontiguousarray(np.moveaxis(values, 0, 1)).reshape(values.shape[1], -1)
    total = rows[corner[:, 0]] * weights[:, :1]
    for k in (1, 2):
        part = rows[corner[:, k]]
        part *= weights[:, k:k + 1]
        total += part
    return total.reshape(len(corner), len(values), 3)


def fit_turning(surface: MovingSurface, samples: SurfaceSamples, painted: Painted, t: np.ndarray, moving: bool, max_order: int,
                progress: Callable[[float], None]) -> Turning:
    """Quaternions of the tangent frames by least squares, in the smallest basis that turns them right to TURN on average.

    Gaussians near a border lie along it and are no wider than reaches it.  Those of a triangle along one border turn alike, and so do those
    along none.
    """
    basis: Basis = Static()
    if moving:
        probes = samples.triangle[_probes(np.zeros(len(samples), int), PROBES)]
        truth = tangents(surface.corners(probes), surface.pose).rotation
        basis = choose(rotation_families(t), t, lambda fit: _angles(fit(truth)[1], truth).mean() / TURN, max_order)

    usual = WIDTH * samples.spacing
    across, distance = surface.distance_to_borders(samples, painted, usual / TO_BORDER)
    first, row = _alike(samples.triangle, across)
    triangles, across = samples.triangle[first], across[first]
    limit = np.clip(TO_BORDER * distance / usual, NARROWEST, 1)

    fit = Fit.of(basis, t)
    constant = np.empty((len(triangles), 4), np.float32)
    coefficients = np.empty((len(triangles), basis.terms, 4), np.float32)
    stretch = np.empty((len(triangles), 2))

    def piece(start: int, stop: int) -> float:
        used, which = np.unique(triangles[start:stop], return_inverse=True)
        frames = tangents(surface.corners(used), surface.pose, across[start:stop], which)
        solution = fit.coefficients(frames.rotation)
        constant[start:stop], coefficients[start:stop] = solution[0], np.moveaxis(solution[1:], 0, 1)
        stretch[start:stop] = frames.stretch
        some = np.arange(-start % every, stop - start, every)
        return float(_angles(fit.values(solution[:, some]), frames.rotation[:, some]).sum())

    every = -(-len(triangles) * len(t) // COUNTED)
    total = sum(run(piece, ranges(len(triangles), _rows(40 * len(t))), progress))
    # Samples were spread by the largest area: in the pose of reference they lie closer than the mean by this factor.
    largest, pose = surface.areas.max(0)[triangles], surface.areas[surface.areas.sum(1).argmax()][triangles]
    stretch *= np.sqrt(np.where(pose > 0, pose / np.maximum(largest, 1e-300), 1))[:, None]
    width = usual * np.clip(stretch, NARROWEST, WIDEST)[row] * limit
    return Turning(basis, row, constant, coefficients, width, total / (-(-len(triangles) // every) * len(t)))


def _alike(triangle: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first [U], row [N]) of samples on triangles [N] with directions [N, 3]: for each that is different its first sample, and which of
    them each sample is like.
    """
    order = np.lexsort((*across.T, triangle))
    new = np.ones(len(order), bool)
    new[1:] = (triangle[order[1:]] != triangle[order[:-1]]) | (across[order[1:]] != across[order[:-1]]).any(1)
    row = np.empty(len(order), np.int64)
    row[order] = np.cumsum(new) - 1
    return order[new], row


def _angles(fitted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Angles between rotations given as quaternions [..., 4], of which the fitted are not of unit length."""
    length = np.maximum(lengths(fitted), 1e-30)
    return 2 * np.arccos(np.clip(np.abs(np.einsum("...d,...d->...", fitted, truth)) / length, 0, 1))


def _probes(part: np.ndarray, count: int) -> np.ndarray:
    """Indices, increasing, of about `count` evenly spaced samples; of each part at least a tenth of PROBES."""
    found = []
    for p in np.unique(part):
        own = np.flatnonzero(part == p)
        wanted = min(max(count * len(own) // len(part), PROBES // 10), len(own))
        found.append(own if wanted == len(own) else own[np.unique(np.linspace(0, len(own) - 1, wanted).astype(int))])
    return np.sort(np.concatenate(found))


def _rows(numbers: int) -> int:
    """How many rows of so many numbers are worked on at once."""
    return max(CHUNK // max(numbers, 1), 64)
