# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrations in TOML, of aniposelib, Pose2Sim, FreeMoCap and caliscope, with a film for each camera beside them.

    calibration.toml             aniposelib and FreeMoCap; Calib.toml, Calib_scene.toml: Pose2Sim; camera_array.toml: caliscope
      [cam_0]                    a table for each camera; caliscope's are [cameras.0]
      name = "cam_0"             caliscope: cam_id or port; else the table's name
      size = [1280, 720]
      matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
      distortions = [k1, k2, p1, p2, k3]
      rotation = [0.1, 0.2, 0.3] Rodrigues, from world to camera; caliscope: 3 x 3
      translation = [x, y, z]
      fisheye = false            optional: OpenCV's fisheye model
      ignore = false             optional, caliscope: the camera is left out
      [metadata]                 optional; a unit in it (units = "mm") counts
    timestamps.csv               optional, caliscope's: when each frame was taken; beside the calibration or the films
    cam_0.mp4 ...                films, or folders of numbered pictures; see captures/beside.py

Without a unit, lengths are metres, or millimetres where metres cannot be meant (cameras.opencv.metric()).
"""
import contextlib
import tomllib
from pathlib import Path
from reprlib import repr as shortened

from ...cameras import opencv, poses
from ...util.errors import FastGSError
from ...util.reading import read_text, reading
from .. import beside, timestamps
from ..capture import Capture, Options
from ..sources import beginning, files_at, only

name = "calibration in TOML"
LARGEST_FILE = 16 << 20
MOST_CAMERAS = 1000
NEEDED = ("matrix", "rotation", "translation")
UNITS = {"m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "centimetres": 0.01, "centimeters": 0.01,
         "mm": 0.001, "millimetre": 0.001, "millimetres": 0.001, "millimeter": 0.001, "millimeters": 0.001}


def recognises(path: Path) -> bool:
    """A folder with such a calibration in it or in a folder in it, or that file."""
    return bool(files_at(path, _is_calibration, "*/*.toml"))


def load(path: Path, options: Options) -> Capture:
    """The capture of the calibration's cameras that have a film."""
    file = only(path, files_at(path, _is_calibration, "*/*.toml"), "calibrations in TOML") if path.is_dir() else path
    cameras, unit = read_cameras(file)
    times = _times(file, path, [camera.name for camera in cameras])
    return beside.capture_of(path, name, file, cameras, options, unit=unit, times=times)


def read_cameras(file: Path) -> tuple[list[opencv.Calibrated], float | None]:
    """The cameras in a calibration, and the length in metres of its unit (None: it does not say); raises FastGSError."""
    values = _values(file)
    nested = values.get("cameras")
    tables = nested if isinstance(nested, dict) else values
    found = {key: table for key, table in tables.items() if isinstance(table, dict) and set(NEEDED) & set(table)}
    if len(found) > MOST_CAMERAS:
        raise FastGSError(f"{file}: it has {len(found)} cameras, and at most {MOST_CAMERAS} are read.")
    cameras = [_camera(key, table, f"{file}: [{key}]") for key, table in found.items() if table.get("ignore") is not True]
    if not cameras:
        raise FastGSError(f"{file}: there are no cameras with {', '.join(NEEDED)} in it; export the calibration again.")
    return cameras, _unit(values, file)


def _camera(key: str, table: dict, where: str) -> opencv.Calibrated:
    lacking = [name for name in NEEDED if name not in table]
    if lacking:
        raise FastGSError(f"{where} lacks {', '.join(lacking)}.")
    called = next((table[name] for name in ("name", "cam_id", "port") if name in table), key)
    if isinstance(called, bool) or not isinstance(called, (str, int)) or called == "":
        raise FastGSError(f"{where}: its name must be a text or a number, not {shortened(called)}.")
    return opencv.camera(str(called), where, table["matrix"], table.get("distortions"), table["rotation"], table["translation"],
                         None if table.get("size") is None else poses.listed(table["size"], f"{where}: its size", 2),
                         table.get("fisheye") is True)


def _unit(values: dict, file: Path) -> float | None:
    about = values.get("metadata")
    said = next((about[key] for key in ("units", "unit") if key in about), None) if isinstance(about, dict) else None
    if said is None:
        return None
    if not isinstance(said, str) or said.lower() not in UNITS:
        raise FastGSError(f"{file}: its unit must be m, cm or mm, not {shortened(said)}.")
    return UNITS[said.lower()]


def _values(file: Path) -> dict:
    with reading(file, "it is not TOML, or is cut short; export the calibration again"):
        try:
            return tomllib.loads(read_text(file, LARGEST_FILE))
        except RecursionError as error:
            raise ValueError("it is nested too deeply") from error


def _is_calibration(file: Path) -> bool:
    """Whether a TOML file describes cameras; a damaged one that names their keys is to be told about."""
    head = beginning(file, (".toml",), 1 << 16)
    if not all(word.encode() in head for word in NEEDED):
        return False
    with contextlib.suppress(FastGSError):
        values = _values(file)
        tables = [values, *([values["cameras"]] if isinstance(values.get("cameras"), dict) else [])]
        return any(isinstance(table, dict) and set(NEEDED) <= set(table) for each in tables for table in each.values())
    return True


def _times(file: Path, path: Path, names: list[str]) -> timestamps.Times | None:
    """The times beside the films or the calibration, where there are any."""
    films = beside.films_of(names, file, path)[0].values()
    folders = dict.fromkeys([*(film.parent for film in films), file.parent])
    found = next((place / timestamps.FILE for place in folders if (place / timestamps.FILE).is_file()), None)
    return None if found is None else timestamps.read_times(found)
