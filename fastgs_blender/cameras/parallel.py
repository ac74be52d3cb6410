# SPDX-License-Identifier: GPL-3.0-or-later
"""Orthographic cameras that look at a box from any direction."""
import numpy as np

from .camera import Camera


def parallel_camera(towards: np.ndarray, low: np.ndarray, high: np.ndarray, pixels: int) -> Camera:
    """A camera of pixels x pixels that sees the whole box from low [3] to high [3]; towards: the unit vector [3] from the box to it."""
    right = np.cross(np.eye(3)[np.abs(towards).argmin()], -towards)
    right /= np.linalg.norm(right)
    pose, width = np.eye(4), max(float(np.linalg.norm(high - low)), 1e-9)
    pose[:3, :3] = right, np.cross(-towards, right), -towards
    pose[:3, 3] = -pose[:3, :3] @ ((low + high) / 2 + width * towards)
    return Camera(pixels, pixels, pixels / width, pixels / width, pixels / 2, pixels / 2, pose, orthographic=True)
