# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures or videos without any calibration: for each camera a video, or a folder of numbered pictures or with a video in it.

Recognised last.  The capture has no poses until posing.with_cameras() gives them.
"""
from pathlib import Path

from ...util.errors import FastGSError
from ..beside import LATER, NOT_CAMERAS, films
from ..capture import Capture, Options
from ..pixels.sequences import films_in, holds_pictures, numbered_pictures, videos_in
from ..rig_camera import RigCamera
from ..rigs import from_rig
from ..sources import Source

name = "folders without poses"


def recognises(path: Path) -> bool:
    """At least two videos, or two folders with pictures or a video in them."""
    return path.is_dir() and len(_places(path)) > 1


def load(path: Path, options: Options) -> Capture:
    """One camera per video or folder; frames are counted from the lowest number of any camera."""
    if not path.is_dir():
        raise FastGSError(f"{path}: give the folder that holds one folder of pictures or one video for each camera.")
    faults: list[str] = []
    start, found, rates = films(_places(path), faults, path)
    cameras = [RigCamera(view, [None if where is None else Source(*where) for where in film], None, _masks(path, view, start, len(film)))
               for view, film in found.items()]
    if faults and not any(film for film in found.values()):
        raise FastGSError(f"{path}: none of its videos can be read: {faults[0]}")
    return from_rig(path, name, cameras, options, fps=rates[0] if rates else 30.0, start_frame=start, faults=faults)


def _masks(path: Path, view: str, start: int, count: int) -> list[Source | None]:
    folder = path / "masks" / view
    found = numbered_pictures(folder) if folder.is_dir() else {}
    return [Source(found[n]) if n in found else None for n in range(start, start + count)] if found else []


def _places(path: Path) -> dict[str, Path]:
    """The place of each camera's film by its name: folders, or the videos beside them where no two folders hold pictures."""
    videos = films_in(path) if videos_in(path) else []
    folders = sorted(p for p in path.iterdir() if _is_camera(p))
    if len(videos) > 1 and sum(map(holds_pictures, folders)) < 2:
        return {video.stem: video for video in videos}
    return {folder.name: folder for folder in folders}


def _is_camera(place: Path) -> bool:
    name = place.name.lower()
    return place.is_dir() and not name.startswith(".") and name not in NOT_CAMERAS and (
        holds_pictures(place) or (bool(films_in(place)) and not any(word in name for word in LATER)))
