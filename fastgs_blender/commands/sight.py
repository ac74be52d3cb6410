# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads cameras from a path of any kind: a capture, a training run, a model, or a camera file of any program."""
import argparse
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..cameras.cameras_json import View, choose, resized
from ..util.errors import FastGSError
from ..util.frames import Frames
from .shared import is_run, model_file, note


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
    from ..cameras.opening import overview
    from ..cameras.viewpoints import camera_of
    from ..model.framing import middle

    source = formats.open_source(path)
    model = source.moment(0.0)[0]
    views = [View(point.name or f"{i:05d}", camera_of(point)) for i, point in enumerate(model.surroundings.cameras)]
    views = views or [View("overview", overview(model, 1280, 720))]
    return Sight(path, views, middle(model), source.clip.frame_count, source.clip.fps, model.axes)


def cameras_of_frames(views: list[View], frames: Frames, args: argparse.Namespace, size: tuple[int, int] | None) -> list[Camera]:
    """The camera of each frame, as --view and --path of a command choose them."""
    if args.view is not None:
        chosen = [choose(views, args.view, args.camera)] * len(frames)
    elif len(views) == len(frames):
        chosen = views
    elif args.path:
        if not all(frame == int(frame) and 0 <= frame < len(views) for frame in frames):
            raise FastGSError(f"{args.camera} has {len(views)} cameras, so there is none for some of the {len(frames)} frames of the path.")
        chosen = [views[int(frame)] for frame in frames]
    else:
        if len(views) > 1:
            note(f"{args.camera} has {len(views)} cameras; the first, {views[0].name}, is used (--view picks another).")
        chosen = views[:1] * len(frames)
    return [resized(view.camera, *size) if size else view.camera for view in chosen]
