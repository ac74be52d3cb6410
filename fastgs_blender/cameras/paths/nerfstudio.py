# SPDX-License-Identifier: GPL-3.0-or-later
"""Nerfstudio's camera path, as its viewer writes it and ns-render camera-path reads it.

camera_path holds a camera a frame: camera_to_world (16 numbers, row by row, OpenGL axes), fov (degrees, vertical), aspect; beside it
render_width, render_height, fps, seconds.  keyframes are the viewer's, with the same matrices (nerfstudio, viewer/render_panel.py,
cameras/camera_paths.py).  The world is the trained scene's, z up.
"""
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from ...util.errors import FastGSError
from .. import poses
from ..camera import LARGEST_SIDE
from . import base
from .base import CameraPath, Picture

name, label = "nerfstudio", "Nerfstudio camera path"
MOST_KEYS = 60


def recognises(values: object) -> bool:
    return isinstance(values, dict) and isinstance(values.get("camera_path"), list)


def load(file: Path, values: dict, picture: Picture) -> CameraPath:
    kind = values.get("camera_type", "perspective")
    if str(kind).lower() != "perspective":
        raise FastGSError(f"{file}: its cameras are of the type {shortened(kind)}, and only perspective ones can be used here.")
    width, height = (poses.integer(values.get(key, default), f"{file}: its {key}", 1, LARGEST_SIDE)
                     for key, default in (("render_width", picture.width), ("render_height", picture.height)))
    base.check_frames(file, values["camera_path"])
    cameras = []
    for i, entry in enumerate(poses.listed(values["camera_path"], f"{file}: its camera_path")):
        where = f"{file}: frame {i}"
        entry = poses.table(entry, where)
        matrix = poses.numbers(entry.get("camera_to_world"), (16,), f"{where}: its camera_to_world").reshape(4, 4)
        pose = poses.from_opengl(poses.rigid(matrix, f"{where}: its camera_to_world"))
        cameras.append(base.symmetric(width, height, base.focal_of(entry.get("fov"), height, where), pose))
    fps = poses.number(values.get("fps", picture.fps), f"{file}: its fps", 1e-3, 1e6)
    return CameraPath(cameras, fps, axes="RFU", names=base.names_of(values["camera_path"]))


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    base.warn_of_losses(path, label)
    fps, first = path.fps or picture.fps, path.cameras[0]
    frames = [{"camera_to_world": base.opengl_to_world(camera).ravel().tolist(), "fov": base.degrees_of(camera.fy, camera.height),
               "aspect": camera.width / camera.height} for camera in path.cameras]
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), MOST_KEYS)).round().astype(int))
    gaps = np.diff(chosen, prepend=chosen[0]) / fps
    keys = [{"matrix": frames[i]["camera_to_world"], "fov": frames[i]["fov"], "aspect": frames[i]["aspect"],
             "override_transition_enabled": True, "override_transition_sec": float(gap)} for i, gap in zip(chosen, gaps)]
    base.write_json(file, {
        "default_fov": frames[0]["fov"], "default_transition_sec": 1 / fps, "keyframes": keys, "camera_type": "perspective",
        "render_height": first.height, "render_width": first.width, "fps": fps, "seconds": len(frames) / fps, "is_cycle": False,
        "smoothness_value": 0.0, "camera_path": base.named(frames, path), "crop": None})
