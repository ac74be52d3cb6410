# SPDX-License-Identifier: GPL-3.0-or-later
"""Google Immersive light field video (DeepView video): 46 fisheye cameras on a hemisphere.

    camera_0001.mp4 ...          one video per camera
    models.json                  a list of {name, position, orientation, focal_length, pixel_aspect_ratio, principal_point, width, height,
                                 radial_distortion, projection_type}
    colmap_0/, colmap_1/ ...     optional: points of each frame (prepared.py)

position is the camera's centre in the world, orientation the axis-angle of world to camera, OpenCV axes.  "fisheye" is OpenCV's with
k1, k2 (github.com/augmentedperception/deepview_video_dataset).  A video that models.json leaves out has no pose and is left out here.
Pictures become pinholes of half the focal length and half the size; camera_0001 is held out (STG, "undistorted").
"""
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from ...cameras import poses
from ...cameras.lens import Intrinsics, Lens
from ...util import rotations
from ...util.errors import FastGSError
from ...util.reading import read_json
from ..capture import Capture, Options
from ..pixels.sequences import video_frames
from ..rig_camera import RigCamera
from ..rigs import chosen_frames, from_rig, lone_sentence
from ..sources import VIDEOS
from .prepared import prepared_points

name = "Google Immersive"
MODELS = "models.json"
HELD_OUT = "camera_0001"
FOCAL, SCALE = 0.5, 0.5
GAINS = {"01_Welder": ("camera_0009", 1 / 1.15), "12_Cave": ("camera_0009", 1.15), "04_Truck": ("camera_0008", 1 / 1.2)}
"""Cameras whose exposure differs from the others', and the factor that evens it (STG's loader)."""
LENSES = {"fisheye": "fisheye", "pinhole": "opencv", "perspective": "opencv"}


def recognises(path: Path) -> bool:
    """A folder with models.json and videos called camera_ and a number, or that models.json."""
    folder = path if path.is_dir() else path.parent
    return (path.is_dir() or path.name == MODELS) and (folder / MODELS).is_file() and bool(_videos(folder))


def load(path: Path, options: Options) -> Capture:
    """The capture that models.json describes."""
    folder = path if path.is_dir() else path.parent
    file, videos = folder / MODELS, _videos(folder)
    entries = [poses.table(entry, f"{file}: camera {i}") for i, entry in enumerate(poses.listed(read_json(file), f"{file}: it"))]
    names = [poses.name_of(entry.get("name"), f"{file}: camera {i}: its name") for i, entry in enumerate(entries)]
    poses.check_names(names, file)
    gains = dict([GAINS[folder.resolve().name]]) if folder.resolve().name in GAINS else {}
    faults: list[str] = []
    cameras, rates = [], []
    for called, entry in zip(names, entries):
        where = f"{file}: {called}"
        lens, given, pose = _lens(entry, where), _intrinsics(entry, where), _pose(entry, where)
        if called in videos:
            pictures, fps = video_frames(videos[called], faults, lens=lens, intrinsics=given, gain=gains.get(called, 1.0))
            cameras.append(RigCamera(called, pictures, pose))
            rates += [fps] if fps else []
    if not cameras:
        raise FastGSError(f"{file}: none of its cameras ({', '.join(names[:8])}) has a video in {folder}; copy the videos there.")
    faults += lone_sentence([camera.name for camera in cameras], [called for called in names if called not in videos])
    notes = []
    for text, lost in (("without calibration in models.json", sorted(set(videos) - set(names))),
                       ("without a video", [called for called in names if called not in videos])):
        notes += [f"left out {text}: {', '.join(lost)}"] if lost else []
    placed = {camera.name: camera.pose for camera in cameras if camera.pose is not None}
    points, remarks = prepared_points(folder, placed, chosen_frames(cameras, options, path))
    notes += remarks
    notes += [f"the exposure of {called} is evened by a factor of {gain:.3g}" for called, gain in gains.items() if called in videos]
    return from_rig(path, name, cameras, options, fps=rates[0] if rates else 30.0, scale=SCALE, focal=FOCAL, held_out=[HELD_OUT],
                    notes=notes, faults=faults, points=points)


def _lens(entry: dict, where: str) -> Lens:
    kind = poses.needed(entry, "projection_type", where)
    if not isinstance(kind, str) or kind not in LENSES:
        raise FastGSError(f"{where}: its projection_type {shortened(kind)} is not known; there are {', '.join(LENSES)}.")
    radial = poses.needed(entry, "radial_distortion", where)
    count = len(radial) if isinstance(radial, list) and len(radial) in {2, 3} else 3
    return Lens(LENSES[kind], tuple(poses.numbers(radial, (count,), f"{where}: its radial_distortion")))


def _intrinsics(entry: dict, where: str) -> Intrinsics:
    focal = poses.number(poses.needed(entry, "focal_length", where), f"{where}: its focal_length")
    aspect = poses.number(entry.get("pixel_aspect_ratio", 1.0), f"{where}: its pixel_aspect_ratio", 0.1, 10)
    centre = poses.numbers(poses.needed(entry, "principal_point", where), (2,), f"{where}: its principal_point")
    sides = (poses.needed(entry, side, where) for side in ("width", "height"))
    return poses.intrinsics(where, focal, focal * aspect, *centre, *sides)


def _pose(entry: dict, where: str) -> np.ndarray:
    centre = poses.numbers(poses.needed(entry, "position", where), (3,), f"{where}: its position")
    axis = poses.numbers(poses.needed(entry, "orientation", where), (3,), f"{where}: its orientation")
    pose = poses.from_quaternion(rotations.exp(axis / 2), np.zeros(3), where)
    pose[:3, 3] = -pose[:3, :3] @ poses.near(centre, where)
    return pose


def _videos(folder: Path) -> dict[str, Path]:
    return {p.stem: p for p in sorted(folder.iterdir()) if p.suffix.lower() in VIDEOS and p.stem.startswith("camera_") and p.is_file()}
