# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json, as INRIA's trainer and everything derived from it writes it.

A list of {id, img_name, width, height, position, rotation, fx, fy}: position is the camera's centre in the world, rotation the
3 x 3 camera-to-world matrix in OpenCV axes.  cx and cy are read where present, else the principal point is the image's centre.
"""
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..util import rotations
from ..util.arguments import shown
from ..util.errors import FastGSError
from ..util.outputs import writing
from ..util.reading import read_json, reading
from . import poses
from .camera import LARGEST_SIDE, Camera

LARGEST_FILE = 256 * 2**20


@dataclass(frozen=True)
class View:
    """One entry of the file: its name (img_name, else its number) and its camera.

    Example:
        names = [view.name for view in fg.load_cameras("examples/cameras.json")]
    """

    name: str
    camera: Camera


def load_cameras(path: str | Path) -> list[View]:
    """The cameras of a cameras.json; raises FastGSError where the file cannot be read or an entry is wrong.

    Example:
        camera = fg.load_cameras("examples/cameras.json")[4].camera
    """
    path = Path(path)
    entries = read_json(path, LARGEST_FILE, "it is not JSON, or cut short; give a cameras.json as 3DGS trainers write it")
    with reading(path):
        return _views(path, entries)


def save_cameras(views: Iterable[View | Camera], path: str | Path) -> None:
    """Write cameras as a cameras.json, each a View with a name or a Camera, which is named by its number.

    Raises FastGSError for parallel projections, which such a file cannot hold, and where it cannot be written.

    Example:
        fg.save_cameras([camera], "cameras.json")
    """
    path = Path(path)
    given = list(views) if isinstance(views, Iterable) else [views]
    wrong = [view for view in given if not isinstance(view, (View, Camera))]
    if wrong or not isinstance(views, Iterable):
        raise FastGSError(f"a cameras.json is written from a list of cameras, Camera or View, not from {shown((wrong or given)[0])}.")
    named = [view if isinstance(view, View) else View(f"{i:05d}", view) for i, view in enumerate(given)]
    if any(view.camera.orthographic for view in named):
        raise FastGSError(f"{path}: a cameras.json holds perspective cameras only.")
    entries = []
    for i, view in enumerate(named):
        camera, pose = view.camera, poses.inverse(view.camera.world_to_camera)
        entries.append({"id": i, "img_name": view.name, "width": camera.width, "height": camera.height, "position": pose[:3, 3].tolist(),
                        "rotation": pose[:3, :3].tolist(), "fy": camera.fy, "fx": camera.fx, "cx": camera.cx, "cy": camera.cy})
    with writing([path], "choose another place") as (part,):
        part.write_text(json.dumps(entries, allow_nan=False) + "\n", encoding="utf-8")


def _views(path: str | Path, entries: Any) -> list[View]:
    if isinstance(entries, dict) and isinstance(entries.get("format"), str) and entries["format"].startswith("fast-gs "):
        raise FastGSError(f"{path}: this describes a {entries['format'][:40]}, and not cameras as 3DGS trainers write them; both kinds of "
                          "file are called cameras.json; fastgs cameras writes one of this kind from it.")
    entries = [entries] if isinstance(entries, dict) else entries
    if not isinstance(entries, list) or not entries:
        raise FastGSError(f"{path}: the camera file must hold a list of at least one camera.")
    return [_view(path, i, entry) for i, entry in enumerate(entries)]


def _view(path: str | Path, i: int, entry: Any) -> View:
    where = f"{path}: camera {i}"
    if not isinstance(entry, dict):
        raise FastGSError(f"{where} must be a table of named values, not {type(entry).__name__}.")
    missing = [key for key in ("width", "height", "position", "rotation", "fx", "fy") if key not in entry]
    if missing:
        raise FastGSError(f"{where} lacks {', '.join(missing)}.")
    width, height = (poses.number(entry[key], f"{where}: its {key}") for key in ("width", "height"))
    if not all(v == int(v) and 1 <= v <= LARGEST_SIDE for v in (width, height)):
        raise FastGSError(f"{where} must have a width and height of whole pixels from 1 to {LARGEST_SIDE}, not {width:g} x {height:g}.")
    fx, fy = (poses.number(entry[key], f"{where}: its {key}") for key in ("fx", "fy"))
    if not (fx > 0 and fy > 0):
        raise FastGSError(f"{where} must have positive focal lengths fx and fy, not {fx:g} and {fy:g}.")
    rotation = poses.numbers(entry["rotation"], (3, 3), f"{where}: its rotation")
    position = poses.near(poses.numbers(entry["position"], (3,), f"{where}: its position"), where)
    if np.abs(rotation).max() > 2 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise FastGSError(f"{where} has a rotation that is not a rotation matrix (orthonormal, determinant +1).")
    world_to_camera = rotations.transform(rotation.T, -rotation.T @ position)
    camera = Camera(
        int(width), int(height), fx, fy,
        poses.number(entry["cx"], f"{where}: its cx") if "cx" in entry else width / 2,
        poses.number(entry["cy"], f"{where}: its cy") if "cy" in entry else height / 2,
        world_to_camera)
    name = next((entry[key] for key in ("img_name", "id") if isinstance(entry.get(key), (str, int))), i)
    return View(str(name), camera)


def choose(views: list[View], name: str, path: str | Path) -> View:
    """The view of that name or, where there is none, of that number; raises FastGSError if it is not there."""
    for view in views:
        if view.name == name:
            return view
    if name.isdecimal() and int(name) < len(views):
        return views[int(name)]
    known = ", ".join(view.name for view in views[:8]) + (", ..." if len(views) > 8 else "")
    numbers = f"are the numbers 0 to {len(views) - 1} and the names" if len(views) > 1 else "is the number 0, named"
    raise FastGSError(f"{path}: there is no view {name!r}; there {numbers} {known}.")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another image size: the horizontal field of view stays, nothing is stretched."""
    s = width / camera.width
    return replace(
        camera, width=width, height=height, fx=camera.fx * s, fy=camera.fy * s, window=(0, 0, width, height),
        cx=camera.cx * s, cy=height / 2 + (camera.cy - camera.height / 2) * s)
