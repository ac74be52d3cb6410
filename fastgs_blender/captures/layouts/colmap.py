# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP workspaces, text or binary.

    sparse/0/{cameras,images,points3D}.{bin,txt}   or in sparse/, manual/ or the folder itself
    images/cam00/0001.png ...                      a rig: a folder, a video, or a folder with a video in it, per camera; the model needs one
                                                   picture of each camera
    films/cam00.mp4 ...                            or the films lie elsewhere in the folder, called like that picture or like its folder
    images/a.png, images/b.png ...                 a moment: each picture is a view
    colmap_0/, colmap_1/ ...                       or a workspace for each frame (as Spacetime Gaussians prepares them)

COLMAP's poses are world-to-camera in OpenCV axes, and its principal points count pixel centres at +0.5, as ours do.
"""
import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras import poses
from ...cameras.colmap_files import ColmapImage, read_images, read_points
from ...model.points import Points
from ...util.errors import FastGSError, printable
from ..beside import films_of_pictures, without_number
from ..capture import Capture, Options
from ..pixels.sequences import film_called, film_of, films_in, frame_range, numbered_pictures, video_frames
from ..rig_camera import RigCamera
from ..rigs import Entry, check_count, from_entries, from_rig
from ..sources import PICTURES, Source
from .prepared import frame_workspaces, model_place, timed

name = "COLMAP"
IMAGE_PLACES = ("images", "input", ".")
STILL = 1e-6
"""Poses that differ by less are one."""
NEAR = 0.02
"""Turns in radians, and moves in shares of the rig's size, by which COLMAP's poses of one camera on a tripod may differ."""


def recognises(path: Path) -> bool:
    """A workspace, or a folder with a workspace for each frame."""
    return path.is_dir() and (model_place(path) is not None or len(frame_workspaces(path)) > 0)


def load(path: Path, options: Options) -> Capture:
    """The capture in a workspace or in its frames' workspaces."""
    path = path if path.is_dir() else path.parent
    model = model_place(path)
    if model is not None:
        return _workspace(path, model, options)
    frames = frame_workspaces(path)
    if not frames:
        raise FastGSError(f"{path}: there are no cameras and images files of COLMAP in it or in sparse/0.")
    return _workspaces(path, frames, options)


def _source(path: Path, image: ColmapImage, frame: int | None = None) -> Source:
    return Source(path, frame, image.camera.lens, image.camera.intrinsics)


def _folder_of(path: Path, images: Sequence[ColmapImage]) -> Path:
    """The folder that the pictures' names are relative to."""
    tops = [path / place for place in IMAGE_PLACES]
    return next((top for top in tops if any((top / image.name).exists() for image in images)),
                next((top for top in tops if any(_stream(top, image) for image in images)), tops[0]))


def _workspaces(path: Path, frames: dict[int, Path], options: Options) -> Capture:
    """A model for each frame; a view is a picture's name without its ending."""
    start, count = min(frames), max(frames) - min(frames) + 1
    check_count(path, count)
    chosen = set(range(count)[options.frames] if options.frames is not None else range(count))
    entries, points = [], []
    for number, folder in frames.items():
        if number - start not in chosen:
            continue
        model = model_place(folder)
        assert model is not None
        images = read_images(model)
        top = _folder_of(folder, images)
        entries += [Entry(Path(image.name).with_suffix("").as_posix(), number - start, _source(top / image.name, image),
                          image.world_to_camera) for image in images]
        points.append((read_points(model), sorted(chosen).index(number - start) / len(chosen)))
    views = dict.fromkeys(entry.view for entry in entries)
    have = {(entry.view, entry.frame) for entry in entries}
    gaps = [(view, frame) for frame in chosen for view in views if (view, frame) not in have]
    entries.sort(key=lambda entry: (entry.view, entry.frame))
    return from_entries(path, name, entries, options, frame_count=count, start_frame=start, points=timed(points), gaps=gaps)


def _workspace(path: Path, model: Path, options: Options) -> Capture:
    """One model: a rig whose cameras have folders or videos, or a moment seen from everywhere."""
    images = read_images(model)
    top = _folder_of(path, images)
    points = read_points(model)
    streams = [_stream(top, image) or _stream(path, image) for image in images]
    if all(stream is None or _is_picture(stream) for stream in streams):
        stems = [Path(image.name).with_suffix("").as_posix() for image in images]
        films = films_of_pictures(stems, model / "images", path, several=True)[1]
        streams = films if len(set(films) - {None}) > 1 else streams  # one alone is no rig
    walks = _walks(images, streams)
    streams = [None if stream in walks else stream for stream in streams]
    if options.scan:
        images = [image for image, stream in zip(images, streams) if stream is None]
        if not images:
            raise FastGSError(f"{path}: all of its pictures belong to films; a scan needs photographs of the place.")
    if options.scan or not any(streams):
        if not any((top / image.name).exists() for image in images):
            raise FastGSError(f"{path}: none of the {len(images)} pictures that COLMAP used is there (such as "
                              f"{printable(images[0].name)}), and no films are called like them; copy the pictures to "
                              f"{top.name}, or call each film like its picture.")
        return _moment(path, images, top, points, options)
    names = _names([stream for stream in streams if stream is not None])
    views: dict[str, tuple[Path, list[ColmapImage]]] = {}
    for image, stream in zip(images, streams):
        if stream is not None:
            views.setdefault(names[stream], (film_of(stream), []))[1].append(image)
    faults: list[str] = []
    numbered = {view: numbered_pictures(film) for view, (film, _) in views.items() if film.is_dir()}
    start, count = frame_range(numbered.values(), top)
    cameras: list[RigCamera | list[Entry]] = []
    notes, fps = [], None
    for view, (film, registered) in views.items():
        pictures: Sequence[Source | None]
        if view in numbered:
            pictures = [_source(numbered[view][n], registered[0]) if n in numbered[view] else None for n in range(start, start + count)]
        else:
            pictures, rate = video_frames(film, faults, lens=registered[0].camera.lens, intrinsics=registered[0].camera.intrinsics)
            fps = fps or rate
            if len(registered) > 1:
                notes.append(f"{view} is taken to stand still: of its {len(registered)} poses that of {registered[0].name} is used")
                registered = registered[:1]
        if _stands_still(registered):
            cameras.append(RigCamera(view, pictures, registered[0].world_to_camera))
            continue
        moving = _moving(view, registered, numbered.get(view, {}), start)
        notes.append(f"{view} moves: of its {sum(p is not None for p in pictures)} pictures those {len(moving)} are used that have a pose")
        cameras.append(moving)
    lost = [image.name for image, stream in zip(images, streams) if stream is None]
    notes += [f"left out, for they are no sequences: {', '.join(lost[:6])}{' ...' if len(lost) > 6 else ''}"] if lost else []
    notes += [f"the model {model.name} is used, the largest of those beside it"] if model.name.isdecimal() and int(model.name) else []
    settings: dict[str, Any] = dict(fps=fps or 30.0, start_frame=start, points=points, notes=notes, faults=faults)
    rig = [camera for camera in cameras if isinstance(camera, RigCamera)]
    if len(rig) == len(cameras):
        return from_rig(path, name, rig, options, **settings)
    entries = [entry for camera in cameras for entry in (camera if isinstance(camera, list) else _entries(camera))]
    return from_entries(path, name, entries, options, frame_count=1 + max(entry.frame for entry in entries), **settings)


def _stream(top: Path, image: ColmapImage) -> Path | None:
    """What a registered picture stands for, a video or a folder of several pictures or with a video: cam/0001.png stands for its folder,
    cam.png for the folder or the video beside it."""
    own = Path(image.name)
    beside, inside = (top / own).parent, len(own.parts) > 1
    if inside and _is_sequence(beside, own):
        return beside
    for candidate in (own.stem, without_number(own.stem)):
        folder = beside / candidate
        if folder.is_dir() and (_is_sequence(folder, own) or films_in(folder)):
            return folder
        video = film_called(beside, candidate)
        if video is not None:
            return beside if inside and films_in(beside) == [video] else video
    return beside if inside and beside.is_dir() and films_in(beside) else None


def _walks(images: Sequence[ColmapImage], streams: Sequence[Path | None]) -> set[Path]:
    """The films whose registered pictures were taken from different places: those pictures are photographs of the place."""
    centres = np.array([poses.inverse(image.world_to_camera)[:3, 3] for image in images])
    size = np.ptp(centres, axis=0).max() + 1e-9
    first: dict[Path, int] = {}
    apart = set()
    for k, stream in enumerate(streams):
        if stream is not None and film_of(stream).is_file():
            begin = first.setdefault(stream, k)
            turn = np.abs(images[k].world_to_camera[:3, :3] - images[begin].world_to_camera[:3, :3]).max()
            if max(turn, np.abs(centres[k] - centres[begin]).max() / size) > NEAR:
                apart.add(stream)
    return apart


def _is_picture(stream: Path) -> bool:
    """Whether a camera's folder holds a single picture, as those that are taken from films for COLMAP."""
    return stream.is_dir() and not films_in(stream) and len(numbered_pictures(stream)) < 2


def _names(streams: Sequence[Path]) -> dict[Path, str]:
    """A view's name for each folder or video: its own or, where several are called alike, with the folders that tell them apart."""
    own = {stream: stream.with_suffix("") if stream.is_file() else stream for stream in streams}
    names = {}
    for stream, place in own.items():
        depth = next((n for n in range(1, len(place.parts)) if sum(other.parts[-n:] == place.parts[-n:] for other in own.values()) == 1), 1)
        names[stream] = "/".join(place.parts[-depth:])
    return names


def _is_sequence(folder: Path, own: Path) -> bool:
    """Whether a folder holds numbered pictures, and not one beside a video that it was taken from."""
    if not folder.is_dir() or not re.search(r"\d", own.stem):
        return False
    pictures = list(islice((p for p in folder.iterdir() if p.suffix.lower() in PICTURES and re.search(r"\d", p.stem)), 2))
    return len(pictures) > 1 or (len(pictures) == 1 and not films_in(folder))


def _stands_still(images: Sequence[ColmapImage]) -> bool:
    first = images[0]
    return all(np.abs(image.world_to_camera - first.world_to_camera).max() < STILL and image.camera == first.camera for image in images)


def _moving(view: str, images: Sequence[ColmapImage], numbered: dict[int, Path], start: int) -> list[Entry]:
    """The pictures of a camera whose registered pictures have different poses: those alone."""
    by_name = {path.name: number for number, path in numbered.items()}
    entries = []
    for image in images:
        number = by_name.get(Path(image.name).name)
        if number is not None:
            entries.append(Entry(view, number - start, _source(numbered[number], image), image.world_to_camera))
    return entries


def _entries(camera: RigCamera) -> list[Entry]:
    return [Entry(camera.name, i, source, camera.pose) for i, source in enumerate(camera.pictures) if source is not None]


def _moment(path: Path, images: Sequence[ColmapImage], top: Path, points: Points | None, options: Options) -> Capture:
    """Every registered picture is a view of one moment."""
    stems = [Path(image.name).with_suffix("").as_posix() for image in images]
    twice = len(set(stems)) < len(stems)
    entries = [Entry(image.name if twice else stem, 0, _source(top / image.name, image), image.world_to_camera)
               for image, stem in zip(images, stems)]
    return from_entries(path, name, entries, options, frame_count=1, points=points, notes=["all pictures show one moment"])
