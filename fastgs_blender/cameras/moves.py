# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves: paths through space that are smooth in position, direction, field of view and speed.

A move is a function of s in [0, 1], the share of the way that lies behind the camera; an ease turns time into s.  Directions
are unit quaternions, w x y z, camera to world, in whatever axes the caller's camera has.
"""
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..util import rotations
from ..util.errors import FastGSError

TABLE = 2048
"""Samples of a spline from which lengths are read."""
MOST_FRAMES = 50_000
"""Frames of a move: more than half an hour at 24 frames per second."""
BLOCK = 4096
"""Places whose nearest ones in a region are found at once."""
STEPS = 400
"""Steps in which the nearest place of a region is approached."""


@dataclass(frozen=True, eq=False)
class Path:
    """M samples of a move.

    position   [M, 3]
    rotation   [M, 4]  unit quaternions of one sign: neighbours never point away from each other
    focal      [M]     focal length in whatever unit the caller uses
    """

    position: np.ndarray
    rotation: np.ndarray
    focal: np.ndarray


def check_range(first: int, last: int) -> None:
    """Raises FastGSError for a range of frames that is empty, or longer than MOST_FRAMES."""
    if last <= first:
        raise FastGSError("the last frame must come after the first.")
    if last - first >= MOST_FRAMES:
        raise FastGSError(f"the range from frame {first} to {last} has {last - first + 1} frames, and a move has at most {MOST_FRAMES}; "
                          "choose a shorter one.")


def ease(u: ArrayLike, amount: float) -> np.ndarray:
    """Share of the way at the share u of the time: `amount` of the time, half at each end, is spent starting and stopping.

    0 is constant speed; the speed rises and falls smoothly and never jumps within the move.
    """
    u, ramp = np.clip(np.asarray(u, np.float64), 0, 1), 0.5 * min(max(amount, 0.0), 1.0)
    if ramp == 0:
        return u
    # the speed is (1 - cos(pi u / ramp)) / 2 while it rises, so the way is its integral
    def rise(v: Any) -> Any:
        return 0.5 * (v - ramp / np.pi * np.sin(np.pi * v / ramp))

    way = np.where(u < ramp, rise(u), np.where(u > 1 - ramp, (1 - ramp) - rise(1 - u), u - 0.5 * ramp))
    return way / (1 - ramp)


def orbit(s: ArrayLike, centre: ArrayLike, radius: float, elevation: float, start: float, turns: float, focal: float,
          rise: float = 0.0) -> Path:
    """Around `centre` [3] at a distance, looking at it; z is up, angles in radians, `turns` may be negative.

    elevation  above the horizon at the start; it changes by `rise` along the way
    start      angle around z of the first position, from x on
    Directions are those of a camera that looks along -z with y up (Blender, OpenGL).
    """
    s = np.asarray(s, np.float64)
    around, above = start + 2 * np.pi * turns * s, elevation + rise * s
    out = np.stack([np.cos(around) * np.cos(above), np.sin(around) * np.cos(above), np.sin(above)], -1)
    # right = z x out, which never vanishes on the way, unlike a comparison with the up axis
    right = np.stack([-np.sin(around), np.cos(around), np.zeros_like(s)], -1)
    matrix = np.stack([right, np.cross(out, right), out], -1)
    return Path(np.asarray(centre) + radius * out, rotations.one_sign(rotations.from_matrices(matrix)), np.full(s.shape, float(focal)))


def dolly(s: ArrayLike, position: ArrayLike, rotation: np.ndarray, direction: ArrayLike, distance: float, focal: float,
          subject: float | None = None) -> Path:
    """Straight on from `position` [3] along `direction` [3] by `distance`, the view turned as it is.

    subject  distance of what keeps its size in the picture while the camera comes nearer (a dolly zoom); None: the lens stays.
    Raises FastGSError where the camera would reach the subject.
    """
    s = np.asarray(s, np.float64)
    direction = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    lens = np.full(s.shape, float(focal))
    if subject is not None:
        if subject <= 0 or distance >= subject:
            raise FastGSError("a dolly zoom cannot reach its subject; shorten the way or choose a subject farther off.")
        lens = focal * (subject - distance * s) / subject
    return Path(np.asarray(position) + distance * s[..., None] * direction, np.broadcast_to(rotation, s.shape + (4,)).copy(), lens)


def through(s: ArrayLike, poses: Path, closed: bool = False) -> Path:
    """A spline through the poses in their order, at a speed that is even along the way.

    Position and logarithm of the focal length are cubic splines with continuous second derivatives, direction is a spherical
    quadrangle spline (Shoemake 1987), which between two poses is the slerp.
    """
    count = len(poses.position)
    if count < 2 + closed:
        raise FastGSError(f"a {'closed path needs three' if closed else 'path needs two'} cameras at least; select more.")
    rows = np.append(np.arange(count), 0) if closed else np.arange(count)
    rotation = rotations.one_sign(poses.rotation[rows])
    points = np.concatenate([poses.position, np.log(poses.focal)[:, None]], 1)[rows]
    knots = np.arange(len(rows), dtype=np.float64)
    second = _second_derivatives(points, closed)
    fine = np.linspace(0, knots[-1], TABLE)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(_cubic(fine, points, second)[:, :3], axis=0), axis=1))])
    if length[-1] <= 0:  # the camera only turns
        length = fine.copy()
    u = np.interp(np.asarray(s, np.float64) * length[-1], length, fine)
    at = _cubic(u, points, second)
    return Path(at[:, :3], _squad(u, rotation, closed), np.exp(at[:, 3]))


def order_by_place(position: ArrayLike, closed: bool = False, first: int = 0) -> np.ndarray:
    """The order [N] of a short way through all places [N, 3]: from each to the nearest that is left, then 2-opt (Croes 1958).

    A closed way begins at `first`, an open one at that of its ends which is nearer to `first`.  Same places keep their order.
    """
    position = np.asarray(position, np.float64)
    count = len(position)
    away = np.zeros((count + 1, count + 1))  # an open way is a closed one through another place, which is near to all
    away[:count, :count] = np.linalg.norm(position[:, None] - position[None], axis=2)
    tour, left = [first], [k for k in range(count) if k != first]
    while left:
        tour.append(left.pop(int(np.argmin(away[tour[-1], left]))))
    if not closed:
        tour.append(count)
    way = np.array(tour)
    least = 1e-9 * max(away.max(), 1e-30)
    improved = True
    while improved:
        improved = False
        for i in range(len(way) - 2):
            here, then = way[i], way[i + 1]
            ends, after = way[i + 2:], np.roll(way, -1)[i + 2:]
            saved = away[here, then] + away[ends, after] - away[here, ends] - away[then, after]
            best = int(np.argmax(saved))
            if saved[best] > least:
                way[i + 1:i + 3 + best] = way[i + 1:i + 3 + best][::-1].copy()
                improved = True
    if closed:
        return np.roll(way, -int(np.flatnonzero(way == first)[0]))
    way = np.roll(way, -int(np.flatnonzero(way == count)[0]))[1:]
    return way if away[first, way[0]] <= away[first, way[-1]] else way[::-1]


def inside(path: Path, cameras: ArrayLike, margin: float) -> np.ndarray:
    """How far [M] each position lies outside the region that the captured cameras [C, 3] span, 0 within.

    The region is the convex hull of their places, grown by `margin` to all sides.
    """
    beyond = np.linalg.norm(path.position - _nearest(path.position, np.asarray(cameras, np.float64)), axis=1)
    return np.maximum(beyond - margin, 0)


def clamp_to_hull(path: Path, cameras: ArrayLike, margin: float) -> Path:
    """The path with its positions moved to the nearest place of the region (see inside)."""
    near = _nearest(path.position, np.asarray(cameras, np.float64))
    away = path.position - near
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    return replace(path, position=near + away * np.minimum(1, margin / np.maximum(distance, 1e-30)))


def _second_derivatives(points: np.ndarray, closed: bool) -> np.ndarray:
    """Of the cubic spline through points [K, D] at whole numbers: natural at its ends, or without ends."""
    n = len(points)
    if closed:
        n -= 1
        system = 4 * np.eye(n) + np.roll(np.eye(n), 1, 0) + np.roll(np.eye(n), -1, 0)
        right = 6 * (np.roll(points[:n], -1, 0) - 2 * points[:n] + np.roll(points[:n], 1, 0))
        solved = np.linalg.solve(system, right)
        return np.concatenate([solved, solved[:1]])
    second = np.zeros_like(points)
    if n > 2:
        system = 4 * np.eye(n - 2) + np.eye(n - 2, k=1) + np.eye(n - 2, k=-1)
        second[1:-1] = np.linalg.solve(system, 6 * (points[2:] - 2 * points[1:-1] + points[:-2]))
    return second


def _cubic(u: np.ndarray, points: np.ndarray, second: np.ndarray) -> np.ndarray:
    i = np.clip(u.astype(int), 0, len(points) - 2)
    b = (u - i)[:, None]
    a = 1 - b
    return a * points[i] + b * points[i + 1] + ((a**3 - a) * second[i] + (b**3 - b) * second[i + 1]) / 6


def _squad(u: np.ndarray, q: np.ndarray, closed: bool) -> np.ndarray:
    """Spherical quadrangle spline through q [K, 4] at whole numbers."""
    onward, back = np.roll(q, -1, 0), np.roll(q, 1, 0)
    if closed:
        onward[-1], back[0] = q[1], q[-2]
    else:
        onward[-1], back[0] = q[-1], q[0]
    onward, back = (np.where((q * other).sum(-1, keepdims=True) < 0, -other, other) for other in (onward, back))
    to_next, to_last = (rotations.log(rotations.multiply(rotations.inverse(q), other)) for other in (onward, back))
    control = rotations.multiply(q, rotations.exp(-0.25 * (to_next + to_last)))
    if not closed:  # an end has no neighbour beyond it: it is its own control, so that two poses give the slerp
        control[0], control[-1] = q[0], q[-1]
    i = np.clip(u.astype(int), 0, len(q) - 2)
    b = (u - i)[:, None]
    between, beside = rotations.slerp(q[i], q[i + 1], b), rotations.slerp(control[i], control[i + 1], b)
    return rotations.one_sign(rotations.slerp(between, beside, 2 * b * (1 - b)))


def _nearest(points: np.ndarray, cameras: np.ndarray) -> np.ndarray:
    """The nearest places [M, 3] of the cameras' convex hull (Frank-Wolfe with pairwise steps, which ends in few)."""
    if len(points) > BLOCK:
        return np.concatenate([_nearest(points[i:i + BLOCK], cameras) for i in range(0, len(points), BLOCK)])
    rows, count = np.arange(len(points)), len(cameras)
    share = np.full((len(points), count), 1 / count)
    for _ in range(STEPS):
        slope = (points - share @ cameras) @ cameras.T
        onto, off = slope.argmax(1), np.where(share > 0, slope, np.inf).argmin(1)
        way = cameras[onto] - cameras[off]
        step = (slope[rows, onto] - slope[rows, off]) / np.maximum((way**2).sum(1), 1e-30)
        step = np.minimum(step, share[rows, off])
        share[rows, onto] += step
        share[rows, off] -= step
    return share @ cameras
