# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorts pictures: resamples them as a pinhole camera would have taken them; cameras/lens.py has the geometry."""
from functools import lru_cache

import numpy as np

from ...cameras.camera import Camera
from ...cameras.lens import Intrinsics, Lens, inside, undistortion_map
from ...util.backends import load_backend
from ..capture import Shot


def resample(image: np.ndarray, source_positions: np.ndarray) -> np.ndarray:
    """The image [H, W, C] at undistortion_map()'s positions [h, w, 2]: [h, w, C] float32, in the image's own values.

    Cubic (Catmull-Rom, kept within the values around) where pixels keep their size; where the picture shrinks, the mean over each
    pixel's area, exact for whole factors.  0 outside the source.
    """
    image = np.ascontiguousarray(image if image.dtype in {np.dtype("uint8"), np.dtype("float32")} else image.astype(np.float32))
    return load_backend("cpu").resample(image, np.ascontiguousarray(source_positions, np.float32))


def positions_of(shot: Shot) -> np.ndarray | None:
    """undistortion_map() of a shot with a camera; None where its pixels are only scaled, if at all."""
    camera, image = shot.camera, shot.image
    assert camera is not None
    return _positions(image.lens, image.intrinsics, (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy))


@lru_cache(maxsize=8)
def _positions(lens: Lens, source: Intrinsics, target: tuple[int, int, float, float, float, float]) -> np.ndarray | None:
    camera = Camera(*target, np.eye(4))
    if lens.is_pinhole:
        sx, sy = camera.width / source.width, camera.height / source.height
        same = np.array([source.fx * sx, source.fy * sy, source.cx * sx, source.cy * sy])
        if np.abs(same - target[2:]).max() < 1e-6 * max(camera.width, camera.height):
            return None
    return undistortion_map(lens, source, camera)


def valid(shot: Shot) -> np.ndarray | None:
    """Mask [h, w], False where the lens has no picture of a pixel; None where it has one everywhere."""
    source = shot.image.intrinsics
    positions = None if shot.camera is None else positions_of(shot)
    if positions is None or source is None:
        return None
    seen = inside(positions, source.width, source.height)
    return None if seen.all() else seen
