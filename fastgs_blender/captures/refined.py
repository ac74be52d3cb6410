# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures whose cameras are changed as a training run refined them (training/initial/refine.py)."""
from dataclasses import replace

import numpy as np

from ..cameras.poses import turned
from .capture import Capture, Shot


def refined(capture: Capture, changes: dict[str, dict]) -> Capture:
    """The capture with the cameras of some views changed; itself where nothing is to be changed.

    changes  of each view "turn", a rotation vector [3] in radians in the camera's axes; "shift" [3], a move of the camera in the world;
             "focal", a factor on its focal lengths
    """
    if not changes.keys() & set(capture.views):
        return capture
    return replace(capture, shots=[_changed(shot, changes[shot.view]) if shot.view in changes else shot for shot in capture.shots])


def _changed(shot: Shot, change: dict) -> Shot:
    if shot.camera is None:
        return shot
    given, focal, image = shot.camera.world_to_camera, change["focal"], shot.image
    pose = turned(given, np.array(change["turn"]))
    centre = np.subtract(change["shift"], given[:3, :3].T @ given[:3, 3])
    pose[:3, 3] = -pose[:3, :3] @ centre
    camera = replace(shot.camera, fx=shot.camera.fx * focal, fy=shot.camera.fy * focal, world_to_camera=pose)
    if image is not None and image.intrinsics is not None:  # a lens keeps its coefficients
        lens = image.intrinsics
        image = replace(image, intrinsics=lens._replace(fx=lens.fx * focal, fy=lens.fy * focal))
    return replace(shot, camera=camera, image=image)
