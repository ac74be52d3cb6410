# SPDX-License-Identifier: GPL-3.0-or-later
"""The transforms.json family: nerfstudio, instant-ngp, D-NeRF (and its relatives), BlenderNeRF, NeuS2.

    transforms.json                                or
    transforms_train.json, _val.json, _test.json   val and test are held out, or
    train/transform_000280.json, ..., test/...     a file for each moment, also without the folders (NeuS2)

Poses are camera-to-world with OpenGL's camera axes.  `time` of a picture in [0, 1] is the model's t; other times are put there in
even steps.  Without times, pictures cam00/0001.png, cam01/0001.png, ... are a rig's frames; and one picture of each camera stands for the
film that is called like it, or is a film itself.  All others show one moment.
Intrinsics and distortion stand at the top or with each picture.  mask_path: black is to be ignored (nerfstudio).
"""
import re
from dataclasses import replace
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

from ...cameras import poses
from ...cameras.transforms_json import fps_of, given_for, intrinsics_of, lens_of, pose_of
from ...model.points import Points
from ...util.errors import FastGSError
from ...util.reading import read_json
from ...util.stated_paths import local
from ..beside import films, films_of_pictures
from ..capture import Capture, Options
from ..pixels.probe import picture_size
from ..point_files import load_points
from ..rig_camera import RigCamera
from ..rigs import Entry, from_entries, from_rig
from ..sources import PICTURES, VIDEOS, Source
from .transforms_views import Picture, short, stem, times_of, views_of

name = "transforms.json"
SPLITS = ("train", "val", "test")
MOMENT = re.compile(r"transforms?_(\d+)\.json")
POINT_FILES = ("sparse_pc.ply", "points3d.ply", "points3D.ply", "fused.ply")


def recognises(path: Path) -> bool:
    """A folder with transforms.json or transforms_train.json, or one of these files."""
    if path.is_file():
        return path.suffix.lower() == ".json" and path.name.lower().startswith("transform")
    return bool(_files(path))


def load(path: Path, options: Options) -> Capture:
    """The capture that the file, or a folder's files, describe."""
    files = _files(path) if path.is_dir() else [(_split(path), path, None)]
    if not files:
        raise FastGSError(f"{path}: there is no transforms.json or transforms_train.json in it.")
    tables = {file: poses.table(read_json(file), f"{file}: it") for _, file, _ in files}
    pictures = [picture for split, file, moment in files for picture in _read(file, tables[file], split, moment)]
    there = [picture for picture in pictures if picture.source is not None]
    if not there:
        raise FastGSError(f"{path}: none of its {len(pictures)} pictures is there (such as {shortened(pictures[0].stated)}); copy them "
                          "beside it.")
    views, points = views_of(pictures), _points(tables)
    frames, times, fps, notes = times_of(pictures, views)
    stated = next((rate for file, values in tables.items() if (rate := fps_of(values, file)) is not None), None)
    if len(set(views)) == len(views) and times[0] is None:
        named = {view: picture for view, picture in zip(views, pictures) if picture.source is not None}
        filmed = _filmed(path, next(iter(tables)), named, options, fps=stated, points=points)
        if filmed is not None:
            return filmed
    gaps = [(views[i], frames[i]) for i, picture in enumerate(pictures) if picture.source is None]
    masks = sum(picture.mask is not None for picture in there)
    entries = [Entry(views[i], frames[i], picture.source, picture.pose, picture.mask, times[i])
               for i, picture in enumerate(pictures) if picture.source is not None]
    held_out = dict.fromkeys(views[i] for i, picture in enumerate(pictures) if picture.split in ("val", "test"))
    return from_entries(
        path, name, entries, options, frame_count=max(frames) + 1, fps=stated or fps, held_out=list(held_out), axes="RFU",
        points=points, mask_means="valid" if masks else "foreground", notes=notes, gaps=gaps)


def _filmed(path: Path, file: Path, pictures: dict[str, Picture], options: Options, **settings: Any) -> Capture | None:
    """The rig whose films are listed, or lie beside the pictures of them that are listed; None where there are not two of these.

    pictures  of each view the one that there is
    """
    stems = [stem(picture.stated) for picture in pictures.values()]
    streams = [picture.source.path if picture.source and picture.source.frame is not None else None for picture in pictures.values()]
    if listed := [called for called, stream in zip(stems, streams) if stream is not None]:
        names = dict(zip(listed, short(listed)))
        called = [names.get(called, called) for called in stems]
    else:
        called, streams = films_of_pictures(stems, file, path)
    places = {view: stream for view, stream in zip(called, streams) if stream is not None}
    if len(places) < 2 and not listed:
        return None
    faults: list[str] = []
    start, found, rates = films(places, faults, path)
    rig, held_out = [], []
    for view, picture in zip(called, pictures.values()):
        if view in places and picture.source is not None:
            sources = [None if where is None else replace(picture.source, path=where[0], frame=where[1]) for where in found[view]]
            rig.append(RigCamera(view, sources, picture.pose))
            held_out += [view] if picture.split in ("val", "test") else []
    lost = [picture.stated for picture, stream in zip(pictures.values(), streams) if stream is None]
    notes = [f"left out for want of a film: {', '.join(lost[:8])}{' ...' if len(lost) > 8 else ''}"] if lost else []
    fps = settings.pop("fps") or (rates[0] if rates else 30.0)
    return from_rig(path, name, rig, options, fps=fps, start_frame=start, held_out=held_out, axes="RFU", notes=notes, faults=faults,
                    **settings)


def _files(path: Path) -> list[tuple[str, Path, float | None]]:
    """Split and path of the files that list a folder's pictures, and the moment where each of them has a file of its own."""
    for called in ("transforms", "transform"):
        if (whole := path / f"{called}.json").is_file():
            return [("", whole, None)]
        files = {split: path / f"{called}_{split}.json" for split in SPLITS}
        if any(file.is_file() for file in files.values()):
            return [(split, file, None) for split, file in files.items() if file.is_file()]
    return [(split, file, float(match[1])) for split in ("", *SPLITS) for file in sorted((path / split).glob("transform*.json"))
            if (match := MOMENT.fullmatch(file.name))]


def _split(file: Path) -> str:
    return next((split for split in SPLITS if file.stem.lower().endswith("_" + split)), "")


def _points(tables: dict[Path, dict]) -> Points | None:
    folder, stated = next(iter(tables)).parent, [values.get("ply_file_path") for values in tables.values()]
    for file, value in zip(tables, stated):
        _check_local(folder, value, f"{file}: its ply_file_path")
    for path in (local(folder, value) for value in [*stated, *POINT_FILES]):
        if path is not None and path.is_file():
            return load_points(path)
    return None


# Reading


def _read(file: Path, values: dict, split: str, moment: float | None) -> list[Picture]:
    if "frames" not in values:
        raise FastGSError(f"{file}: it lacks frames, the list of its pictures.")
    splits = {str(name): part for part in SPLITS
              for name in poses.listed(values.get(f"{part}_filenames") or [], f"{file}: its {part}_filenames", 0)}
    sizes: dict[Path, tuple[int, int]] = {}
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
        time = frame.get("time", moment)
        source = None if picture is None else _source(picture, given_for(values, frame, where), where, sizes)
        mask = _found(file.parent, frame.get("mask_path"))
        pictures.append(Picture(
            splits.get(stated, split), stated, source, None if mask is None else Source(mask),
            pose_of(values, frame, where), None if time is None else poses.number(time, f"{where}: its time")))
    return pictures


def _check_local(folder: Path, stated: object, what: str) -> None:
    """Raise FastGSError for the name of a file of a network, or of a device."""
    if isinstance(stated, str) and stated and local(folder, stated) is None:
        raise FastGSError(f"{what} must name a file on this machine, not {shortened(stated)}; copy it beside the capture.")


def _found(folder: Path, stated: object) -> Path | None:
    """The picture of that name, with or without its ending, or the film."""
    path = local(folder, stated)
    if path is None or not path.name or path.name == "..":
        return None
    for candidate in (path, *(path.with_name(path.name + suffix) for suffix in PICTURES)):
        if candidate.is_file() and candidate.suffix.lower() in (*PICTURES, *VIDEOS):
            return candidate
    return None


def _source(picture: Path, given: dict, where: str, sizes: dict) -> Source:
    frame = 0 if picture.suffix.lower() in VIDEOS else None

    def size() -> tuple[int, int]:
        try:
            sizes[picture.parent] = picture_size(Source(picture, frame))
        except FastGSError:  # check() tells of the picture; its neighbours' size will do until then
            if picture.parent not in sizes:
                raise
        return sizes[picture.parent]

    return Source(picture, frame, lens_of(given, where), intrinsics_of(given, where, size))
