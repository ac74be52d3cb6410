# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json of INRIA's trainer and its derivatives as a path: entry after entry, frame after frame.  See ..cameras."""
from __future__ import annotations

from ..cameras_json import load_cameras
from .base import CameraPath, camera_to_world, refuse_orthographic, write_json

name, label = "cameras.json", "cameras.json (3D Gaussian Splatting)"


def recognises(values) -> bool:
    first = values[0] if isinstance(values, list) and values else values
    return isinstance(first, dict) and {"position", "rotation", "fx"} <= first.keys()


def load(file, values, picture) -> CameraPath:
    return CameraPath([view.camera for view in load_cameras(file)])


def save(path: CameraPath, file, picture) -> None:
    refuse_orthographic(path, label)
    write_json(file, [_entry(i, path.start_frame + i, camera) for i, camera in enumerate(path.cameras)])


def _entry(i, frame, camera) -> dict:
    pose = camera_to_world(camera)
    return {"id": i, "img_name": f"{frame:05d}", "width": camera.width, "height": camera.height, "position": pose[:3, 3].tolist(),
            "rotation": pose[:3, :3].tolist(), "fy": camera.fy, "fx": camera.fx, "cx": camera.cx, "cy": camera.cy}
