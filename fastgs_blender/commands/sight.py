# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads cameras from a path of any kind: a capture, a training run, a model, or a camera file of any program."""
from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..cameras.cameras_json import View, choose
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from .info import bounds
from .shared import is_run, model_file


@dataclass(frozen=True, eq=False)
class Sight:
    """The cameras that a path leads to, and what they look at.

    path    where they were found
    views   each camera, of a moving one that of the first frame; moving: all frames of each, by name
    centre  [3] what they look at
    frames  of the clip, None where it is not known; fps: its frame rate, or None
    axes    of the world, as in GaussianModel
    """

    path: Path
    views: list[View]
    centre: np.ndarray
    frames: int | None = None
    fps: float | None = None
    axes: str = "RDF"
    moving: Mapping[str, list[View]] = field(default_factory=dict)

    def chosen(self, names: Sequence[str] | None) -> list[View]:
        """The views of those names or numbers, all without; of a single one that moves, every frame.  Raises FastGSError."""
        if names is None:
            return self.views
        found = [choose(self.views, name, self.path) for name in names]
        return self.moving.get(found[0].name, found) if len(found) == 1 else found


def sight(path: str | Path) -> Sight:
    """The cameras at a path: a capture, a training run, a model, or a camera file of any program, told apart by content."""
    from .. import formats
    from ..captures import recognised

    path = Path(path)
    if is_run(path):
        return _sight_of_model(model_file(path))
    if path.is_dir() or (path.is_file() and recognised(path)):
        try:
            return _sight_of_capture(path)
        except FastGSError:
            with contextlib.suppress(FastGSError):  # cameras without their pictures
                return _sight_of_file(path)
            raise
    try:
        formats.identify(path)
    except FastGSError as no_model:
        try:
            return _sight_of_file(path)
        except FastGSError as no_path:
            raise no_path if path.suffix.lower() in (".json", ".ssproj", ".txt", ".bin") else no_model from None
    return _sight_of_model(path)


def _sight_of_capture(path: Path) -> Sight:
    from ..captures import open_capture

    capture = open_capture(path)
    if not capture.posed:
        raise FastGSError(f"{path}: it does not say where its cameras are; fastgs train finds them, and its folder knows them then.")
    moving: dict[str, list[View]] = {}
    for shot in capture.shots:
        assert shot.camera is not None
        moving.setdefault(shot.view, []).append(View(f"{shot.view}-{shot.frame:05d}", shot.camera))
    views = [View(name, frames[0].camera) for name, frames in moving.items()]
    still = {name for name, frames in moving.items() if len({view.camera.world_to_camera.tobytes() for view in frames}) == 1}
    return Sight(path, views, capture.focus, capture.clip.frame_count, capture.clip.fps, capture.axes,
                 {name: frames for name, frames in moving.items() if name not in still})


def _sight_of_file(path: Path) -> Sight:
    from ..cameras.flights import focus
    from ..cameras.paths import load_path

    path_of = load_path(path)
    names = path_of.names or [f"{i:05d}" for i in range(len(path_of))]
    views = [View(name, camera) for name, camera in zip(names, path_of.cameras, strict=True)]
    return Sight(path, views, focus([view.camera for view in views]), len(views) if len(views) > 1 else None, path_of.fps, path_of.axes)


def _sight_of_model(path: Path) -> Sight:
    from .. import formats
    from ..cameras.viewpoints import camera_of
    from ..model.framing import in_ball, is_subject, looked_at, without_backdrop

    source = formats.open_source(path)
    model = source.moment(0.0)[0]
    place = without_backdrop(model).position
    place = place[in_ball(place, looked_at(model.surroundings.cameras))]
    centre = np.median(place[is_subject(place)], axis=0).astype(np.float64) if len(place) else np.zeros(3)
    views = [View(point.name or f"{i:05d}", camera_of(point)) for i, point in enumerate(model.surroundings.cameras)]
    views = views or [View("overview", overview(model, 1280, 720))]
    return Sight(path, views, centre, source.clip.frame_count, source.clip.fps, model.axes)


def overview(model: GaussianModel, width: int, height: int) -> Camera:
    """A camera outside the model that sees all of its centres at t = 0, looking along the axis that the model calls forward."""
    low, high = bounds(model)
    if low is None or high is None:
        raise FastGSError("the model has no Gaussians to look at.")
    # rows: the camera's right, down and forward in the axes of the model
    right_down_forward = {"RDF": np.eye(3), "RFU": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), "RUB": np.diag([1, -1, -1])}
    rotation = right_down_forward[model.axes].astype(np.float64)
    centre, radius = (np.array(low) + high) / 2, max(float(np.linalg.norm(np.subtract(high, low))) / 2, 1e-6)
    focal, distance = 1.2 * min(width, height), 2.6 * radius + model.raster.near
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ centre + [0, 0, distance]
    return Camera(width, height, focal, focal, width / 2, height / 2, matrix)
