# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP workspaces, text or binary.

    sparse/0/{cameras,images,points3D}.{bin,txt}   or in sparse/, manual/ or the folder itself
    images/cam00/0001.png ...                      a rig: a folder, or a video, per camera; the model needs one picture of each camera
    images/a.png, images/b.png ...                 a moment: each picture is a view
    colmap_0/, colmap_1/ ...                       or a workspace for each frame (as Spacetime Gaussians prepares them)

COLMAP's poses are world-to-camera in OpenCV axes, and its principal points count pixel centres at +0.5, as ours do.
"""
from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...cameras.colmap_files import ColmapImage, read_images, read_points
from ...util.errors import FastGSError
from ..capture import Capture, Options
from ..pixels.sequences import frame_range, numbered_pictures, video_frames
from ..rigs import Entry, RigCamera, check_count, from_entries, from_rig
from ..sources import PICTURES, VIDEOS, Source
from .prepared import frame_workspaces, model_place, timed

name = "COLMAP"
IMAGE_PLACES = ("images", "input", ".")
STILL = 1e-6
"""Poses that differ by less are one."""


def recognises(path: Path) -> bool:
    """A workspace, or a folder with a workspace for each frame."""
    return path.is_dir() and (model_place(path) is not None or len(frame_workspaces(path)) > 0)


def load(path: Path, options: Options) -> Capture:
    """The capture in a workspace or in its frames' workspaces."""
    path = path if path.is_dir() else path.parent
    if model_place(path) is not None:
        return _workspace(path, options)
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


def _workspaces(path, frames: dict[int, Path], options) -> Capture:
    """A model for each frame; a view is a picture's name without its ending."""
    start, count = min(frames), max(frames) - min(frames) + 1
    check_count(path, count)
    chosen = set(range(count)[options.frames] if options.frames is not None else range(count))
    entries, points = [], []
    for number, folder in frames.items():
        if number - start not in chosen:
            continue
        model = model_place(folder)
        images = read_images(model)
        top = _folder_of(folder, images)
        entries += [Entry(Path(image.name).with_suffix("").as_posix(), number - start, _source(top / image.name, image),
                          image.world_to_camera) for image in images]
        points.append((read_points(model), sorted(chosen).index(number - start) / len(chosen)))
    views = dict.fromkeys(entry.view for entry in entries)
    have = {(entry.view, entry.frame) for entry in entries}
    gaps = [(view, frame) for frame in chosen for view in views if (view, frame) not in have]
    entries.sort(key=lambda entry: (entry.view, entry.frame))
    return from_entries(path, name, entries, options, frame_count=count, start_frame=start, points=timed(points),
                        gaps=gaps)


def _workspace(path, options) -> Capture:
    """One model: a rig whose cameras have folders or videos, or a moment seen from everywhere."""
    model = model_place(path)
    images = read_images(model)
    top = _folder_of(path, images)
    points = read_points(model)
    streams = [_stream(top, image) or _stream(path, image) for image in images]
    if not any(streams):
        return _moment(path, images, top, points, options)
    views: dict[str, tuple[Path, list[ColmapImage]]] = {}
    for image, stream in zip(images, streams):
        if stream is not None:
            views.setdefault(stream.stem if stream.is_file() else stream.name, (stream, []))[1].append(image)
    faults: list[str] = []
    numbered = {view: numbered_pictures(stream) for view, (stream, _) in views.items() if stream.is_dir()}
    start, count = frame_range(numbered.values(), top)
    cameras, notes, fps = [], [], None
    for view, (stream, registered) in views.items():
        if view in numbered:
            pictures = [_source(numbered[view][n], registered[0]) if n in numbered[view] else None for n in range(start, start + count)]
        else:
            pictures, rate = video_frames(stream, faults, lens=registered[0].camera.lens, intrinsics=registered[0].camera.intrinsics)
            fps = fps or rate
        if _stands_still(registered):
            cameras.append(RigCamera(view, pictures, registered[0].world_to_camera))
            continue
        moving = _moving(view, registered, numbered.get(view, {}), start)
        notes.append(f"{view} moves: of its {sum(p is not None for p in pictures)} pictures those {len(moving)} are used that have a pose")
        cameras.append(moving)
    lost = [image.name for image, stream in zip(images, streams) if stream is None]
    notes += [f"left out, for they are no sequences: {', '.join(lost[:6])}{' ...' if len(lost) > 6 else ''}"] if lost else []
    settings = dict(fps=fps or 30.0, start_frame=start, points=points, notes=notes, faults=faults)
    if not any(isinstance(camera, list) for camera in cameras):
        return from_rig(path, name, cameras, options, **settings)
    entries = [entry for camera in cameras for entry in (camera if isinstance(camera, list) else _entries(camera))]
    return from_entries(path, name, entries, options, frame_count=1 + max(entry.frame for entry in entries), **settings)


def _stream(top: Path, image: ColmapImage) -> Path | None:
    """The folder of several pictures, or the video, that a registered picture stands for: cam/0001.png, or cam.png beside cam/."""
    own = Path(image.name)
    if len(own.parts) > 1:
        folder = top / own.parent
        return folder if _is_sequence(folder, own) else None
    stem = own.stem
    for candidate in (stem, re.sub(r"[_-]?\d+$", "", stem) if re.search(r"\D[_-]\d+$", stem) else stem):
        if (top / candidate).is_dir() and _is_sequence(top / candidate, own):
            return top / candidate
        video = next((top / (candidate + suffix) for suffix in VIDEOS if (top / (candidate + suffix)).is_file()), None)
        if video is not None:
            return video
    return None


def _is_sequence(folder: Path, own: Path) -> bool:
    """Whether a folder holds numbered pictures."""
    return folder.is_dir() and bool(re.search(r"\d", own.stem)) and any(
        p.suffix.lower() in PICTURES and re.search(r"\d", p.stem) for p in folder.iterdir())


def _stands_still(images: Sequence[ColmapImage]) -> bool:
    first = images[0]
    return all(np.abs(image.world_to_camera - first.world_to_camera).max() < STILL and image.camera == first.camera for image in images)


def _moving(view, images, numbered: dict[int, Path], start) -> list[Entry]:
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


def _moment(path, images, top, points, options) -> Capture:
    """Every registered picture is a view of one moment."""
    stems = [Path(image.name).with_suffix("").as_posix() for image in images]
    twice = len(set(stems)) < len(stems)
    entries = [Entry(image.name if twice else stem, 0, _source(top / image.name, image), image.world_to_camera)
               for image, stem in zip(images, stems)]
    return from_entries(path, name, entries, options, frame_count=1, points=points, notes=["all pictures show one moment"])
