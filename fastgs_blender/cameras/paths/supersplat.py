# SPDX-License-Identifier: GPL-3.0-or-later
"""SuperSplat and PlayCanvas' viewer: keyframes of position, target and field of view, with a spline through them.

settings.json of the viewer has animTracks: frameRate, duration (seconds), smoothness, interpolation, keyframes.times (frames) and
.values (position and target [3 K], fov [K]); the first version has one camera.fov for all.  A project (.ssproj, a zip with
document.json) has poseSets and timeline.  (playcanvas/supersplat-viewer, src/schemas, src/core/spline.ts; playcanvas/supersplat,
src/camera-poses.ts, src/doc.ts.)

Cameras are level: y is up.  fov holds across the longer side of the picture.  Both programs turn a splat file half about z.
"""
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from ...util import rotations
from ...util.errors import FastGSError, LossWarning
from ...util.reading import reading
from ...util.zip_files import opened_zip, read_member
from .. import poses
from ..camera import Camera
from . import base
from .base import CameraPath, Picture

name, label = "supersplat", "SuperSplat / PlayCanvas settings.json"
TURN = np.diag([-1.0, -1.0, 1.0])
"""Between the world of a splat file and PlayCanvas'."""
UP = np.array([0.0, 1.0, 0.0])
LEAST_RATE = 8
"""Tracks with a lower frame rate count in seconds; their frames are taken at the scene's rate."""
LARGEST_DOCUMENT = 64 * 2**20
STEEPEST = 1e15
"""Slopes beyond it, per frame, are none."""


def recognises(values: object) -> bool:
    return isinstance(values, dict) and ("animTracks" in values or "poseSets" in values)


def read_project(file: Path) -> dict:
    """document.json of a project."""
    advice = "this is no SuperSplat project, or it is damaged; save it again in SuperSplat"
    with reading(file, advice), opened_zip(file) as archive:
        document = archive.getinfo("document.json")
        if document.file_size > LARGEST_DOCUMENT:
            raise FastGSError(f"{file}: its document.json is larger than {LARGEST_DOCUMENT} bytes, so it is no project's.")
        return json.loads(read_member(archive, document).decode("utf-8-sig"))


def load(file: Path, values: dict, picture: Picture) -> CameraPath:
    times, points, rate, length, period, smoothness, step = _project(file, values) if "poseSets" in values else _settings(file, values)
    if len(times) > 1 and (np.diff(times) <= 0).any():
        raise FastGSError(f"{file}: the frames of its keyframes must increase.")
    fps = rate if rate >= LEAST_RATE else picture.fps
    base.check_frames(file, times)
    base.check_length(file, max(length, times[-1]) * fps / rate + 1)
    count = max(round(length * fps / rate), int(times[-1] * fps / rate + 1e-6) + 1)
    spline = _spline(times, points, period, smoothness, step)
    keys = [(at * fps / rate, _camera(point, picture, f"{file}: keyframe {i}")) for i, (at, point) in enumerate(zip(times, points))]
    return CameraPath([_camera(spline(f * rate / fps), picture, f"{file}: frame {f}") for f in range(count)], fps, keys=keys)


def save(path: CameraPath, file: str | Path, picture: Picture) -> None:
    base.warn_of_losses(path, label)
    if path.names:
        warnings.warn(f"{label} holds no names of cameras; they are numbered.", LossWarning, stacklevel=2)
    fps, first = path.fps or picture.fps, path.cameras[0]
    warnings.warn(f"{label} holds no size of pictures; it is left out ({first.width} x {first.height}).", LossWarning, stacklevel=2)
    if fps < LEAST_RATE:
        warnings.warn(f"{label} holds no frame rate below {LEAST_RATE}: the frames are read as keyframes, with others between them.",
                      LossWarning, stacklevel=2)
    places = np.array([base.camera_to_world(camera) for camera in path.cameras])
    position, forward = places[:, :3, 3] @ TURN, places[:, :3, 2] @ TURN
    if np.abs(places[:, :3, 0] @ TURN @ UP).max() > 1e-6:
        warnings.warn(f"{label} holds level cameras only; their roll is left out.", LossWarning, stacklevel=2)
    side = max(first.width, first.height)
    fov = [base.degrees_of(camera.fy, side) for camera in path.cameras]
    start = {"position": position[0].tolist(), "target": (position + forward)[0].tolist(), "fov": fov[0]}
    off = {"enabled": False}
    base.write_json(file, {
        "version": 2, "tonemapping": "none", "highPrecisionRendering": False, "background": {"color": [0, 0, 0]},
        "postEffectSettings": {
            "sharpness": {**off, "amount": 0}, "bloom": {**off, "intensity": 1, "blurLevel": 2},
            "grading": {**off, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
            "vignette": {**off, "intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1}, "fringing": {**off, "intensity": 0.5}},
        "animTracks": [{
            "name": "cameraAnim", "duration": len(path) / fps, "frameRate": fps, "loopMode": "none", "interpolation": "spline",
            "smoothness": 1, "keyframes": {"times": list(range(len(path))), "values": {
                "position": position.ravel().tolist(), "target": (position + forward).ravel().tolist(), "fov": fov}}}],
        "cameras": [{"initial": start}], "annotations": [], "startMode": "animTrack"})


def _settings(file: Path, values: dict) -> tuple[Any, ...]:
    """Times [K], points [K, 7], frame rate, length in frames, period of the spline or None, smoothness, whether it goes in steps."""
    tracks = [track for track in poses.listed(values.get("animTracks") or [], f"{file}: its animTracks", 0) if isinstance(track, dict)]
    track = next((t for t in tracks if isinstance(t.get("keyframes"), dict) and t["keyframes"].get("times")), None)
    if track is None:
        raise FastGSError(f"{file}: there is no camera animation in these settings; export them from SuperSplat with an animation.")
    where = f"{file}: the animation {shortened(track.get('name', ''))}"
    rate = poses.number(track.get("frameRate") or 30, f"{where}: its frameRate", 1e-3, 1e6)
    listed = poses.listed(track["keyframes"]["times"], f"{where}: its times")
    count = len(listed)
    times = np.clip(poses.numbers(listed, (count,), f"{where}: its times"), -1e9, 1e9) * (1 if track.get("frameRate") else rate)
    found = poses.table(track["keyframes"].get("values"), f"{where}: its values")
    position, target = (poses.near(poses.numbers(found.get(key), (3 * count,), f"{where}: its {key}"), where).reshape(-1, 3)
                        for key in ("position", "target"))
    camera: Any = values.get("camera") if isinstance(values.get("camera"), dict) else {}
    fov = found.get("fov", [camera.get("fov") or 60] * count)
    points = np.concatenate([position, target, poses.numbers(fov, (count,), f"{where}: its fov")[:, None]], 1)
    length = poses.number(track.get("duration", 0), f"{where}: its duration", 0, 1e7) * rate
    period = max(length + (rate if abs(length - times[-1]) < 1e-9 * max(length, 1) else 0), times[-1] - times[0] + 1e-3)
    smoothness = poses.number(track.get("smoothness", 0), f"{where}: its smoothness", 0, 10)
    return times, points, rate, length, period, smoothness, track.get("interpolation") == "step"


def _project(file: Path, values: dict) -> tuple[Any, ...]:
    sets = [s for s in poses.listed(values.get("poseSets") or [], f"{file}: its poseSets", 0) if isinstance(s, dict) and s.get("poses")]
    if not sets:
        raise FastGSError(f"{file}: there are no camera keyframes in this project; add some on SuperSplat's timeline.")
    timeline: Any = values.get("timeline") if isinstance(values.get("timeline"), dict) else {}
    camera: Any = values.get("camera") if isinstance(values.get("camera"), dict) else {}
    rate = poses.number(timeline.get("frameRate", 30), f"{file}: its frameRate", 1e-3, 1e6)
    rows = []
    for i, entry in enumerate(poses.listed(sets[0]["poses"], f"{file}: its poses")):
        where = f"{file}: pose {i}"
        entry = poses.table(entry, where)
        rows.append([poses.number(entry.get("frame", i * rate), f"{where}: its frame", 0, 1e7),
                     *poses.near(poses.numbers(entry.get("position"), (3,), f"{where}: its position"), where),
                     *poses.near(poses.numbers(entry.get("target"), (3,), f"{where}: its target"), where),
                     poses.number(entry.get("fov", camera.get("fov", 60)), f"{where}: its fov")])
    keys = np.array(sorted(rows, key=lambda row: row[0]))
    length = poses.number(timeline.get("frames", 180), f"{file}: its frames", 1, base.MOST_INTERPOLATED)
    kept = keys[keys[:, 0] < length]
    if not len(kept):
        raise FastGSError(f"{file}: all its keyframes lie beyond the end of its timeline.")
    smoothness = poses.number(timeline.get("smoothness", 1), f"{file}: its smoothness", 0, 10)
    return kept[:, 0], kept[:, 1:], rate, length, length if timeline.get("loop", True) else None, smoothness, False


def _spline(times: np.ndarray, points: np.ndarray, period: float | None, smoothness: float, step: bool) -> Callable[[float], np.ndarray]:
    """A function of the frame: a cubic Hermite spline whose slopes are those between the neighbours, times smoothness.

    period: the length after which it starts over; None: it has ends.
    """
    if len(times) == 1:
        return lambda at: points[0]
    if period is not None:
        times = np.concatenate([times[-2:] - period, times, times[:2] + period])
        points = np.concatenate([points[-2:], points, points[:2]])
    slopes = np.empty_like(points)
    with np.errstate(all="ignore"):
        slopes[1:-1] = (points[2:] - points[:-2]) / (times[2:] - times[:-2])[:, None]
        slopes[0], slopes[-1] = ((points[b] - points[a]) / (times[b] - times[a]) for a, b in ((0, 1), (-2, -1)))
    slopes[~(np.abs(slopes) < STEEPEST)] = 0  # of keyframes that stand at one time, or all but

    def at_frame(at: float) -> np.ndarray:
        if at <= times[0] or at >= times[-1]:
            return points[0 if at <= times[0] else -1]
        i = int(np.searchsorted(times, at, side="right")) - 1
        width = times[i + 1] - times[i]
        t = (at - times[i]) / width
        if step:
            return points[i]
        rise = smoothness * width * (slopes[i] * t * (1 - t) ** 2 - slopes[i + 1] * t * t * (1 - t))
        return points[i] * (1 + 2 * t) * (1 - t) ** 2 + points[i + 1] * t * t * (3 - 2 * t) + rise

    return at_frame


def _camera(point: np.ndarray, picture: Picture, where: str) -> Camera:
    """A level camera at point[:3] that looks at point[3:6]."""
    forward = point[3:6] - point[:3]
    distance = np.linalg.norm(forward)
    if distance < 1e-12:
        raise FastGSError(f"{where}: the camera is where its target is, so it looks nowhere.")
    forward = forward / distance
    right = np.cross(forward, UP)
    right = np.array([1.0, 0, 0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    pose = rotations.transform(TURN @ np.stack([right, np.cross(forward, right), forward], 1), TURN @ point[:3])
    side = max(picture.width, picture.height)
    return base.symmetric(picture.width, picture.height, base.focal_of(point[6], side, where), poses.inverse(pose))
