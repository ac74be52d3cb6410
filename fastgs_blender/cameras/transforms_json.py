# SPDX-License-Identifier: GPL-3.0-or-later
"""What a transforms.json says of a picture's camera: pose, lens and intrinsics, at the top of the file or with each picture.

Poses are camera-to-world with OpenGL's camera axes; with OpenCV's where NeuS2's from_na stands at the top.
(nerfstudio, data/dataparsers/nerfstudio_dataparser.py; instant-ngp and NeuS2, nerf_loader.cu and nerf_loader.h)
"""
from collections.abc import Callable
from reprlib import repr as shortened

import numpy as np

from ..util.errors import FastGSError
from . import poses
from .lens import Intrinsics, Lens

LENSES = {"PINHOLE": "pinhole", "SIMPLE_PINHOLE": "pinhole", "OPENCV": "opencv", "SIMPLE_RADIAL": "opencv", "RADIAL": "opencv",
          "OPENCV_FISHEYE": "fisheye", "SIMPLE_RADIAL_FISHEYE": "fisheye", "RADIAL_FISHEYE": "fisheye", "FULL_OPENCV": "full"}
COEFFICIENTS = {"pinhole": (), "opencv": ("k1", "k2", "k3", "p1", "p2"), "fisheye": ("k1", "k2", "k3", "k4"),
                "full": ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")}
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "camera_model", "is_fisheye", *COEFFICIENTS["full"])
"""What stands at the top, or with each picture."""
MATRICES = ("K", "intrinsic_matrix")
"""A matrix in pixels, 3 x 3 or 4 x 4, which some files have in place of focal lengths and principal point; the second is NeuS2's."""


def given_for(values: dict, frame: dict, where: str) -> dict:
    """INTRINSICS that hold for a picture."""
    return {key: values[key] for key in INTRINSICS if key in values} | _of_matrix(values, where) | {
        key: frame[key] for key in INTRINSICS if frame.get(key) is not None} | _of_matrix(frame, where)


def _of_matrix(given: dict, where: str) -> dict:
    """What a matrix says, where there is one and no focal length beside it."""
    key = next((key for key in MATRICES if given.get(key) is not None), None)
    if key is None or given.get("fl_x") is not None:
        return {}
    side = 4 if isinstance(given[key], list) and len(given[key]) == 4 else 3
    matrix = poses.numbers(given[key], (side, side), f"{where}: its {key}")
    return {"fl_x": matrix[0, 0], "fl_y": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}


def fps_of(values: dict, where: object) -> float | None:
    """The frame rate, which our own files state."""
    return None if values.get("fps") is None else poses.number(values["fps"], f"{where}: its fps", 1e-3, 1e6)


def pose_of(values: dict, frame: dict, where: str) -> np.ndarray:
    """World-to-camera of a picture's transform_matrix; the scale of a Blender camera does not count."""
    value, where = frame.get("transform_matrix"), f"{where}: its transform_matrix"
    if isinstance(value, list) and len(value) == 3:
        value = [*value, [0, 0, 0, 1]]
    matrix = poses.numbers(value, (4, 4), where)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if lengths.min() < 1e-9:
        raise FastGSError(f"{where} is no pose: one of its axes has no length.")
    matrix[:3, :3] /= lengths
    camera_to_world = poses.rigid(matrix, where)
    return poses.inverse(camera_to_world) if "from_na" in values else poses.from_opengl(camera_to_world)


def intrinsics_of(given: dict, where: str, size: Callable[[], tuple[int, int]]) -> Intrinsics:
    """Checked intrinsics; size() gives the picture's where the file does not say it."""
    width, height = (given["w"], given["h"]) if "w" in given and "h" in given else size()
    width, height = (poses.integer(side, f"{where}: its {key}", 1) for key, side in (("w", width), ("h", height)))
    fx = given["fl_x"] if "fl_x" in given else _focal(given, "camera_angle_x", width, where)
    if fx is None:
        raise FastGSError(f"{where} lacks a focal length: fl_x, camera_angle_x or a matrix K.")
    fy = given.get("fl_y", _focal(given, "camera_angle_y", height, where) if "fl_x" not in given else None)
    fy = fx if fy is None else fy
    return poses.intrinsics(where, fx, fy, given.get("cx", width / 2), given.get("cy", height / 2), width, height)


def lens_of(given: dict, where: str) -> Lens:
    stated = given.get("camera_model", "OPENCV_FISHEYE" if given.get("is_fisheye") else "OPENCV")
    if not isinstance(stated, str) or stated not in LENSES:
        raise FastGSError(f"{where} has the camera_model {shortened(stated)}; only {', '.join(LENSES)} are known, so undistort the "
                          "pictures first.")
    model = LENSES[stated]
    names = COEFFICIENTS[model]
    values = {key: poses.number(given[key], f"{where}: its {key}") for key in COEFFICIENTS["full"] if key in given}
    extra = [key for key, value in values.items() if value and key not in names]
    if extra and model != "pinhole":
        raise FastGSError(f"{where} has {', '.join(extra)}, which {stated} does not have here; undistort the pictures first.")
    return Lens.named("opencv" if model == "full" else model, {key: value for key, value in values.items() if key in names})


def _focal(given: dict, key: str, side: float, where: str) -> float | None:
    if key not in given:
        return None
    return side / 2 / np.tan(poses.number(given[key], f"{where}: its {key}", 1e-6, np.pi - 1e-6) / 2)
