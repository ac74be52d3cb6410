# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of the shader that removes overlays behind splats (glsl/covering.py), as one row of a texture."""
from __future__ import annotations

from enum import IntEnum

import numpy as np

from ...fastgs_blender.cameras.camera import Camera
from .frame_table import Depths

MARKS = 2
"""Places in the window that stay as they are: the 3D cursor and the active object's origin, which Blender draws over everything."""


class CoveringTexel(IntEnum):
    """Places in the row.

    SIZE        width and height of the picture, orthographic
    WINDOW      width and height of the window
    LENS        fx, fy, cx, cy
    HEIGHT      row of the matrix from the camera's space to the world that gives the height over the floor
    DEPTHS      see Depths; whether the floor's grid is drawn
    FIRST_MARK  x, y from the lower left corner, radius, in the window's pixels; MARKS of them
    """

    SIZE = 0
    WINDOW = 1
    LENS = 2
    HEIGHT = 3
    DEPTHS = 4
    FIRST_MARK = 5


def covering_table(camera: Camera, depths: Depths, window: tuple[int, int], floor: bool, marks) -> np.ndarray:
    """float32 [1, texels, 4]; marks is a list of (x, y, radius)."""
    at = CoveringTexel
    values = np.zeros((1, at.FIRST_MARK + MARKS, 4), np.float32)
    row = values[0]
    row[at.SIZE, :3] = camera.width, camera.height, camera.orthographic
    row[at.WINDOW, :2] = window
    row[at.LENS] = camera.fx, camera.fy, camera.cx, camera.cy
    row[at.HEIGHT] = np.linalg.inv(camera.world_to_camera)[2]
    row[at.DEPTHS, :3] = depths.a, depths.b, floor
    for number, mark in enumerate(marks[:MARKS]):
        row[at.FIRST_MARK + number, :3] = mark
    return values
