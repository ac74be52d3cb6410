# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras as OpenCV's calibration gives them: a matrix, a vector of distortion, and the world's place in the camera.

OpenCV counts pixel centres in whole numbers, so that 0.5 is added to the principal point.  Its vector of distortion is k1 k2 p1 p2 k3
k4 k5 k6, of which the later ones may be missing; the fisheye model has k1 k2 k3 k4.
"""
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util import rotations
from ..util.errors import FastGSError
from . import poses
from .lens import Intrinsics, Lens

LARGEST_RIG = 50.0
"""Distance of two cameras beyond which a calibration without a unit is taken to count in millimetres: a rig of 50 m, or of 5 cm."""
MILLIMETRES = 1e-3
CLOSE = 2e-4
"""Focal lengths by which a fitted lens may be off: a fifth of a pixel where the focal length is 1000."""

UNTURN = ("calibrate it with upright pictures, or take the mark off the film that says that it is turned (ffmpeg -display_rotation 0 "
          "-i FILM -c copy NEW)")
"""What to do with a film that is read upright, and whose calibration is of unturned pictures."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A camera of a calibration file.

    name    as the file calls it
    matrix  [3, 3], pixel centres at whole numbers
    lens    its distortion, and skew
    pose    world-to-camera [4, 4], in the file's unit
    size    width and height of the calibrated pictures; None: the file does not say
    relative  the matrix counts in longer sides of a picture, from its middle
    """

    name: str
    matrix: np.ndarray
    lens: Lens
    pose: np.ndarray
    size: tuple[int, int] | None = None
    relative: bool = False

    def intrinsics(self, size: tuple[int, int], where: str) -> Intrinsics:
        """Intrinsics of pictures of that size, which may be smaller or larger than the calibrated ones; raises FastGSError where they
        have another shape."""
        m, given = self.matrix, self.size or size
        if self.relative:
            (fx, _, u), (_, fy, v) = m[:2] * max(size)
            return poses.intrinsics(where, fx, fy, size[0] / 2 + u, size[1] / 2 + v, *size)
        sx, sy = size[0] / given[0], size[1] / given[1]
        if abs(sx - sy) > 0.01 * sx:
            remedy = UNTURN if turned(size, given) else "give pictures that are neither cropped nor turned"
            raise FastGSError(f"{where}: it has {size[0]} x {size[1]} pixels, but camera {self.name} was calibrated for {given[0]} x "
                              f"{given[1]}; {remedy}.")
        return poses.intrinsics(where, m[0, 0] * sx, m[1, 1] * sy, (m[0, 2] + 0.5) * sx, (m[1, 2] + 0.5) * sy, *size)


def turned(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether pictures of one size have the shape of the other one, turned by a quarter."""
    return size[0] != size[1] and abs(size[0] * other[0] - size[1] * other[1]) <= 0.01 * size[0] * other[0]


def camera(name: str, where: str, matrix: object, distortion: object, rotation: object, translation: object,
           size: Any = None, fisheye: bool = False) -> Calibrated:
    """A checked camera; `where` (file and camera) is in front of each FastGSError.

    matrix       3 x 3
    distortion   None or the coefficients, a list or a matrix of them
    rotation     3 numbers (Rodrigues: axis times angle in radians) or 3 x 3, from world to camera
    translation  3 numbers: x_camera = rotation x_world + translation
    size         None, or width and height
    """
    matrix = poses.numbers(matrix, (3, 3), f"{where}: its matrix")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or np.abs(matrix[[1, 2, 2, 2], [0, 0, 1, 2]] - [0, 0, 0, 1]).max() > 1e-6:
        raise FastGSError(f"{where}: its matrix must be fx 0 cx, 0 fy cy, 0 0 1 with focal lengths above 0.")
    turn = np.squeeze(poses.numbers(rotation, None, f"{where}: its rotation"))
    turn = turn if turn.shape == (3, 3) else from_rodrigues(turn, f"{where}: its rotation")
    shift = poses.numbers(np.ravel(poses.numbers(translation, None, f"{where}: its translation")), (3,), f"{where}: its translation")
    pose = poses.rigid(rotations.transform(turn, shift), f"{where}: its rotation and translation")
    if size is not None:
        sides = poses.listed(list(size), f"{where}: its size", 2)[:2]
        size = tuple(poses.integer(side, f"{where}: its size", 1, 1 << 20) for side in sides)
    return Calibrated(name, matrix, lens_of(distortion, fisheye, matrix[0, 1] / matrix[0, 0], where), pose, size)


def lens_of(distortion: object, fisheye: bool, skew: float, where: str) -> Lens:
    """The lens with OpenCV's vector of distortion, None or of any length."""
    given = np.ravel(poses.numbers([] if distortion is None else distortion, None, f"{where}: its distortion"))
    most = 4 if fisheye else 8
    if np.any(given[most:]):
        raise FastGSError(f"{where}: its distortion has {len(given)} coefficients, and {most} are known here; calibrate it without thin "
                          "prisms and tilted sensors.")
    k = np.zeros(8)
    k[:min(len(given), most)] = given[:most]
    if fisheye:
        return Lens("fisheye", tuple(k[:4]), skew=skew)
    return Lens("opencv", (k[0], k[1], *k[4:]), (k[2], k[3]), skew)


def brown(k: Sequence[float], p: tuple[float, float], skew: float, reach: float, where: str) -> Lens:
    """The lens of Brown's k1 to k4 and OpenCV's p1, p2; one with k4 is fitted up to the radius `reach`, as OpenCV has no r^8."""
    if k[3]:
        lens = fitted(lambda r: r * np.polyval([*k[3::-1], 1], r**2), reach, where)
        return Lens("opencv", lens.k, p, skew)
    return Lens("opencv", tuple(k[:3]), p, skew)


def fitted(distorted: Callable[[np.ndarray], np.ndarray], reach: float, where: str) -> Lens:
    """The lens whose radii are those of a function of the pinhole's radius, up to `reach`; raises FastGSError where none comes close."""
    r = np.linspace(0, 1, 200) * reach
    to = distorted(r)
    s = (r / reach)**2
    rows = np.stack([r * s, r * s**2, r * s**3, -to * s], 1)  # k1 to k4: more make lenses that fold just outside
    k = np.linalg.lstsq(rows, to - r, rcond=1e-12)[0] / reach**np.array([2.0, 4, 6, 2])
    lens = Lens("opencv", tuple(k)) if np.isfinite(k).all() else Lens()
    if not np.abs(lens.distort(np.stack([r, 0 * r], 1))[:, 0] - to).max() < CLOSE:
        raise FastGSError(f"{where}: its distortion is too strong to be expressed here; undistort the pictures, then export again.")
    return lens


def from_rodrigues(vector: object, where: str) -> np.ndarray:
    """The rotation [3, 3] about an axis [3] by its length in radians."""
    vector = poses.numbers(vector, (3,), where)
    if np.abs(vector).max() > 1e3:
        raise FastGSError(f"{where} must be an axis times an angle in radians, not {vector[0]:g}, {vector[1]:g}, {vector[2]:g}.")
    return rotations.to_matrices(rotations.exp(vector / 2))


def metric(cameras: Sequence[Calibrated], unit: float | None) -> tuple[float, str]:
    """The length in metres of a calibration's unit, and a remark; `unit` is what the file says, or None.

    Without a unit, distances between cameras that no rig in metres has are taken for millimetres.
    """
    if unit is not None:
        return unit, "" if unit == 1 else f"its unit of {unit:g} m became metres"
    centres = np.array([poses.inverse(each.pose)[:3, 3] for each in cameras])
    width = float(np.linalg.norm(centres - centres[0], axis=1).max(initial=0))
    if width <= LARGEST_RIG:
        return 1.0, ""
    return MILLIMETRES, (f"its lengths are taken for millimetres, because two of its cameras are {width:.0f} apart: "
                         f"{width * MILLIMETRES:.3g} m now")


def upright_axes(given: Sequence[np.ndarray]) -> str:
    """The axes, of those that GaussianModel knows, whose upward direction is nearest to that of cameras with these poses [4, 4]."""
    up = -np.sum([pose[1, :3] for pose in given], 0)
    return max(("RDF", -up[1]), ("RFU", up[2]), ("RUB", up[1]), key=lambda pair: pair[1])[0]
