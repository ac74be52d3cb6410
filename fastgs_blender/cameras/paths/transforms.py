# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a transforms.json: entry after entry, or by their times where these differ.  See ..transforms_json.

Written with what nerfstudio's dataparser asks of each picture: file_path with an ending, transform_matrix, w, h, fl_x, fl_y, cx and cy.
It sorts by file_path.  A camera that moves has a `time` in each frame, from 0 to 1.  "name" and "fps" are ours, and ignored there.
"""
from pathlib import Path

from .. import poses
from ..transforms_json import fps_of, given_for, intrinsics_of, lens_of, pose_of
from .base import CameraPath, Picture, check_frames, frame_names, named, names_of, opengl_to_world, pinholes, write_json

name, label = "transforms.json", "transforms.json (nerfstudio, instant-ngp)"
PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".bmp", ".tif", ".tiff")


def recognises(values: object) -> bool:
    frames = values.get("frames") if isinstance(values, dict) else None
    return isinstance(frames, list) and bool(frames) and isinstance(frames[0], dict) and "transform_matrix" in frames[0]


def load(file: Path, values: dict, picture: Picture) -> CameraPath:
    entries = values["frames"]
    check_frames(file, entries)
    found, times = [], []
    for i, entry in enumerate(entries):
        where = f"{file}: frame {i}"
        given = given_for(values, poses.table(entry, where), where)
        intrinsics = intrinsics_of(given, where, lambda: (picture.width, picture.height))
        found.append((lens_of(given, where), intrinsics, pose_of(values, entry, where)))
        if entry.get("time") is not None:
            times.append(poses.number(entry["time"], f"{where}: its time"))
    moving = len(set(times)) == len(entries)
    cameras = pinholes(found, label)
    if moving:
        cameras = [cameras[i] for i in sorted(range(len(times)), key=times.__getitem__)]
    names = () if moving else names_of(entries) or names_of(entries, "file_path")
    return CameraPath(cameras, fps_of(values, file), axes="RFU", names=names)


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    names = path.names or [f"frame_{number}" for number in frame_names(path)]
    frames = [{
        "file_path": name if name.lower().endswith(PICTURES) else f"{name}.png", "w": camera.width, "h": camera.height, "fl_x": camera.fx,
        "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "transform_matrix": opengl_to_world(camera).tolist(),
        **({} if path.names else {"time": i / len(path)})} for i, (name, camera) in enumerate(zip(names, path.cameras, strict=True))]
    write_json(file, {"camera_model": "PINHOLE", **({"fps": path.fps} if path.fps else {}), "frames": named(frames, path)}, indent=1)
