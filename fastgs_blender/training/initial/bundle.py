# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundle adjustment: poses, focal lengths and points that fit tracks of features best, with a prior around the given cameras.

Levenberg-Marquardt on the cameras' normal equations, from which the points are eliminated (Schur complement; Triggs et al., "Bundle
Adjustment - A Modern Synthesis", 2000).  The loss is Cauchy's, so that wrong matches hardly count.  What the tracks do not tell (where
the world lies as a whole, how large it is, cameras that share few features) stays as it was given, because of the prior.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...util import rotations

NOISE = 2.0
"""Standard deviation of a feature's place, in pixels: how much a track counts beside the prior.  A single feature is four times as good,
but its errors are much the same at all moments and in cameras side by side, and do not average out.  With 0.5, the focal lengths of a
whole rig drift together, by half a percent in a kitchen that 18 cameras film."""
TURN, SHIFT, FOCAL = np.radians(0.3), 0.001, 0.005
"""Standard deviations of the prior: of a camera's rotation, of its place in distances to what it sees, of its focal length."""
WIDTHS, STEPS = (4.0, 1.0), 20
"""Widths of the loss in pixels, one after another, and steps that are tried with each."""
SETTLED = 1e-5
"""Share of the loss; a step that gains less is the last."""
POINT_STEPS = 12
BLOCK = 512
"""Points that are eliminated at once."""


@dataclass(frozen=True, eq=False)
class Rig:
    """V cameras that stand still.

    turns    [V, 3, 3] rotations from the world to the camera; centres [V, 3]
    pixels   [V, 2] focal lengths as they were given, in pixels
    shrink   [V] the given focal length divided by the true one
    lens     [V] number of each camera's lens: cameras with one lens have one focal length
    """

    turns: np.ndarray
    centres: np.ndarray
    pixels: np.ndarray
    shrink: np.ndarray
    lens: np.ndarray


@dataclass(frozen=True, eq=False)
class Tracks:
    """N features of P points, in the order of the points.

    camera, point   [N] whose they are
    rays            [N, 2] x / z and y / z in the camera's axes, by the given focal length
    slopes          [N, 2] derivative of these by Rig.shrink: the same numbers, but where a lens distorts
    """

    camera: np.ndarray
    point: np.ndarray
    rays: np.ndarray
    slopes: np.ndarray

    def __len__(self) -> int:
        return int(self.point[-1]) + 1 if len(self.point) else 0

    def take(self, which: np.ndarray) -> Tracks:
        """The tracks of the points for which `which` [P] is true."""
        keep = which[self.point]
        return Tracks(self.camera[keep], (np.cumsum(which) - 1)[self.point[keep]], self.rays[keep], self.slopes[keep])

    def by_point(self, values: np.ndarray) -> np.ndarray:
        """Sums [P, ...] of values [N, ...] over each point's features."""
        return np.add.reduceat(values, np.searchsorted(self.point, np.arange(len(self))))


def misses(rig: Rig, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    """Pixels [N, 2] between the points [P, 3] as the rig sees them and the features; huge behind a camera."""
    local = _local(rig, tracks, points)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = local[:, :2] / local[:, 2:] - _planes(rig, tracks)
    return np.where(local[:, 2:] > 0, off * _focal(rig, tracks), 1e6)


def track_errors(rig: Rig, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    """Root mean squared distance [P] in pixels between each point and its features."""
    squares = tracks.by_point(np.c_[(misses(rig, tracks, points) ** 2).sum(1), np.ones(len(tracks.point))])
    return np.sqrt(squares[:, 0] / squares[:, 1])


def placed(rig: Rig, tracks: Tracks) -> np.ndarray:
    """The points [P, 3] that fit the tracks best as the cameras are: nearest to their rays, then by Gauss-Newton steps in pixels."""
    plane = _planes(rig, tracks)
    rays = np.einsum("nji,nj->ni", rig.turns[tracks.camera], np.c_[plane, np.ones(len(plane))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    system = tracks.by_point(across)
    scale = np.trace(system, axis1=1, axis2=2)[:, None, None] * 1e-9 * np.eye(3)
    points = _solved(system + scale, tracks.by_point(np.einsum("nij,nj->ni", across, rig.centres[tracks.camera])))
    best = track_errors(rig, tracks, points)
    for _ in range(POINT_STEPS):
        off, _, slope = _slopes(rig, tracks, points)
        weight = _weights(off, WIDTHS[-1])[:, None]
        square = tracks.by_point(np.einsum("nki,nkj->nij", slope * weight[..., None], slope))
        square += 1e-6 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
        tried = points - _solved(square, tracks.by_point(np.einsum("nki,nk->ni", slope, off * weight)))
        error = track_errors(rig, tracks, tried)
        points, best = np.where((error < best)[:, None], tried, points), np.minimum(error, best)
    return points


def adjusted(rig: Rig, tracks: Tracks, points: np.ndarray) -> tuple[Rig, np.ndarray]:
    """The rig and the points after adjustment."""
    given, tightness = rig, _tightness(rig, tracks, points)
    for width in WIDTHS:
        damping, cost = 1e-4, _cost(given, rig, tracks, points, width, tightness)
        for _ in range(STEPS):
            tried_rig, tried = _stepped(given, rig, tracks, points, width, tightness, damping)
            now = _cost(given, tried_rig, tracks, tried, width, tightness)
            if now < cost:
                gain, rig, points, cost, damping = 1 - now / cost, tried_rig, tried, now, max(damping / 10, 1e-9)
                if gain < SETTLED:
                    break
            elif damping > 1e4:
                break
            else:
                damping *= 10
    return rig, points


def turned(rig: Rig, given: Rig) -> np.ndarray:
    """Rotation vectors [V, 3], in radians, from the given cameras' axes to the rig's."""
    return 2 * rotations.log(rotations.from_matrices(np.einsum("vij,vkj->vik", rig.turns, given.turns)))


def turned_by(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Rotations [V, 3, 3] after a further turn by rotation vectors [V, 3] in the cameras' axes."""
    return rotations.to_matrices(rotations.exp(vectors / 2)) @ turns


def _local(rig: Rig, tracks: Tracks, points: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", rig.turns[tracks.camera], points[tracks.point] - rig.centres[tracks.camera])


def _planes(rig: Rig, tracks: Tracks) -> np.ndarray:
    """The features' places [N, 2] on the image plane, by the rig's focal lengths."""
    return tracks.rays + (rig.shrink[tracks.camera] - 1)[:, None] * tracks.slopes


def _focal(rig: Rig, tracks: Tracks) -> np.ndarray:
    """Focal lengths [N, 2] in pixels: an error is that of the feature in its picture, whose pixels stay where they are."""
    return rig.pixels[tracks.camera] / rig.shrink[tracks.camera, None]


def _weights(off: np.ndarray, width: float) -> np.ndarray:
    """Of squared errors in pixels [N]: Cauchy's, by the features' noise."""
    return 1 / (1 + (off**2).sum(1) / width**2) / NOISE**2


def _solved(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.linalg.solve(matrices, right[..., None])[..., 0]


def _tightness(rig: Rig, tracks: Tracks, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1 / variance of the prior [V, 6] of rotation and place, and [L] of the lenses' focal lengths."""
    away = np.linalg.norm(points[tracks.point] - rig.centres[tracks.camera], axis=1)
    usual = np.median(away)
    near = [np.median(away[tracks.camera == v]) if (tracks.camera == v).any() else usual for v in range(len(rig.turns))]
    poses = np.repeat([[TURN**-2, 1.0]], len(near), 0).repeat(3, 1)
    poses[:, 3:] /= (SHIFT * np.array(near)[:, None]) ** 2
    return poses, np.full(rig.lens.max() + 1, FOCAL**-2)


def _departure(given: Rig, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """What the prior is about: [V, 6] rotation vectors and moves of the cameras, [L] changes of focal lengths."""
    lenses = np.zeros(rig.lens.max() + 1)
    lenses[rig.lens] = rig.shrink - 1
    return np.c_[turned(rig, given), rig.centres - given.centres], lenses


def _cost(given: Rig, rig: Rig, tracks: Tracks, points: np.ndarray, width: float, tightness: tuple[np.ndarray, np.ndarray]) -> float:
    squares = (misses(rig, tracks, points) ** 2).sum(1)
    prior = sum((tight * off**2).sum() for tight, off in zip(tightness, _departure(given, rig)))
    return width**2 / NOISE**2 * np.log1p(squares / width**2).sum() + prior


def _slopes(rig: Rig, tracks: Tracks, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """misses [N, 2], and their derivatives by the camera's turn, place and shrink [N, 2, 7] and by the point [N, 2, 3]."""
    local = _local(rig, tracks, points)
    depth = np.where(local[:, 2] > 0, local[:, 2], np.inf)
    x, y, zero = local[:, 0] / depth, local[:, 1] / depth, np.zeros(len(local))
    plane = np.stack([np.stack([1 / depth, zero, -x / depth], 1), np.stack([zero, 1 / depth, -y / depth], 1)], 1)
    plane *= _focal(rig, tracks)[:, :, None]
    turning = np.cross(local[:, None], plane)  # d (w x q) = w . (q x row)
    by_point = plane @ rig.turns[tracks.camera]
    off = np.where(np.isfinite(depth)[:, None], misses(rig, tracks, points), 0.0)
    by_shrink = -(tracks.slopes * _focal(rig, tracks) + off / rig.shrink[tracks.camera, None])[:, :, None]
    return off, np.concatenate([turning, -by_point, by_shrink], 2), by_point


def _stepped(given: Rig, rig: Rig, tracks: Tracks, points: np.ndarray, width: float,
             tightness: tuple[np.ndarray, np.ndarray], damping: float) -> tuple[Rig, np.ndarray]:
    """Rig and points after one damped Gauss-Newton step."""
    count, lenses = len(rig.turns), rig.lens.max() + 1
    size = 6 * count + lenses
    off, by_camera, by_point = _slopes(rig, tracks, points)
    weight = _weights(off, width)[:, None]
    columns = np.c_[6 * tracks.camera[:, None] + np.arange(6), 6 * count + rig.lens[tracks.camera]]  # [N, 7] in the unknowns
    weighted = by_camera * weight[..., None]
    matrix, right = np.zeros((size, size)), np.zeros(size)
    np.add.at(matrix, (columns[:, :, None], columns[:, None]), np.einsum("nki,nkj->nij", weighted, by_camera))
    np.add.at(right, columns, np.einsum("nki,nk->ni", weighted, off))
    for tight, place, begin in zip(tightness, _departure(given, rig), (0, 6 * count)):
        unknowns = begin + np.arange(place.size)
        matrix[unknowns, unknowns] += tight.ravel()
        right[unknowns] += (tight * place).ravel()
    matrix[np.arange(size), np.arange(size)] *= 1 + damping
    own = tracks.by_point(np.einsum("nki,nkj->nij", by_point * weight[..., None], by_point))
    own += damping * own * np.eye(3) + 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
    pull = tracks.by_point(np.einsum("nki,nk->ni", by_point, off * weight))
    mixed = np.einsum("nki,nkj->nij", weighted, by_point)
    halves = np.linalg.inv(np.linalg.cholesky(own))  # own^-1 = halves^T halves
    for first in range(0, len(points), BLOCK):
        rows = slice(*np.searchsorted(tracks.point, (first, first + BLOCK)))
        part = halves[first:first + BLOCK]
        table = np.zeros((len(part), size, 3))
        np.add.at(table, (tracks.point[rows, None] - first, columns[rows]), mixed[rows])
        table = np.einsum("psj,pij->psi", table, part).transpose(1, 0, 2).reshape(size, -1)
        matrix -= table @ table.T
        right -= table @ np.einsum("pij,pj->pi", part, pull[first:first + BLOCK]).ravel()
    step = -np.linalg.solve(matrix, right)
    back = tracks.by_point(np.einsum("nij,ni->nj", mixed, step[columns]))
    poses = step[:6 * count].reshape(count, 6)
    moved = replace(rig, turns=turned_by(rig.turns, poses[:, :3]), centres=rig.centres + poses[:, 3:],
                    shrink=rig.shrink + step[6 * count:][rig.lens])
    return moved, points - np.einsum("pki,pkj,pj->pi", halves, halves, pull + back)
