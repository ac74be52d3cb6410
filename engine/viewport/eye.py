# SPDX-License-Identifier: GPL-3.0-or-later
"""Converts a 3D viewport's matrices to the library's camera."""
from dataclasses import dataclass

import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.kernels.gl.frame_table import Depths
from ...scene.camera import OPENCV

WHOLE = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class Eye(fg.Camera):
    """The camera of a 3D viewport.  Its window may be larger than the picture of the scene's camera that it shows.

    frame   where that picture lies: left, bottom, right, top, 0..1.  Splats are projected as that picture's camera would.
    """

    frame: tuple[float, float, float, float] = WHOLE

    def tangent_limits(self):
        left, bottom, right, top = self.frame
        width, height = self.width * (right - left), self.height * (top - bottom)
        picture = fg.Camera(1, 1, self.fx / width, self.fy / height, (self.cx - left * self.width) / width,
                            (self.cy - (1 - top) * self.height) / height, np.eye(4))
        return picture.tangent_limits()


def eye(width: int, height: int, view, window, divider: int = 1, frame=WHOLE) -> tuple[Eye, Depths]:
    """The camera of a region [width, height] with its view and window matrices, and the depth that its window stores.

    frame     where the picture of the camera lies that the region looks through, see Eye
    divider   how many of the region's pixels, in x and in y, one of the picture's covers
    An orthographic view also shows what lies behind its matrix's origin: its camera is moved back to where the view begins.
    """
    p, pose = np.array(window, np.float64), OPENCV @ np.array(view, np.float64)
    width, height = max(width // divider, 1), max(height // divider, 1)
    if p[3, 3] == 0:
        centre_x, centre_y = -p[0, 2], -p[1, 2]
        near = p[2, 3] / (p[2, 2] - 1)
        far = p[2, 3] / (p[2, 2] + 1) if p[2, 2] < -1 else np.inf  # single precision does not tell those very far away
        depths = Depths(0.5 - 0.5 * p[2, 2], 0.5 * p[2, 3])
    else:
        centre_x, centre_y = p[0, 3], p[1, 3]
        near, far = (1 + p[2, 3]) / p[2, 2], (p[2, 3] - 1) / p[2, 2]
        depths = Depths(0.5 + 0.5 * p[2, 3], -0.5 * p[2, 2])
        if near < 0:
            pose[2, 3] -= near
            far -= near
            depths = Depths(depths.a + depths.b * near, depths.b)
            near = 0.0
    camera = Eye(width, height, fx=width / 2 * p[0, 0], fy=height / 2 * p[1, 1], cx=width / 2 * (1 + centre_x),
                 cy=height / 2 * (1 - centre_y), world_to_camera=pose, orthographic=p[3, 3] != 0, near=max(near, 0.0), frame=frame, far=far)
    return camera, depths


def frame_in(window, frame) -> tuple[float, float, float, float]:
    """The rectangle in the picture of the projection `window` that the picture of the projection `frame` fills: left, bottom, right, top
    in 0..1."""
    w, f = np.array(window, np.float64), np.array(frame, np.float64)
    out = []
    for edge in (-1, 1):
        for axis in (0, 1):
            if w[3, 3] == 0:
                at = w[axis, axis] * (edge + f[axis, 2]) / f[axis, axis] - w[axis, 2]
            else:
                at = w[axis, axis] * (edge - f[axis, 3]) / f[axis, axis] + w[axis, 3]
            out.append(0.5 + 0.5 * at)
    return tuple(out)
