# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json of INRIA's trainer and its derivatives as a path: entry after entry, frame after frame.  See ..cameras."""
from pathlib import Path

from ..cameras_json import View, load_cameras, save_cameras
from .base import CameraPath, Picture, frame_names, warn_of_rate

name, label = "cameras.json", "cameras.json (3D Gaussian Splatting)"


def recognises(values: object) -> bool:
    first = values[0] if isinstance(values, list) and values else values
    return isinstance(first, dict) and {"position", "rotation", "fx"} <= first.keys()


def load(file: Path, values: list, picture: Picture) -> CameraPath:
    views = load_cameras(file)
    return CameraPath([view.camera for view in views], names=[view.name for view in views])


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    warn_of_rate(path, label)
    save_cameras([View(name, camera) for name, camera in zip(path.names or frame_names(path), path.cameras, strict=True)], file)
