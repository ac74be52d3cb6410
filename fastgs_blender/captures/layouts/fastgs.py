# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS captures: a folder per camera of numbered pictures (or a video per camera) beside a cameras.json; docs/captures.md.

    cameras.json                 {"format": "fast-gs capture", "version": 1, ...}
    cam00/0001.png ...           PNG, JPEG or EXR; the number is start_frame + frame.  Or cam00.mp4, whose first frame is frame 0,
                                 or whose frame number video_start is; it may lie in the folder cam00
    masks/cam00/0001.png ...     optional, white: what counts
    points.ply                   optional: x y z red green blue and t
    bake.safetensors             optional: a model of the same scene and time, with which training begins
"""
import json
from collections.abc import Sequence
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from ...cameras import poses
from ...cameras.lens import Lens
from ...model.gaussians import AXES
from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import open_file, read_json
from ..capture import MASKS, Capture, Options
from ..pixels.sequences import Unreadable, film_called, film_of, numbered_pictures, video_frames
from ..point_files import load_points
from ..rig_camera import RigCamera
from ..rigs import check_count, from_rig
from ..sources import COLOURS, Source

name = "fast-gs capture"
FORMAT, VERSION = "fast-gs capture", 1
FILE, BAKE = "cameras.json", "bake.safetensors"
MOST_FRAMES = 1_000_000


def recognises(path: Path) -> bool:
    """A folder with our cameras.json, or that file."""
    file = path / FILE if path.is_dir() else path
    if file.suffix.lower() != ".json" or not file.is_file():
        return False
    try:
        value = read_json(file)
    except FastGSError:  # damaged, but if its beginning names the format, load() is to tell what is wrong
        with open_file(file) as stream:
            return FORMAT.encode() in stream.read(4096)
    return isinstance(value, dict) and value.get("format") == FORMAT


def load(path: Path, options: Options) -> Capture:
    """The capture that cameras.json describes."""
    file = path / FILE if path.is_dir() else path
    folder, where = file.parent, f"{file}: "
    values = read_json(file)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise FastGSError(f'{file}: it does not say "format": "{FORMAT}", so it is another program\'s.')
    version = poses.integer(values.get("version", VERSION), where + "its version", 1, 10**6)
    if version > VERSION:
        raise FastGSError(f"{file}: its version {version} is newer than this program, which knows version {VERSION}; update it.")
    count = poses.integer(poses.needed(values, "frame_count", file), where + "its frame_count", 1, MOST_FRAMES)
    start = poses.integer(values.get("start_frame", 1), where + "its start_frame", -10**9, 10**9)
    mask_means, axes, colour = (_choice(values, key, known, where) for key, known in (
        ("masks", MASKS), ("axes", AXES), ("colour", COLOURS)))
    faults: list[str] = []
    entries = poses.listed(poses.needed(values, "cameras", file), where + "its cameras")
    check_count(file, count, len(entries))
    cameras = [_camera(folder, poses.table(entry, f"{where}camera {i}"), f"{where}camera {i}", count, start, colour, faults)
               for i, entry in enumerate(entries)]
    names = [camera.name for camera in cameras]
    poses.check_names(names, file)
    held_out = [poses.name_of(v, where + "its held_out") for v in poses.listed(values.get("held_out", []), where + "its held_out", 0)]
    if set(held_out) - set(names):
        raise FastGSError(f"{file}: it holds out {min(set(held_out) - set(names))!r}, which is none of its cameras.")
    points = folder / "points.ply"
    return from_rig(
        path, name, cameras, options, frame_count=count, fps=poses.number(values.get("fps", 24), where + "its fps", 1e-3, 1e6),
        start_frame=start, axes=axes, held_out=held_out, mask_means=mask_means, faults=faults,
        points=load_points(points) if points.is_file() else None, model=folder / BAKE if (folder / BAKE).is_file() else None)


def _camera(folder: Path, entry: dict, where: str, count: int, start: int, colour: str, faults: list[str]) -> RigCamera:
    called = entry.get("name")
    if not isinstance(called, str) or not called or called in {".", "..", "masks"} or any(c in called for c in '/\\:*?"<>|\0'):
        raise FastGSError(f"{where} needs a name that can be a folder's, not {shortened(called)}.")
    where = f"{where} ({called})"
    lens_given = poses.table(entry.get("distortion") or {"model": "pinhole"}, f"{where}: its distortion")
    try:
        lens = Lens.named(poses.name_of(lens_given.get("model"), "the lens model"), {k: v for k, v in lens_given.items() if k != "model"})
    except FastGSError as error:
        raise FastGSError(f"{where}: {error}") from error
    given = poses.intrinsics(where, *(poses.needed(entry, key, where) for key in ("fx", "fy", "cx", "cy", "width", "height")))
    settings = dict(lens=lens, intrinsics=given)
    place = folder / called
    video = film_of(place) if place.is_dir() else film_called(folder, called) or place
    pictures: Sequence[Source | None]
    if not video.exists():
        faults.append(Unreadable(f"there is no folder and no video called {called} beside {FILE}"))
    if not video.is_file():
        pictures = _numbered(folder / called, count, start, colour=colour, **settings)
    else:
        first = poses.integer(entry.get("video_start", 0), f"{where}: its video_start", 0, MOST_FRAMES)
        pictures = video_frames(video, faults, **settings)[0][first:]
    masks = folder / "masks" / called
    return RigCamera(called, pictures, _pose(entry, where, count), _numbered(masks, count, start) if masks.is_dir() else ())


def _numbered(folder: Path, count: int, start: int, **settings: Any) -> list[Source | None]:
    found = numbered_pictures(folder) if folder.is_dir() else {}
    return [Source(found[n], **settings) if n in found else None for n in range(start, start + count)]


def _pose(entry: dict, where: str, count: int) -> np.ndarray:
    value = poses.needed(entry, "world_to_camera", where)
    moves = isinstance(value, list) and value and isinstance(value[0], list) and value[0] and isinstance(value[0][0], list)
    if not moves:
        return poses.rigid(value, f"{where}: its world_to_camera")
    if len(value) != count:
        raise FastGSError(f"{where}: it has {len(value)} poses for {count} frames; give one, or one for each frame.")
    return np.array([poses.rigid(pose, f"{where}: its world_to_camera of frame {i}") for i, pose in enumerate(value)])


def _choice(values: dict, key: str, known: Sequence[str], where: str) -> str:
    value = values.get(key, known[0])
    if value not in known:
        raise FastGSError(f"{where}its {key} must be one of {', '.join(known)}, not {shortened(value)}.")
    return value


def write_cameras(folder: str | Path, cameras: Sequence[dict], *, frame_count: int, fps: float, start_frame: int = 1,
                  held_out: Sequence[str] = (), axes: str = "RDF", **more: str) -> Path:
    """Write cameras.json into a folder, aside and renamed; returns its path.

    cameras  tables with name, width, height, fx, fy, cx, cy, world_to_camera ([4, 4] or [F, 4, 4]) and perhaps distortion
             and video_start
    more     further keys: masks, colour
    """
    path = Path(folder) / FILE
    entries = [{key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in camera.items()} for camera in cameras]
    values = {"format": FORMAT, "version": VERSION, "fps": fps, "start_frame": start_frame, "frame_count": frame_count, "axes": axes,
              **more, "held_out": list(held_out), "cameras": entries}
    text = json.dumps(values, indent=1, allow_nan=False)
    with replacing([path]) as (part,):
        part.write_text(text, encoding="utf-8")
    return path
