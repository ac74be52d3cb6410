# SPDX-License-Identifier: GPL-3.0-or-later
"""look_at(); numbers and poses from files, checked: those functions raise FastGSError with `where` (file and place) in front."""
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..util import rotations
from ..util.errors import FastGSError
from .camera import LARGEST_SIDE
from .lens import Intrinsics

FARTHEST = 1e12
"""Largest coordinate of a camera's place: beyond it sums and products of poses lose all digits."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes x right, y up, z backwards to OpenCV's."""


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """World-to-camera [4, 4] of an upright camera at a point `eye` [3] that looks at another, `target` [3].

    up  [3] what points up in the world: (0, 0, 1) in Blender's, (0, -1, 0) where a model's axes are RDF
    Raises FastGSError where both points are one, or the camera would look straight up or down.

    Example:
        camera = fg.Camera(640, 360, 500, 500, 320, 180, fg.look_at((2, -3, 1), (0, 0, 0.5)))
    """
    place = np.asarray(eye, np.float64)
    forward = np.asarray(target, np.float64) - place
    forward /= max(float(np.linalg.norm(forward)), 1e-300)
    right = np.cross(forward, np.asarray(up, np.float64))
    length = np.linalg.norm(right)
    if not length > 1e-9 * np.linalg.norm(up):
        raise FastGSError("a camera needs a point to look at that is not its own, nor straight above or below it.")
    turn = np.stack([right / length, np.cross(forward, right / length), forward])
    return rotations.transform(turn, -turn @ place)


def table(value: object, where: str) -> dict:
    """A JSON object."""
    if not isinstance(value, dict):
        raise FastGSError(f"{where} must be a table of named values, not {type(value).__name__}.")
    return value


def listed(value: object, where: str, least: int = 1) -> list:
    """A JSON list with at least so many items."""
    if not isinstance(value, list) or len(value) < least:
        raise FastGSError(f"{where} must be a list of at least {least}.")
    return value


def name_of(value: object, where: str) -> str:
    """A name: a JSON text that is not empty."""
    if not isinstance(value, str) or not value:
        raise FastGSError(f"{where} must be a text that is not empty, not {shortened(value)}.")
    return value


def check_names(names: Iterable[str], file: Path) -> None:
    """Raise FastGSError where two cameras of a file have one name."""
    twice = next((name for name, times in Counter(names).items() if times > 1), None)
    if twice is not None:
        raise FastGSError(f"{file}: camera {twice} is there twice; names must differ.")


def numbers(value: object, shape: tuple[int, ...] | None, where: str) -> np.ndarray:
    """Finite float64 of that shape; None: of any shape of at most two dimensions."""
    try:
        if isinstance(value, (str, bool, dict)):
            raise TypeError
        array = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(shape or 1, np.nan)
    if (array.ndim > 2 if shape is None else array.shape != shape) or not np.isfinite(array).all():
        count = "" if shape is None else " x ".join(map(str, shape)) + " "
        raise FastGSError(f"{where} must be {'a finite number' if shape == () else count + 'finite numbers'}.")
    return array


def number(value: object, where: str, low: float = -np.inf, high: float = np.inf) -> float:
    """A finite number from low to high."""
    found = float(numbers(value, (), where))
    if not low <= found <= high:
        raise FastGSError(f"{where} must lie between {low:g} and {high:g}, not at {found:g}.")
    return found


def read(text: str, where: str, low: float = -np.inf, high: float = np.inf) -> float:
    """A finite number from low to high that a text names."""
    try:
        return number(float(text), where, low, high)
    except (TypeError, ValueError) as error:
        raise FastGSError(f"{where} must be a number, not {shortened(text)}.") from error


def needed(values: dict, key: str, where: str | Path) -> Any:
    """A value that must be there."""
    if key not in values:
        raise FastGSError(f"{where}: it lacks {key}.")
    return values[key]


def integer(value: object, where: str, low: int = 0, high: int = 10**7) -> int:
    """A whole number from low to high."""
    found = number(value, where, low, high)
    if found != int(found):
        raise FastGSError(f"{where} must be a whole number, not {found:g}.")
    return int(found)


def intrinsics(where: str, fx: object, fy: object, cx: object, cy: object, width: object, height: object) -> Intrinsics:
    """Checked intrinsics; focal lengths above 0, sizes up to LARGEST_SIDE."""
    w, h = (integer(side, f"{where}: its {name}", 1, LARGEST_SIDE) for name, side in (("width", width), ("height", height)))
    x, y = (number(f, f"{where}: its focal length") for f in (fx, fy))
    if min(x, y) <= 0:
        raise FastGSError(f"{where}: its focal lengths must be above 0, not {x:g} and {y:g}.")
    u, v = (number(c, f"{where}: its principal point") for c in (cx, cy))
    return Intrinsics(x, y, u, v, w, h)


def rigid(value: object, where: str, tolerance: float = 1e-3) -> np.ndarray:
    """A rotation and a translation as [4, 4], from 4 x 4 or 3 x 4 numbers; the rotation is made exactly orthonormal."""
    rows = 3 if isinstance(value, (list, np.ndarray)) and len(value) == 3 else 4
    matrix = np.eye(4)
    matrix[:rows] = numbers(value, (rows, 4), where)
    rotation = matrix[:3, :3]
    if np.abs(rotation).max() > 2 or np.abs(rotation @ rotation.T - np.eye(3)).max() > tolerance or np.linalg.det(rotation) < 0:
        raise FastGSError(f"{where} must be a rotation (orthonormal, determinant +1) with a translation.")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise FastGSError(f"{where} must end with the row 0 0 0 1.")
    near(matrix[:3, 3], where)
    u, _, v = np.linalg.svd(rotation)
    matrix[:3, :3] = u @ v
    return matrix


def inverse(pose: np.ndarray) -> np.ndarray:
    """The inverse of a rotation with a translation [4, 4]."""
    turn = pose[:3, :3].T
    return rotations.transform(turn, -turn @ pose[:3, 3])


def turned(world_to_camera: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The pose [4, 4] of a camera before which the world is turned by a rotation vector [3], in radians, in the camera's own axes."""
    return rotations.transform(rotations.to_matrices(rotations.exp(turn / 2))) @ world_to_camera


def from_opengl(camera_to_world: np.ndarray) -> np.ndarray:
    """World-to-camera in OpenCV axes of a camera-to-world matrix whose camera looks along -z with y up."""
    return inverse(camera_to_world @ OPENGL)


def from_quaternion(quaternion: object, translation: object, where: str) -> np.ndarray:
    """World-to-camera [4, 4] of COLMAP's quaternion w x y z and translation."""
    q, t = numbers(quaternion, (4,), f"{where}: its quaternion"), numbers(translation, (3,), f"{where}: its translation")
    length = np.linalg.norm(q)
    if length < 1e-6 or not np.isfinite(length):
        raise FastGSError(f"{where}: its quaternion must not be 0.")
    return rotations.transform(rotations.to_matrices(q / length), near(t, where))


def near(place: np.ndarray, where: str) -> np.ndarray:
    """The place [3] of a camera, a translation, or several in one array, if within FARTHEST."""
    if np.abs(place).max(initial=0) > FARTHEST:
        raise FastGSError(f"{where}: the camera is farther than {FARTHEST:g} from the origin of its world; check its translation.")
    return place
