# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures or videos without any calibration: a folder of numbered pictures, or a video, for each camera.

Recognised last.  The capture has no poses until posing.with_cameras() gives them.
"""
from __future__ import annotations

from pathlib import Path

from ...util.errors import FastGSError
from ..capture import Capture, Options
from ..pixels.sequences import frame_range, numbered_pictures, video_frames
from ..rigs import RigCamera, from_rig
from ..sources import PICTURES, VIDEOS, Source

name = "folders without poses"
NOT_CAMERAS = ("masks", "mask")


def recognises(path: Path) -> bool:
    """At least two videos, or two folders with pictures in them."""
    return path.is_dir() and (len(_videos(path)) > 1 or len(_folders(path)) > 1)


def load(path: Path, options: Options) -> Capture:
    """One camera per video or folder; frames are counted from the lowest number of any camera."""
    if not path.is_dir():
        raise FastGSError(f"{path}: give the folder that holds one folder of pictures or one video for each camera.")
    faults: list[str] = []
    folders = {folder.name: numbered_pictures(folder) for folder in _folders(path)}
    if len(folders) > 1:
        start, count = frame_range(folders.values(), path)
        cameras = [RigCamera(view, [Source(found[n]) if n in found else None for n in range(start, start + count)], None,
                             _masks(path, view, start, count)) for view, found in folders.items()]
        return from_rig(path, name, cameras, options, start_frame=start, frame_count=count, faults=faults)
    rates, cameras = [], []
    for video in _videos(path):
        pictures, fps = video_frames(video, faults)
        rates += [fps] if fps else []
        cameras.append(RigCamera(video.stem, pictures, None))
    if not rates:
        raise FastGSError(f"{path}: none of its videos can be read: {faults[0] if faults else 'there are none.'}")
    return from_rig(path, name, cameras, options, fps=rates[0], faults=faults)


def _masks(path, view, start, count) -> list[Source | None]:
    folder = path / "masks" / view
    found = numbered_pictures(folder) if folder.is_dir() else {}
    return [Source(found[n]) if n in found else None for n in range(start, start + count)]


def _videos(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.suffix.lower() in VIDEOS and p.is_file() and not p.name.startswith("."))


def _folders(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir()
                  if p.is_dir() and not p.name.startswith(".") and p.name not in NOT_CAMERAS and _holds_pictures(p))


def _holds_pictures(folder: Path) -> bool:
    return any(p.suffix.lower() in PICTURES and any(c.isdigit() for c in p.stem) for p in folder.iterdir())
