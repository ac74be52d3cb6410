# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS camera paths: everything that a Camera and a CameraPath hold.

    {"format": "fast-gs camera path", "version": 1, "fps": 24, "start_frame": 1, "axes": "RDF",
     "frames": [{"width", "height", "fx", "fy", "cx", "cy", "world_to_camera": 4 x 4}, ...]}

Optional: each frame's "name".  Optional "keys" are frames with a "frame" more: their number from 0.
"""
from pathlib import Path
from reprlib import repr as shortened

from ...model.gaussians import AXES
from ...util.errors import FastGSError
from .. import poses
from ..camera import Camera
from .base import CameraPath, Picture, check_frames, named, names_of, write_json

name, label = "fastgs", "FAST-GS camera path"
FORMAT, VERSION = "fast-gs camera path", 1


def recognises(values: object) -> bool:
    return isinstance(values, dict) and values.get("format") == FORMAT


def load(file: Path, values: dict, picture: Picture) -> CameraPath:
    version = poses.integer(values.get("version", VERSION), f"{file}: its version", 1, 10**6)
    if version > VERSION:
        raise FastGSError(f"{file}: its version {version} is newer than this program, which knows version {VERSION}; update it.")
    axes = values.get("axes", "RDF")
    if axes not in AXES:
        raise FastGSError(f"{file}: its axes must be one of {', '.join(AXES)}, not {shortened(axes)}.")
    frames = poses.listed(values.get("frames"), f"{file}: its frames")
    check_frames(file, frames)
    keys = poses.listed(values.get("keys", []), f"{file}: its keys", 0)
    return CameraPath(
        [_camera(entry, f"{file}: frame {i}") for i, entry in enumerate(frames)],
        poses.number(values.get("fps", picture.fps), f"{file}: its fps", 1e-3, 1e6),
        poses.integer(values.get("start_frame", 1), f"{file}: its start_frame", -10**9, 10**9), axes,
        names=names_of(frames), keys=[(poses.number(poses.table(entry, f"{file}: key {i}").get("frame"), f"{file}: key {i}: its frame"),
          _camera(entry, f"{file}: key {i}")) for i, entry in enumerate(keys)])


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    write_json(file, {
        "format": FORMAT, "version": VERSION, "fps": path.fps or picture.fps, "start_frame": path.start_frame, "axes": path.axes,
        "frames": named([_entry(camera) for camera in path.cameras], path),
        **({"keys": [{"frame": frame, **_entry(camera)} for frame, camera in path.keys]} if path.keys else {})}, indent=1)


def _entry(camera: Camera) -> dict:
    return {"width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
            "world_to_camera": camera.world_to_camera.tolist()}


def _camera(entry: object, where: str) -> Camera:
    entry = poses.table(entry, where)
    given = poses.intrinsics(where, *(entry.get(key) for key in ("fx", "fy", "cx", "cy", "width", "height")))
    pose = poses.rigid(entry.get("world_to_camera"), f"{where}: its world_to_camera")
    return Camera(given.width, given.height, *given[:4], pose)
