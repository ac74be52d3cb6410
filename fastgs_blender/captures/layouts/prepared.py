# SPDX-License-Identifier: GPL-3.0-or-later
"""Workspaces of COLMAP for each frame, colmap_0, colmap_1 ..., as Spacetime Gaussians prepares them beside a data set's own files.

They bring points of every frame.  These are used if the workspaces' cameras stand where the data set's own calibration has them.
"""
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...cameras.colmap_files import has_model, largest, read_images, read_points
from ..capture import Points

MODEL_PLACES = ("sparse/0", "sparse", ".", "manual", "colmap/sparse/0", "distorted/sparse/0")
SAME = 1e-3
"""Difference of two poses, beside the distances of the cameras, below which they are one."""


def model_place(path: Path) -> Path | None:
    """Where a workspace has its model; None where it has none."""
    return next((largest(path / place) for place in MODEL_PLACES if has_model(path / place)), None)


def frame_workspaces(path: Path) -> dict[int, Path]:
    """Workspaces of single frames by number: colmap_0, colmap_1, ..."""
    found = {}
    for place in path.iterdir():
        match = re.fullmatch(r"(?:colmap|frame)_?(\d+)", place.name)
        if match and place.is_dir() and model_place(place) is not None:
            found[int(match[1])] = place
    return dict(sorted(found.items()))


def timed(points: Sequence[tuple[Points | None, float]]) -> Points | None:
    """Points of several moments with their times t; None where there is none."""
    found = [(part, np.full(len(part), t, np.float32)) for part, t in points if part is not None]
    if not found:
        return None
    return Points(np.concatenate([part.xyz for part, _ in found]), np.concatenate([part.rgb for part, _ in found]),
                  np.concatenate([t for _, t in found]))


def prepared_points(path: Path, poses: Mapping[str, np.ndarray], chosen: Sequence[int], start: int = 0) -> tuple[Points | None, list[str]]:
    """The points of the frames' workspaces in a folder, and notes about them.

    poses   world-to-camera by the names of the capture's cameras, which are those of the workspaces' pictures without their endings
    chosen  the frames of the capture that are used, counted from 0;  start: the number of frame 0 in the workspaces' names
    """
    workspaces = {number - start: place for number, place in frame_workspaces(path).items() if number - start in set(chosen)}
    if not workspaces:
        return None, []
    first = next(iter(workspaces.values()))
    theirs = {Path(image.name).stem: image.world_to_camera for image in read_images(_model(first))}
    size = np.ptp([pose[:3, 3] for pose in poses.values()], axis=0).max() + 1e-9
    common = [name for name in poses if name in theirs]
    apart = max((max(np.abs(theirs[name][:3, :3] - poses[name][:3, :3]).max(),
                     np.abs(theirs[name][:3, 3] - poses[name][:3, 3]).max() / size) for name in common), default=np.inf)
    if apart > SAME:
        why = "its cameras stand elsewhere than those of the capture" if common else "it has none of the capture's cameras"
        return None, [f"the points of {first.name} and of the other frames are not used: {why}"]
    place = {frame: i / len(chosen) for i, frame in enumerate(chosen)}
    points = timed([(read_points(_model(folder)), place[frame]) for frame, folder in workspaces.items()])
    if points is None:
        return None, []
    return points, [f"{len(points)} points of {len(workspaces)} frames that COLMAP triangulated; --init file trains from them"]


def _model(folder: Path) -> Path:
    found = model_place(folder)
    assert found is not None
    return found
