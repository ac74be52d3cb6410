# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrations that OpenCV's FileStorage wrote (YAML or XML), with a film for each camera beside them.

Three ways in which people keep several cameras are read:

    cam01.yml, cam02.yml ...        a file for each camera, called like it: camera_matrix, distortion_coefficients, and where it stands:
                                    R and T, rvec and tvec, or extrinsics (3 x 4 or 4 x 4)
    intri.yml, extri.yml            EasyMocap's, or one file for all: K_01, dist_01, R_01 (or Rot_01) and T_01, a number or a name for each
    intrinsics.yml, extrinsics.yml  a stereo pair, as OpenCV's stereo_calib writes it, also in one file: M1, D1, M2, D2, R and T; the first
                                    camera is the world

All poses are from world to camera.  The names of values may be spelt as QUANTITIES has them, in any case, with or without underscores.
"""
import contextlib
import re
from pathlib import Path

import numpy as np

from ...cameras import opencv
from ...cameras.file_storage import ENDINGS, read_storage
from ...util.errors import FastGSError
from .. import beside
from ..capture import Capture, Options
from ..sources import beginning, files_at

name = "calibration by OpenCV"
MOST_FILES = 1000
QUANTITIES = {
    "matrix": ("cameramatrix", "intrinsicmatrix", "intrinsics", "intrinsic", "cammatrix", "cameraintrinsics", "mtx", "k", "m", "cm"),
    "distortion": ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distortion", "dist", "d"),
    "rotation": ("rotationmatrix", "rot", "rotation", "rotationvector", "rvec", "r"),
    "translation": ("translationvector", "translation", "trans", "tvec", "t"),
    "extrinsics": ("extrinsics", "extrinsic", "extrinsicmatrix", "worldtocamera", "rt"),
    "size": ("imagesize", "size", "resolution"), "width": ("imagewidth", "width"), "height": ("imageheight", "height"),
}
"""Spellings of each value, in lower case and without underscores; of two that a file has, the one named first here counts."""
ARRAYS = ("matrix", "distortion", "rotation", "translation", "extrinsics")
SIDES = {"left": "left", "right": "right", "l": "left", "r": "right"}
FISHEYE = ("fisheye", "equidistant", "kannala_brandt")
STEREO = "the pair"


def recognises(path: Path) -> bool:
    """A folder with such calibrations of cameras and their poses in it or in a folder in it, or one of these files."""
    files = _files(path)
    with contextlib.suppress(FastGSError):
        return any(_has_pose(table) for table in _tables(files).values())
    return bool(files)  # damaged: load() is to tell


def load(path: Path, options: Options) -> Capture:
    """The capture of the calibrated cameras that have a film."""
    files = _files(path)
    if not files:
        raise FastGSError(f"{path}: there is no YAML or XML of OpenCV's FileStorage with a camera's matrix in it; export the calibration "
                          "again.")
    return beside.capture_of(path, name, files[0], read_cameras(files), options)


def read_cameras(files: list[Path]) -> list[opencv.Calibrated]:
    """The cameras that these files describe together; raises FastGSError."""
    tables = _tables(files)
    pair = tables.pop(STEREO, None)
    if pair is not None and len(tables) == 2:
        first, second = tables.values()
        first |= {"rotation": np.eye(3), "translation": np.zeros(3)}
        second |= pair
    where = files[0] if len(files) == 1 else files[0].parent
    cameras = [_camera(called, table, f"{where}: camera {called}") for called, table in tables.items() if "matrix" in table]
    if not cameras:
        raise FastGSError(f"{where}: it holds no camera's matrix (camera_matrix, K_01, M1 ...); export the calibration again.")
    return cameras


def _has_pose(table: dict) -> bool:
    return "extrinsics" in table or {"rotation", "translation"} <= set(table)


def _camera(called: str, table: dict, where: str) -> opencv.Calibrated:
    if not _has_pose(table):
        raise FastGSError(f"{where}: it has a matrix and no pose; add R and T, or rvec and tvec, from world to camera.")
    size = table.get("size")
    if size is None and {"width", "height"} <= set(table):
        size = [table["width"], table["height"]]
    size = None if size is None else list(np.ravel(size)) if isinstance(size, (list, np.ndarray)) else size
    rotation, translation = table.get("rotation"), table.get("translation")
    if rotation is None or translation is None:
        matrix = np.asarray(table["extrinsics"])
        if matrix.shape not in {(3, 4), (4, 4)}:
            raise FastGSError(f"{where}: its extrinsics must be 3 x 4 or 4 x 4 numbers.")
        rotation, translation = matrix[:3, :3], matrix[:3, 3]
    if size is not None and (not isinstance(size, list) or len(size) != 2):
        raise FastGSError(f"{where}: its size must be a width and a height.")
    return opencv.camera(called, where, table["matrix"], table.get("distortion"), rotation, translation, size, bool(table.get("fisheye")))


def _tables(files: list[Path]) -> dict[str, dict]:
    """The quantities of each camera by its name; STEREO has what stands between the two cameras of a pair."""
    found: dict[str, dict] = {}
    for file in files:
        values = read_storage(file)
        own = values.get("camera_name", values.get("name"))
        own = own if isinstance(own, str) and own else file.stem
        listed = values.get("names")
        known = [str(name) for name in listed] if isinstance(listed, list) else []
        sorted_out: dict[str, dict] = {}
        for key, value in values.items():
            quantity, whose, preference = _meaning(key, known)
            if quantity in ARRAYS and not isinstance(value, (list, np.ndarray)):
                continue  # k1 may be a coefficient
            table = sorted_out.setdefault(whose, {})
            if quantity and preference < table.get(f"{quantity}'s", (np.inf,))[0]:
                table[quantity], table[f"{quantity}'s"] = value, (preference,)
        shared = sorted_out.pop("", {})
        shared = {key: value for key, value in shared.items() if not key.endswith("'s")}
        several = {whose: table for whose, table in sorted_out.items() if table}
        model = str(values.get("camera_model", values.get("distortion_model", ""))).lower()
        if values.get("fisheye") in (1, "1", "true", "True") or model in FISHEYE:
            for table in [shared, *several.values()]:
                table["fisheye"] = True
        if "matrix" in shared:
            found.setdefault(own, {}).update(shared)
        elif _has_pose(shared) and "matrix" not in shared:  # of the second camera of a pair; R1 and R2 rectify there
            found.setdefault(STEREO, {}).update({key: shared[key] for key in ("rotation", "translation", "extrinsics") if key in shared})
            several = {whose: {key: value for key, value in table.items() if key not in {"rotation", "translation"}}
                       for whose, table in several.items()}
        for whose, table in several.items():
            own_table = {key: value for key, value in table.items() if not key.endswith("'s")}
            size = {key: shared[key] for key in ("size", "width", "height") if key in shared and key not in own_table}
            found.setdefault(whose, {}).update(size | own_table)
    return {whose: table for whose, table in found.items() if table and (whose == STEREO or set(table) - {"size", "width", "height"})}


def _meaning(key: str, names: list[str]) -> tuple[str, str, int]:
    """The quantity that a value's name means ("": none), the camera it belongs to ("": the file's), and the rank of its spelling."""
    text, whose = key, ""
    for called in sorted(names, key=len, reverse=True):
        if key.endswith(f"_{called}"):
            text, whose = key[:-len(called) - 1], called
            break
    else:
        if side := re.fullmatch(r"(left|right)_?(.+)|(.+?)_(left|right|l|r)", text, re.IGNORECASE):
            text, whose = side.group(2) or side.group(3), SIDES[(side.group(1) or side.group(4)).lower()]
        elif number := re.fullmatch(r"(?:cam(?:era)?_?(\d+)_)?(.+?)_?(\d*)", text):
            text, whose = number.group(2), number.group(1) or number.group(3)
    plain = re.sub(r"[^a-z]", "", text.lower())
    for quantity, spellings in QUANTITIES.items():
        if plain in spellings:
            return quantity, whose, spellings.index(plain)
    return "", whose, 0


def _files(path: Path) -> list[Path]:
    """The calibrations in a folder or, if there are none, in a folder in it; or the file itself and, of a pair of files, the other one."""
    found = files_at(path, _is_storage)
    if path.is_dir() or not found:
        return [file for file in found if file.parent == found[0].parent][:MOST_FILES]
    beside_it = [file for file in sorted(path.parent.iterdir()) if file != path and file.suffix == path.suffix and _is_storage(file)]
    return sorted([path, *beside_it]) if re.match("intri|extri", path.stem.lower()) else [path]


def _is_storage(file: Path) -> bool:
    """Whether a file's first bytes are FileStorage's, or hold a matrix as it writes them."""
    head = beginning(file, ENDINGS, 1 << 14)
    return b"<opencv_storage" in head or b"opencv-matrix" in head or b"%YAML:1.0" in head or (b"rows:" in head and b"cols:" in head)
