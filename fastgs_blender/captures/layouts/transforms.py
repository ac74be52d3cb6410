# SPDX-License-Identifier: GPL-3.0-or-later
"""The transforms.json family: nerfstudio, instant-ngp, D-NeRF (and its relatives), BlenderNeRF.

    transforms.json                              or
    transforms_train.json, _val.json, _test.json   val and test are held out

Poses are camera-to-world with OpenGL's camera axes.  `time` of a picture in [0, 1] is the model's t; other times are put there in
even steps.  Without times, pictures cam00/0001.png, cam01/0001.png, ... are a rig's frames, and all others show one moment.
Intrinsics and distortion stand at the top or with each picture.  mask_path: black is to be ignored (nerfstudio).
"""
from __future__ import annotations

from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from ...cameras import poses
from ...cameras.lens import Intrinsics, Lens
from ...util.errors import FastGSError
from ...util.reading import read_json
from ...util.stated_paths import local
from ..capture import Capture, Options
from ..pixels.probe import picture_size
from ..points import load_points
from ..rigs import Entry, from_entries, gap_sentences
from ..sources import PICTURES, Source
from .transforms_views import Picture, times_of, views_of

name = "transforms.json"
SPLITS = ("train", "val", "test")
POINT_FILES = ("sparse_pc.ply", "points3d.ply", "points3D.ply", "fused.ply")
LENSES = {"PINHOLE": "pinhole", "SIMPLE_PINHOLE": "pinhole", "OPENCV": "opencv", "SIMPLE_RADIAL": "opencv", "RADIAL": "opencv",
          "OPENCV_FISHEYE": "fisheye", "SIMPLE_RADIAL_FISHEYE": "fisheye", "RADIAL_FISHEYE": "fisheye", "FULL_OPENCV": "full"}
COEFFICIENTS = {"pinhole": (), "opencv": ("k1", "k2", "k3", "p1", "p2"), "fisheye": ("k1", "k2", "k3", "k4"),
                "full": ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")}
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y", "camera_model", "is_fisheye", *COEFFICIENTS["full"])
"""What stands at the top, or with each picture."""


def recognises(path: Path) -> bool:
    """A folder with transforms.json or transforms_train.json, or one of these files."""
    if path.is_file():
        return path.suffix.lower() == ".json" and path.name.lower().startswith("transforms")
    return bool(_files(path))


def load(path: Path, options: Options) -> Capture:
    """The capture that the file, or a folder's files, describe."""
    files = _files(path) if path.is_dir() else {_split(path): path}
    if not files:
        raise FastGSError(f"{path}: there is no transforms.json or transforms_train.json in it.")
    pictures: list[Picture] = []
    for split, file in files.items():
        pictures += _read(file, split)
    there = [picture for picture in pictures if picture.source is not None]
    if not there:
        raise FastGSError(f"{path}: none of its {len(pictures)} pictures is there (such as {shortened(pictures[0].stated)}); copy them "
                          "beside it.")
    views = views_of(pictures)
    frames, times, fps, notes = times_of(pictures, views)
    gaps = [(views[i], frames[i]) for i, picture in enumerate(pictures) if picture.source is None]
    masks = sum(picture.mask is not None for picture in there)
    entries = [Entry(views[i], frames[i], picture.source, picture.pose, picture.mask, times[i])
               for i, picture in enumerate(pictures) if picture.source is not None]
    held_out = dict.fromkeys(views[i] for i, picture in enumerate(pictures) if picture.split in ("val", "test"))
    folder = next(iter(files.values())).parent
    faults = gap_sentences(gaps) if max(frames) else _missing(pictures)
    return from_entries(
        path, name, entries, options, frame_count=max(frames) + 1, fps=fps, held_out=list(held_out), axes="RFU",
        points=_points(files, folder), mask_means="valid" if masks else "foreground", notes=notes, faults=faults)


def _files(path: Path) -> dict[str, Path]:
    found = {split: path / f"transforms_{split}.json" for split in SPLITS}
    found = {split: file for split, file in found.items() if file.is_file()}
    whole = path / "transforms.json"
    return {"": whole} if whole.is_file() else found


def _split(file: Path) -> str:
    return next((split for split in SPLITS if file.stem.lower().endswith("_" + split)), "")


def _missing(pictures) -> list[str]:
    lost = [picture.stated for picture in pictures if picture.source is None]
    more = " ..." if len(lost) > 4 else ""
    return [f"{len(lost)} of its {len(pictures)} pictures are missing: {', '.join(lost[:4])}{more}"] if lost else []


def _points(files, folder):
    stated = [read_json(file).get("ply_file_path") for file in files.values()]
    for file, value in zip(files.values(), stated):
        _check_local(folder, value, f"{file}: its ply_file_path")
    for path in (local(folder, value) for value in [*stated, *POINT_FILES]):
        if path is not None and path.is_file():
            return load_points(path)
    return None


# Reading


def _read(file: Path, split: str) -> list[Picture]:
    values = poses.table(read_json(file), f"{file}: it")
    if "frames" not in values:
        raise FastGSError(f"{file}: it lacks frames, the list of its pictures.")
    splits = {str(name): part for part in SPLITS
              for name in poses.listed(values.get(f"{part}_filenames") or [], f"{file}: its {part}_filenames", 0)}
    shared = {key: values[key] for key in INTRINSICS if key in values}
    sizes: dict[Path, Intrinsics] = {}
    pictures = []
    for i, frame in enumerate(poses.listed(values["frames"], f"{file}: its frames")):
        where = f"{file}: frame {i}"
        frame = poses.table(frame, where)
        stated = frame.get("file_path")
        if not isinstance(stated, str) or not stated:
            raise FastGSError(f"{where} lacks file_path, the name of its picture.")
        for key in ("file_path", "mask_path"):
            _check_local(file.parent, frame.get(key), f"{where}: its {key}")
        picture = _found(file.parent, stated)
        time = frame.get("time")
        given = shared | {key: frame[key] for key in INTRINSICS if frame.get(key) is not None}
        source = None if picture is None else _source(picture, given, where, sizes)
        mask = _found(file.parent, frame.get("mask_path"))
        pictures.append(Picture(
            splits.get(stated, split), stated, source, None if mask is None else Source(mask),
            _pose(frame.get("transform_matrix"), f"{where}: its transform_matrix"),
            None if time is None else poses.number(time, f"{where}: its time")))
    return pictures


def _check_local(folder: Path, stated: object, what: str) -> None:
    """Raise FastGSError for the name of a file of a network, or of a device."""
    if isinstance(stated, str) and stated and local(folder, stated) is None:
        raise FastGSError(f"{what} must name a file on this machine, not {shortened(stated)}; copy it beside the capture.")


def _found(folder: Path, stated: object) -> Path | None:
    """The picture of that name, with or without its ending."""
    path = local(folder, stated)
    if path is None or not path.name or path.name == "..":
        return None
    for candidate in (path, *(path.with_name(path.name + suffix) for suffix in PICTURES)):
        if candidate.is_file() and candidate.suffix.lower() in PICTURES:
            return candidate
    return None


def _pose(value, where) -> np.ndarray:
    """World-to-camera of a camera-to-world matrix; the scale of a Blender camera does not count."""
    if isinstance(value, list) and len(value) == 3:
        value = [*value, [0, 0, 0, 1]]
    matrix = poses.numbers(value, (4, 4), where)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if lengths.min() < 1e-9:
        raise FastGSError(f"{where} is no pose: one of its axes has no length.")
    matrix[:3, :3] /= lengths
    return poses.from_opengl(poses.rigid(matrix, where))


def _source(picture: Path, given: dict, where: str, sizes: dict) -> Source:
    lens = _lens(given, where)
    if "w" in given and "h" in given:
        width, height = given["w"], given["h"]
    else:
        try:
            width, height = picture_size(Source(picture))
            sizes[picture.parent] = width, height
        except FastGSError:  # check() tells of the picture; its neighbours' size will do until then
            if picture.parent not in sizes:
                raise
            width, height = sizes[picture.parent]
    width, height = (poses.whole(side, f"{where}: its {key}", 1) for key, side in (("w", width), ("h", height)))
    fx = given["fl_x"] if "fl_x" in given else _focal(given, "camera_angle_x", width, where)
    if fx is None:
        raise FastGSError(f"{where} lacks a focal length: fl_x or camera_angle_x.")
    fy = given.get("fl_y", _focal(given, "camera_angle_y", height, where) if "fl_x" not in given else None)
    fy = fx if fy is None else fy
    centre = given.get("cx", width / 2), given.get("cy", height / 2)
    return Source(picture, None, lens, poses.intrinsics(where, fx, fy, *centre, width, height))


def _focal(given, key, side, where):
    if key not in given:
        return None
    return side / 2 / np.tan(poses.number(given[key], f"{where}: its {key}", 1e-6, np.pi - 1e-6) / 2)


def _lens(given: dict, where: str) -> Lens:
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
