# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of RealityScan (RealityCapture), with a film or a picture for each camera beside them.

    cameras.csv             "Internal/External camera parameters": #name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2
    cam01.xmp ...           "Metadata (XMP)": a file for each picture, with Rotation, Position, FocalLength35mm, PrincipalPointU and V,
                            DistortionModel and DistortionCoeficients (k1 k2 k3 k4 t1 t2)

Both count lengths on the picture in its longer side: f of a film 36 mm wide, the principal point as a share of the longer side from the
middle.  t1 and t2 are OpenCV's p2 and p1.  The world has z up.  XMP's rotation is from world to camera, with OpenCV's axes, and its
position is the camera's centre.  The angles in the table are degrees: heading about z, clockwise, then pitch about x, then roll about y, of
a camera that looks down.  The division model is x' = x (1 + k1 |x'|^2), and is fitted.
"""
import csv
import io
from pathlib import Path, PureWindowsPath

import numpy as np

from ...cameras import opencv, poses
from ...util import rotations
from ...util.errors import FastGSError
from ...util.reading import read_text
from ...util.xml_files import plain_xml
from .. import beside
from ..capture import Capture, Options
from ..sources import beginning

name = "RealityScan"
LARGEST_FILE = 64 << 20
MOST_CAMERAS = 10_000
NEEDED = ("name", "x", "y", "alt", "heading", "pitch", "roll", "f")
NAMESPACE = "{http://www.capturingreality.com/ns/xcr/1.1#}"
MODELS = ("none", "perspective", "brown3", "brown3t2", "brown4", "brown4t2", "division")
COEFFICIENTS = ("k1", "k2", "k3", "k4", "t1", "t2")
FILM = 36.0
"""Millimetres that f counts the longer side as."""


def recognises(path: Path) -> bool:
    """A folder with such a table or such files of metadata, or one of them."""
    return bool(_files(path))


def load(path: Path, options: Options) -> Capture:
    """The capture of the cameras that have a film, or else a picture."""
    files = _files(path)
    tables = [file for file in files if file.suffix.lower() == ".csv"]
    if len(tables) > 1:
        raise FastGSError(f"{path}: there are {len(tables)} tables of RealityScan's cameras in it; give the file to be used instead.")
    if not files or len(files) > MOST_CAMERAS:
        raise FastGSError(f"{path}: it has {len(files)} files of RealityScan's cameras, and 1 to {MOST_CAMERAS} are read.")
    cameras = _table(tables[0]) if tables else [_metadata(file) for file in files]
    return beside.capture_of(path, name, (tables or files)[0], cameras, options, photographed=True)


def _table(file: Path) -> list[opencv.Calibrated]:
    lines = (line for line in _commas(read_text(file, LARGEST_FILE)).splitlines() if not line.lower().startswith("#cameras"))
    rows = list(csv.DictReader(io.StringIO("\n".join(lines).removeprefix("#"))))
    if not 0 < len(rows) <= MOST_CAMERAS:
        raise FastGSError(f"{file}: it has {len(rows)} cameras, and 1 to {MOST_CAMERAS} are read; export it again.")
    found = []
    for row in rows:
        where = f"{file}: camera {row['name']}"
        value = {key: poses.read(row.get(key) or "0", f"{where}: its {key}") for key in (*NEEDED[1:], "px", "py", *COEFFICIENTS)}
        angles = np.radians([-value["heading"], value["pitch"], value["roll"]])
        heading, pitch, roll = (opencv.from_rodrigues(angle * np.eye(3)[axis], where) for angle, axis in zip(angles, (2, 0, 1)))
        place = poses.near(np.array([value["x"], value["y"], value["alt"]]), where)
        lens = _lens("brown4t2", [value[key] for key in COEFFICIENTS], value["f"], where)
        pose = poses.from_opengl(rotations.transform(heading @ pitch @ roll, place))
        found.append(_calibrated(PureWindowsPath(row["name"]).stem, value["f"], value["px"], value["py"], 1.0, lens, pose, where))
    return found


def _metadata(file: Path) -> opencv.Calibrated:
    described = next((each for each in plain_xml(file, 1 << 20).iter() if f"{NAMESPACE}FocalLength35mm" in each.attrib), None)
    if described is None:
        raise FastGSError(f"{file}: it has no FocalLength35mm; export the metadata with calibration and position.")

    def numbers(key: str, default: str = "") -> list[float]:
        text = described.get(f"{NAMESPACE}{key}") or described.findtext(f"{NAMESPACE}{key}") or default
        return [poses.read(word, f"{file}: its {key}") for word in text.split()]

    turn = poses.numbers(numbers("Rotation"), (9,), f"{file}: its Rotation").reshape(3, 3)
    pose = rotations.transform(turn, -turn @ poses.numbers(numbers("Position"), (3,), f"{file}: its Position"))
    if any(numbers("Skew")):
        raise FastGSError(f"{file}: its Skew is not 0, which is not known here; undistort the pictures.")
    (f, *_), (aspect, *_) = numbers("FocalLength35mm", "0"), numbers("AspectRatio", "1")
    (u, *_), (v, *_) = numbers("PrincipalPointU", "0"), numbers("PrincipalPointV", "0")
    lens = _lens(described.get(f"{NAMESPACE}DistortionModel", "brown3"), numbers("DistortionCoeficients"), f, str(file))
    return _calibrated(file.stem, f, u, v, aspect, lens, poses.rigid(pose, f"{file}: its Rotation"), str(file))


def _lens(model: str, coefficients: list[float], f: float, where: str) -> opencv.Lens:
    if model not in MODELS:
        raise FastGSError(f"{where}: its DistortionModel {model} is not known; there are {', '.join(MODELS)}, or undistort the pictures.")
    k1, k2, k3, k4, t1, t2 = [*coefficients, *[0.0] * 6][:6]
    reach = np.hypot(0.5, 0.5) * FILM / max(f, 1e-3)
    if model == "division":
        return opencv.fitted(lambda r: 2 * r / (1 + np.sqrt(np.maximum(1 - 4 * k1 * r * r, 0))), reach, where)
    return opencv.brown((k1, k2, k3, k4), (t2, t1), 0.0, reach, where)


def _calibrated(called: str, f: float, u: float, v: float, aspect: float, lens: opencv.Lens, pose: np.ndarray,
                where: str) -> opencv.Calibrated:
    if not (f > 0 and aspect > 0):
        raise FastGSError(f"{where}: its focal length must be above 0; export it again.")
    matrix = np.array([[f / FILM, 0, u], [0, f / FILM * aspect, v], [0, 0, 1]])
    return opencv.Calibrated(called, matrix, lens, pose, relative=True)


def _files(path: Path) -> list[Path]:
    """The table or the metadata in a folder or, if there are none, in folders in it; or the file itself and those beside it."""
    if not path.is_dir():
        beside_it = sorted(path.parent.glob("*.xmp")) if path.suffix.lower() == ".xmp" else [path]
        return [file for file in beside_it if _is_export(file)]
    for places in (path.iterdir(), path.glob("*/*")):
        found = [file for file in sorted(places) if _is_export(file)]
        tables = [file for file in found if file.suffix.lower() == ".csv"]
        if found:
            return tables or [file for file in found if file.parent == found[0].parent]
    return []


def _commas(text: str) -> str:
    """A table whose columns commas separate: spreadsheets of some countries put semicolons there, and commas into numbers."""
    return text.replace(",", ".").replace(";", ",") if text.count(";") > text.count(",") else text


def _is_export(file: Path) -> bool:
    head = beginning(file, (".csv", ".xmp"))
    lines = _commas(head.decode("utf-8", "replace")).lower().splitlines()
    if file.suffix.lower() == ".xmp":
        return b"capturingreality" in head
    columns = next((line for line in lines if line.startswith(("#name", "name"))), "")
    return set(NEEDED) <= {column.strip() for column in columns.removeprefix("#").split(",")}
