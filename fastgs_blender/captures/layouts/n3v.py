# SPDX-License-Identifier: GPL-3.0-or-later
"""Neural 3D Video ("DyNeRF"): one video per camera and LLFF poses.

    cam00.mp4, cam01.mp4 ...     numbers may have gaps; or folders cam00/images/0000.png, cam00/0000.png of extracted frames
    poses_bounds.npy             [cameras, 17] float64: row i belongs to the i-th camera by name
    points3D_downsample2.ply     optional
    colmap_0/, colmap_1/ ...     optional: points of each frame (prepared.py)

A row holds a 3 x 5 matrix [R | t | (height, width, focal length)] and the near and far bound.  [R | t] is camera-to-world; R's columns
point down, right and backwards, so that (second, first, -third) are OpenCV's.  The principal point is the image's centre
(github.com/Fyusion/LLFF, README).  Pictures are halved and cam00 is held out, as all published figures do.
"""
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...cameras import poses
from ...model.points import Points
from ...util.errors import FastGSError
from ...util.numpy_files import read_array
from ..capture import Capture, Options
from ..pixels.probe import picture_size
from ..pixels.sequences import film_of, numbered_pictures, numbered_sources, video_frames
from ..point_files import load_points
from ..rig_camera import RigCamera
from ..rigs import chosen_frames, from_rig
from ..sources import VIDEOS, Source
from .prepared import prepared_points

name = "Neural 3D Video"
POSES = "poses_bounds.npy"
POINTS = "points3D_downsample2.ply"
FPS = 30.0
UNSYNCHRONISED = {"coffee_martini": "cam13"}
"""Cameras whose film runs beside the others'; published work leaves them out (E-D3DGS, HyperReel)."""


def recognises(path: Path) -> bool:
    """A folder with poses_bounds.npy and something called cam and a number."""
    return path.is_dir() and (path / POSES).is_file() and bool(_found(path))


def load(path: Path, options: Options) -> Capture:
    """The capture in a scene's folder."""
    path = path if path.is_dir() else path.parent
    found, rows = _found(path), read_array(path / POSES)
    if rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise FastGSError(f"{path / POSES}: it must hold a row of 17 numbers for each camera, not an array of {rows.shape}.")
    if len(found) != len(rows):
        raise FastGSError(f"{path}: {POSES} has {len(rows)} rows, but there are {len(found)} cameras ({', '.join(found)}); rows belong to "
                          "cameras by order, so restore the missing ones, and hold out or leave out views instead of deleting them.")
    out = UNSYNCHRONISED.get(path.resolve().name)
    out = out if out in found and out not in (options.held_out or ()) else None
    faults: list[str] = []
    read = [_camera(called, place, rows[i], f"{path / POSES}: row {i} ({called})", faults)
            for i, (called, place) in enumerate(found.items()) if called != out]
    cameras, rates, sizes = zip(*read)
    notes = [f"{out} is left out: in this scene it is not synchronised with the others"] if out else []
    if (path / POINTS).is_file():
        points: Points | None = load_points(path / POINTS)
    else:
        points, remarks = prepared_points(path, {camera.name: camera.pose for camera in cameras}, chosen_frames(cameras, options, path))
        notes += remarks
    return from_rig(path, name, cameras, options, fps=next((rate for rate in rates if rate), FPS), scale=min(1.0, 0.5 / min(sizes)),
                    held_out=[cameras[0].name], points=points, notes=notes, faults=faults)


def _camera(called: str, place: Path, row: np.ndarray, where: str, faults: list[str]) -> tuple[RigCamera, float | None, float]:
    """The camera, its film's frames per second or None, and its files' width against the width that its row states."""
    matrix = poses.numbers(row, (17,), where)[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    given = poses.intrinsics(where, focal, focal, width / 2, height / 2, width, height)
    down, right, back = matrix[:, :3].T
    pose = poses.inverse(poses.rigid(np.stack([right, down, -back, matrix[:, 3]], 1), f"{where}: its pose"))
    pictures: Sequence[Source | None] | None = None if place.is_file() else _pictures(place)
    first = Source(place, 0) if pictures is None else next((p for p in pictures if p is not None), None)
    try:
        size = picture_size(first) if first is not None else (given.width, given.height)
    except FastGSError:  # said with all other faults
        size = given.width, given.height
    sx, sy = size[0] / given.width, size[1] / given.height
    if abs(sx / sy - 1) > 0.01:
        faults.append(f"{called} has pictures of {size[0]} x {size[1]} pixels, but its pose was made for {given.width} x {given.height}")
    given = given._replace(fx=focal * sx, fy=focal * sy, cx=size[0] / 2, cy=size[1] / 2, width=size[0], height=size[1])
    fps = None
    if pictures is None:
        pictures, fps = video_frames(place, faults, intrinsics=given)
    else:
        pictures = [None if p is None else Source(p.path, intrinsics=given) for p in pictures]
    return RigCamera(called, pictures, pose), fps, sx


def _pictures(folder: Path) -> list[Source | None]:
    """The pictures of a camera's folder, or of images/ in it, from the lowest number on."""
    numbered = numbered_pictures(folder / "images" if (folder / "images").is_dir() else folder)
    return numbered_sources(numbered, folder)


def _found(path: Path) -> dict[str, Path]:
    """Video or folder of each camera by name, in the order of the rows; the video where there are both."""
    found: dict[str, Path] = {}
    for place in sorted(path.iterdir(), key=lambda p: (p.stem, p.is_dir())):
        if re.fullmatch(r"cam\d+", place.stem) and (place.is_dir() or place.suffix.lower() in VIDEOS):
            found.setdefault(place.stem, place if (place / "images").is_dir() else film_of(place))
    return found
