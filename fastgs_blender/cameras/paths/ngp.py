# SPDX-License-Identifier: GPL-3.0-or-later
"""instant-ngp's camera path: keyframes and the B-spline over them (src/camera_path.cu, include/.../camera_path.h).

    {"path": [{"R": [x, y, z, w], "T": [3], "fov": degrees (vertical), "slice", "scale", "aperture_size", "timestamp"}, ...],
     "loop", "time", "duration_seconds", "spline_order"}

Ours also say "fps", "width" and "height", which instant-ngp has no place for and ignores: their keyframes are their frames.

R, T: camera to world, OpenCV axes, in instant-ngp's own world: the capture's times 0.33 plus 0.5, axes cycled so that its x is the
capture's y (nerf_loader.h).  timestamp i is the second at which keyframe i + 1 is reached.  Orders: 0 steps, 1 lines, 2 and 3 uniform
B-splines, which pass by their keyframes.  Written with a keyframe a frame and order 1, so that it plays exactly.
"""
from pathlib import Path

import numpy as np

from ...util import rotations
from ...util.errors import FastGSError
from .. import poses
from ..camera import LARGEST_SIDE, Camera
from . import base
from .base import CameraPath, Picture

name, label = "instant-ngp", "instant-ngp camera path"
SCALE, OFFSET = 0.33, 0.5
CYCLE = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""From the capture's axes to instant-ngp's."""
SECONDS = 5.0
"""What instant-ngp's render dialogue begins with; the file of a path drawn by hand states no length."""
MANY = 16
"""From so many keyframes on instant-ngp takes each for a frame."""
WEIGHTS = {
    1: lambda t: (1 - t, t),
    2: lambda t: (0.5 * (1 - t) ** 2, 0.5 * (-2 * t * t + 2 * t + 1), 0.5 * t * t),
    3: lambda t: ((1 - t) ** 3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6, t**3 / 6),
}
"""Of the keyframes around a place t in [0, 1) of a segment, beginning with segment's first (order 1) or the one before it."""


def recognises(values: object) -> bool:
    entries = values.get("path") if isinstance(values, dict) else None
    return isinstance(entries, list) and bool(entries) and isinstance(entries[0], dict) and {"R", "T"} <= entries[0].keys()


def load(file: Path, values: dict, picture: Picture) -> CameraPath:
    base.check_frames(file, values["path"])
    keys = np.array([_key(entry, f"{file}: keyframe {i}") for i, entry in enumerate(values["path"])])
    if "fps" in values:
        width, height = (poses.integer(values.get(key), f"{file}: its {key}", 1, LARGEST_SIDE) for key in ("width", "height"))
        picture = Picture(width, height, poses.number(values["fps"], f"{file}: its fps", 1e-3, 1e6))
        return CameraPath([_camera(key, picture, f"{file}: keyframe {i}") for i, key in enumerate(keys)], picture.fps, axes="RFU",
                          names=base.names_of(values["path"]))
    order = poses.integer(values.get("spline_order", 3), f"{file}: its spline_order", 0, 3)
    loop = bool(values.get("loop", False))
    ends = _ends(file, values, len(keys), order, loop, picture.fps)
    last = ends[-1] if len(ends) else 0.0
    base.check_length(file, last * picture.fps + 1)
    frames = np.arange(int(last * picture.fps + 1e-6) + 1) / picture.fps
    cameras = [_camera(_blend(keys, ends, order, loop, at), picture, f"{file}: frame {i}") for i, at in enumerate(frames)]
    starts = [0.0, *ends][:len(keys)]
    return CameraPath(cameras, picture.fps, axes="RFU", keys=[
        (start * picture.fps, _camera(key, picture, f"{file}: keyframe {i}")) for i, (start, key) in enumerate(zip(starts, keys))])


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    base.warn_of_losses(path, label)
    fps, first = path.fps or picture.fps, path.cameras[0]
    keys = []
    for i, camera in enumerate(path.cameras):
        pose = base.camera_to_world(camera)
        w, x, y, z = rotations.from_matrices(CYCLE @ pose[:3, :3]).tolist()
        keys.append({"R": [x, y, z, w], "T": (CYCLE @ (pose[:3, 3] * SCALE + OFFSET)).tolist(), "slice": 0.0, "scale": 1.0,
                     "fov": base.degrees_of(camera.fy, camera.height), "aperture_size": 0.0, "timestamp": (i + 1) / fps})
    base.write_json(file, {"loop": False, "time": 0.0, "path": base.named(keys, path), "duration_seconds": len(keys) / fps,
                           "spline_order": 1, "fps": fps, "width": first.width, "height": first.height})


def _key(entry: object, where: str) -> np.ndarray:
    """x y z w, position, field of view: [8]."""
    given = poses.table(entry, where)
    turn = poses.numbers(given.get("R"), (4,), f"{where}: its R")
    length = np.linalg.norm(turn)
    if length < 1e-6:
        raise FastGSError(f"{where}: its rotation R must not be 0.")
    return np.array([*turn / length, *poses.near(poses.numbers(given.get("T"), (3,), f"{where}: its T"), where),
                     poses.number(given.get("fov"), f"{where}: its fov", 0.01, 179.9)])


def _ends(file: Path, values: dict, count: int, order: int, loop: bool, fps: float) -> np.ndarray:
    """Seconds at which the segments of the path end."""
    segments = count if loop else count - 1
    stamps = np.array([poses.number(entry.get("timestamp", 0), f"{file}: keyframe {i}: its timestamp", -1e15, 1e15)
                       for i, entry in enumerate(values["path"])])
    rising = bool((np.diff(stamps, prepend=0.0) > 0).all())
    by_hand = order != 1 and np.allclose(stamps, np.arange(1, count + 1) / count)
    if rising and not by_hand:
        return stamps[:segments]
    length = segments / fps if count >= MANY else SECONDS
    return length * np.arange(1, segments + 1) / max(segments, 1)


def _blend(keys: np.ndarray, ends: np.ndarray, order: int, loop: bool, at: float) -> np.ndarray:
    """The keyframe [8] at a time in seconds."""
    if len(keys) == 1:
        return keys[0]
    i = min(int(np.searchsorted(ends, at, side="right")), len(ends) - 1)
    begin = ends[i - 1] if i else 0.0
    t = (at - begin) / (ends[i] - begin)
    if order == 0:
        weights, first = (1.0,), i + round(t)
    else:
        weights, first = WEIGHTS[order](t), i if order == 1 else i - 1
    total = np.zeros(8)
    for k, weight in enumerate(weights):
        key = keys[(first + k) % len(keys) if loop else np.clip(first + k, 0, len(keys) - 1)]
        flip = -1.0 if key[:4] @ total[:4] < 0 else 1.0
        total += weight * np.concatenate([flip * key[:4], key[4:]])
    return total


def _camera(key: np.ndarray, picture: Picture, where: str) -> Camera:
    x, y, z, w = key[:4]
    rotation = CYCLE.T @ poses.from_quaternion((w, x, y, z), (0, 0, 0), where)[:3, :3]
    pose = rotations.transform(rotation, (CYCLE.T @ key[4:7] - OFFSET) / SCALE)
    return base.symmetric(picture.width, picture.height, base.focal_of(key[7], picture.height, where), poses.inverse(pose))
