# SPDX-License-Identifier: GPL-3.0-or-later
"""Viewpoints of a model's surroundings as cameras, and cameras as viewpoints."""
import numpy as np

from ..model.surroundings import Viewpoint
from ..util.rotations import from_matrices, to_matrices, transform, unit
from .camera import Camera


def camera_of(viewpoint: Viewpoint) -> Camera:
    """The pinhole camera of a viewpoint, in the model's space."""
    pose = transform(to_matrices(unit(np.array(viewpoint.rotation))[None])[0], viewpoint.position)
    return Camera(viewpoint.width, viewpoint.height, viewpoint.fx, viewpoint.fy, viewpoint.cx, viewpoint.cy, np.linalg.inv(pose))


def viewpoint_of(camera: Camera, name: str = "", distance: float = 0.0) -> Viewpoint:
    """A perspective camera as a viewpoint; what it looks at is `distance` away (0: not known)."""
    pose = np.linalg.inv(camera.world_to_camera)
    x, y, z, *turn = (round(float(v), 9) for v in (*pose[:3, 3], *from_matrices(pose[None, :3, :3])[0]))
    qw, qx, qy, qz = turn
    lens = {key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")}
    return Viewpoint(width=camera.width, height=camera.height, **lens, position=(x, y, z), rotation=(qw, qx, qy, qz),
                     distance=float(distance), name=name)
