# SPDX-License-Identifier: GPL-3.0-or-later
"""Technicolor light field (Sabater et al. 2017): 4 x 4 cameras, the undistorted pictures.

    Birthday_undist_00151_00.png ...     scene, frame, camera
    cameras_parameters.txt               a header, then a row per camera: f cx cy aspect skew qw qx qy qz tx ty tz
    colmap_151/ ...                      optional: points of each frame (prepared.py)

Poses are world-to-camera as COLMAP has them.  aspect is 1 and skew 0 in all scenes; the format does not say which way another aspect
would go, so it is refused.  Camera 10 (third row, third column) is held out, at full size, as STG does.
"""
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras import poses
from ...cameras.lens import Lens
from ...model.points import Points
from ...util.errors import FastGSError
from ...util.reading import read_bytes
from ..capture import Capture, Options
from ..pixels.probe import picture_size
from ..rigs import Entry, check_count, from_entries
from ..sources import Source
from .prepared import frame_workspaces, prepared_points

name = "Technicolor"
CAMERAS = "cameras_parameters.txt"
PICTURE = re.compile(r"(.+)_undist_(\d+)_(\d+)\.png", re.IGNORECASE)
COLUMNS = 12
LARGEST_FILE = 2**20
HELD_OUT = "10"
PUBLISHED = {"Birthday": 151, "Fabien": 51, "Painter": 100, "Theater": 51, "Train": 151}
"""First of the 50 frames that published figures use."""
CORRUPT = {("Birthday", 173, "09")}


def recognises(path: Path) -> bool:
    """A folder with cameras_parameters.txt and pictures with Technicolor's names."""
    return path.is_dir() and (path / CAMERAS).is_file() and any(PICTURE.fullmatch(p.name) for p in path.iterdir())


def load(path: Path, options: Options) -> Capture:
    """The capture in a scene's folder."""
    path = path if path.is_dir() else path.parent
    rows = _rows(path / CAMERAS)
    scenes, found = set(), {}
    for file in sorted(path.iterdir()):
        match = PICTURE.fullmatch(file.name)
        if match:
            scene, frame, camera = match[1], int(match[2]), f"{int(match[3]):02d}"
            scenes.add(scene)
            found[frame, camera] = file
    if len(scenes) > 1:
        raise FastGSError(f"{path}: there are pictures of several scenes ({', '.join(sorted(scenes))}); give each a folder of its own.")
    if not found:
        raise FastGSError(f"{path}: there are no pictures called like Birthday_undist_00151_00.png; the undistorted set is the one needed.")
    scene = scenes.pop()
    cameras = sorted({camera for _, camera in found})
    most = max(map(int, cameras))
    if most >= len(rows):
        raise FastGSError(f"{path / CAMERAS}: it has {len(rows)} cameras, but there are pictures of camera {most}.")
    first, last = min(frame for frame, _ in found), max(frame for frame, _ in found)
    check_count(path, last - first + 1, len(cameras))
    known = {camera: _camera(rows[int(camera)], found, camera, f"{path / CAMERAS}: camera {camera}") for camera in cameras}
    entries, gaps, notes = [], [], []
    for frame in range(first, last + 1):
        for camera in cameras:
            if (scene, frame, camera) in CORRUPT:
                notes += [f"frame {frame} of camera {camera} is left out: it is corrupt as published"] if (frame, camera) in found else []
            elif (frame, camera) not in found:
                gaps.append((camera, frame - first))
            else:
                source, pose = known[camera]
                entries.append(Entry(camera, frame - first, Source(found[frame, camera], **source), pose))
    begin = PUBLISHED.get(scene)
    if begin is not None and first <= begin and begin + 49 <= last and (first, last) != (begin, begin + 49):
        notes.append(f"published figures use the pictures {begin} to {begin + 49}: frames {begin - first}:{begin - first + 50}")
    points, remarks = _prepared(path, {camera: pose for camera, (_, pose) in known.items()}, first, last, options)
    return from_entries(path, name, entries, options, frame_count=last - first + 1, start_frame=first, held_out=[HELD_OUT],
                        notes=notes + remarks, gaps=gaps, points=points)


def _prepared(path: Path, poses_of: dict[str, np.ndarray], first: int, last: int, options: Options) -> tuple[Points | None, list[str]]:
    """Points of each frame (prepared.py); workspaces have the pictures' numbers, and cameras are called 00 or cam00 there."""
    named = poses_of | {f"cam{camera}": pose for camera, pose in poses_of.items()}
    start = first if min(frame_workspaces(path), default=0) >= first else 0
    chosen = range(last - first + 1)[options.frames] if options.frames is not None else range(last - first + 1)
    return prepared_points(path, named, chosen, start) if len(chosen) and chosen.step > 0 else (None, [])


def _camera(row: list[float], found: dict, camera: str, where: str) -> tuple[dict[str, Any], np.ndarray]:
    """The settings of the camera's Sources, and its pose."""
    focal, cx, cy, aspect, skew = row[:5]
    if abs(aspect - 1) > 1e-3:
        raise FastGSError(f"{where} has an aspect of {aspect:g}; only square pixels are known from this layout.")
    size = picture_size(Source(next(file for (_, name), file in found.items() if name == camera)))
    given = poses.intrinsics(where, focal, focal, cx, cy, *size)
    return dict(intrinsics=given, lens=Lens(skew=skew / focal)), poses.from_quaternion(row[5:9], row[9:12], where)


def _rows(file: Path) -> list[list[float]]:
    lines = read_bytes(file, LARGEST_FILE).decode("utf-8", "replace").splitlines()[1:]
    rows = []
    for i, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        where = f"{file}: line {i + 2}"
        if len(words) == COLUMNS + 2:
            raise FastGSError(f"{where} has the columns of the distorted pictures; give the file of the undistorted ones.")
        rows.append(poses.numbers([poses.read(word, where) for word in words], (COLUMNS,), where).tolist())
    if not rows:
        raise FastGSError(f"{file}: there are no cameras in it.")
    return rows
