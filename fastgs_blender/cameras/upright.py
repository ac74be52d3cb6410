# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigid motions [4, 4] that put a capture's world upright, its ground on the plane z = 0."""
import numpy as np
from numpy.typing import ArrayLike

from ..util import rotations
from ..util.errors import FastGSError

LEAST_ANGLE = 1e-3
"""Three points whose triangle is flatter than this (the sine of its angle) lie on a line."""


def ground_from_points(points: ArrayLike, above: ArrayLike | None = None) -> np.ndarray:
    """The motion that lays three points [3, 3] on z = 0.

    above   a place on the upper side; None: the upper side is where z was larger
    The middle of the points keeps its x and y, and nothing turns further than it must.  Raises FastGSError for points on a line.
    """
    a, b, c = np.asarray(points, np.float64)
    across = np.cross(b - a, c - a)
    sides = np.linalg.norm(b - a) * np.linalg.norm(c - a)
    if not np.linalg.norm(across) > LEAST_ANGLE * sides or sides == 0:
        raise FastGSError("the three points lie on a line, or two of them at one place; choose others, far apart.")
    middle = (a + b + c) / 3
    up = across / np.linalg.norm(across)
    side = up[2] if above is None else up @ (np.asarray(above, np.float64) - middle)
    return _motion(-up if side < 0 else up, middle)


def ground_from_cameras(camera_to_world: np.ndarray, floor: float | None = None) -> np.ndarray:
    """The motion that makes z the direction that cameras [n, 4, 4] were held upright by (OpenCV axes), z = 0 at `floor`, a place.

    Up is what is most at right angles to all cameras' horizontal axes, as people and tripods hold them level; where these say too
    little (all the same), the mean of what the cameras call up.  Raises FastGSError where the cameras contradict each other.
    """
    matrices = np.asarray(camera_to_world, np.float64).reshape(-1, 4, 4)
    right, up = matrices[:, :3, 0], -matrices[:, :3, 1]
    mean = up.sum(0) / max(len(up), 1)
    if not np.linalg.norm(mean) >= 0.2:
        raise FastGSError("the cameras do not agree on which way is up; set the ground from three points instead.")
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    level = vectors[:, 0] * np.sign(vectors[:, 0] @ mean or 1.0)
    clear = values[1] > 0.02 and values[1] > 8 * values[0] and level @ mean > 0.5 * np.linalg.norm(mean)
    place = matrices[:, :3, 3].mean(0) if floor is None else np.asarray(floor, np.float64)
    return _motion(level if clear else mean / np.linalg.norm(mean), place)


def _motion(up: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Turns `up` [3] (unit) to z about `place` [3], the shortest way, and moves `place` to z = 0."""
    z = np.array([0.0, 0, 1])
    axis, cosine = np.cross(up, z), up @ z
    if cosine < -1 + 1e-12:
        turn = np.diag([1.0, -1, -1])
    else:
        x, y, w = axis
        cross = np.array([[0, -w, y], [w, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + cross + cross @ cross / (1 + cosine)
    return rotations.transform(turn, np.array([place[0], place[1], 0]) - turn @ place)
