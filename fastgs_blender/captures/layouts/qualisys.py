# SPDX-License-Identifier: GPL-3.0-or-later
"""Qualisys Track Manager: an exported camera calibration (XML, often called .qca.txt) and one video per camera.

    Calib.qca.txt                <calibration> with a <camera serial="..."> for each camera
    ...cam01....mp4              a video, or a folder of numbered pictures, whose name holds the camera's serial as a word of its own;
                                 beside the calibration or in a folder beside it (videos/)

Intrinsics count in 1/64 of a pixel from the sensor's top left corner, so that 32 is the centre of the first pixel; fov_video, in whole
pixels, inclusive, is the part that was filmed.  transform is where the camera is: x y z its centre in millimetres, r its rotation from
world to camera in OpenGL's axes (x right, y up, looking along -z).  Distortion is OpenCV's with the coefficients as they stand; Pose2Sim
divides them by 64, which undoes next to none of it.  The world has z up and becomes metres.  The last camera is held out.
"""
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ...cameras import poses
from ...cameras.lens import Intrinsics, Lens
from ...util import rotations
from ...util.errors import FastGSError
from ...util.xml_files import plain_xml
from ..beside import first_source, is_film
from ..capture import Capture, Options
from ..pixels.probe import picture_size
from ..pixels.sequences import film_of, numbered_pictures, numbered_sources, video_frames
from ..rig_camera import RigCamera
from ..rigs import from_rig, lone_sentence
from ..sources import Source, beginning, files_at, only

name = "Qualisys"
SUBPIXELS = 64
MILLIMETRES = 1e-3
LARGEST_FILE = 16 * 2**20
MOST_CAMERAS = 1000
ENDINGS = (".txt", ".xml", ".qca")


def recognises(path: Path) -> bool:
    """A folder with a Qualisys calibration, or that file."""
    return bool(files_at(path, _is_calibration))


def load(path: Path, options: Options) -> Capture:
    """The capture of the cameras in the calibration that have a video."""
    file = only(path, files_at(path, _is_calibration), "Qualisys calibrations") if path.is_dir() else path
    cameras = _cameras(file)
    folders = [file.parent, path, *sorted(p for p in path.iterdir() if p.is_dir())] if path.is_dir() else [file.parent]
    places = _places(folders, {camera.get("serial", "") for camera in cameras})
    faults: list[str] = []
    rig, rates, lost = [], [], []
    for camera in cameras:
        serial = camera.get("serial", "")
        where = f"{file}: camera {serial}"
        if serial not in places:
            lost.append(serial)
            continue
        given = _intrinsics(camera, places[serial], where)
        pictures, fps = _pictures(places[serial], faults, lens=_lens(camera, where), intrinsics=given)
        rig.append(RigCamera(serial, pictures, _pose(camera, where)))
        rates += [fps] if fps else []
    if not rig:
        raise FastGSError(f"{file}: there is no video of any of its cameras ({', '.join(lost[:8])}) beside it; the name of a video must "
                          "hold its camera's serial.")
    faults += lone_sentence([camera.name for camera in rig], lost)
    notes = [f"left out for want of a video: {', '.join(lost)}"] if lost else []
    return from_rig(path, name, rig, options, fps=rates[0] if rates else 30.0, axes="RFU", held_out=[rig[-1].name] if len(rig) > 1 else [],
                    notes=notes, faults=faults)


def _is_calibration(file: Path) -> bool:
    head = beginning(file, ENDINGS)
    return b"<calibration" in head and b"<camera" in head


def _cameras(file: Path) -> list[ET.Element]:
    cameras = plain_xml(file, LARGEST_FILE).findall("cameras/camera")
    serials = [camera.get("serial", "") for camera in cameras]
    if not cameras or not all(serials):
        raise FastGSError(f"{file}: there are no cameras with a serial in it; export the calibration again.")
    if len(cameras) > MOST_CAMERAS:
        raise FastGSError(f"{file}: it has {len(cameras)} cameras, and at most {MOST_CAMERAS} are read.")
    poses.check_names(serials, file)
    return cameras


def _places(folders: list[Path], serials: set[str]) -> dict[str, Path]:
    """The video or folder of pictures of each camera, in the first of the folders that has one."""
    found: dict[str, Path] = {}
    for folder in folders:
        inside = sorted(folder.iterdir())
        for serial in serials - set(found):
            word = re.compile(rf"(?<![0-9a-z]){re.escape(serial)}(?![0-9a-z])", re.IGNORECASE)
            fits = [p for p in inside if word.search(p.stem) and is_film(p)]
            fits = [p for p in fits if p.stem == serial] or fits
            if len(fits) > 1:
                raise FastGSError(f"{folder}: {fits[0].name} and {fits[1].name} are both called like camera {serial}; leave one of them.")
            if fits:
                found[serial] = fits[0]
    return found


def _pictures(place: Path, faults: list[str], **settings: Any) -> tuple[Sequence[Source | None], float | None]:
    place = film_of(place)
    if place.is_file():
        return video_frames(place, faults, **settings)
    return numbered_sources(numbered_pictures(place), place, **settings), None


def _part(camera: ET.Element, called: str, where: str) -> ET.Element:
    part = camera.find(called)
    if part is None:
        raise FastGSError(f"{where} lacks <{called}>.")
    return part


def _value(part: ET.Element, key: str, where: str, default: str | None = None) -> float:
    text = part.get(key, default)
    if text is None:
        raise FastGSError(f"{where} lacks {key} in <{part.tag}>.")
    return poses.read(text, f"{where}: its {key}")


def _pose(camera: ET.Element, where: str) -> np.ndarray:
    part = _part(camera, "transform", where)
    turn = [[_value(part, f"r{i}{j}", where) for j in (1, 2, 3)] for i in (1, 2, 3)]
    pose = poses.OPENGL @ poses.rigid(rotations.transform(turn), f"{where}: its transform")
    pose[:3, 3] = -pose[:3, :3] @ [_value(part, axis, where) * MILLIMETRES for axis in "xyz"]
    return pose


def _lens(camera: ET.Element, where: str) -> Lens:
    part = _part(camera, "intrinsic", where)
    radial = [_value(part, f"radialDistortion{i}", where, "0") for i in (1, 2, 3)]
    p1, p2 = (_value(part, f"tangentalDistortion{i}", where, "0") for i in (1, 2))
    return Lens("opencv", tuple(radial), (p1, p2), _value(part, "skew", where, "0") / _focal(part, "focalLengthU", where))


def _focal(part: ET.Element, key: str, where: str) -> float:
    return poses.number(_value(part, key, where), f"{where}: its {key}", 1e-9, 1e12)


def _intrinsics(camera: ET.Element, place: Path, where: str) -> Intrinsics:
    """Intrinsics in pixels of the camera's pictures, which may be binned."""
    part, fov = _part(camera, "intrinsic", where), _part(camera, "fov_video", where)
    left, top, right, bottom = (poses.number(_value(fov, side, where), f"{where}: its {side}", -1e9, 1e9)
                                for side in ("left", "top", "right", "bottom"))
    width, height = right - left + 1, bottom - top + 1
    try:
        size: tuple[float, float] = picture_size(first_source(place))
    except FastGSError:  # said with all other faults
        size = width, height
    w, h = size
    if width < 2 or height < 2 or abs(w / width - h / height) > 0.01 * w / width:
        raise FastGSError(f"{place}: it has {w} x {h} pixels, but camera {camera.get('serial')} was calibrated for {width:g} x {height:g}; "
                          "give pictures of the whole calibrated part of the sensor, turned as the sensor is.")
    full = _part(camera, "fov_video_max", where) if camera.find("fov_video_max") is not None else fov
    sensor = (_value(part, "sensorMaxU", where) - _value(part, "sensorMinU", where, "0")) / SUBPIXELS
    whole = _value(full, "right", where) - _value(full, "left", where) + 1
    if not 1 <= whole <= 1e9 or not abs(sensor) <= 1e9:
        raise FastGSError(f"{where}: the largest part that it can film must be at least one pixel wide, not {whole:g}.")
    binning = max(1, round(sensor / whole))
    unit = SUBPIXELS * binning
    sx, sy = (1.0 if abs(shown - calibrated) <= 1 else shown / calibrated for shown, calibrated in ((w, width), (h, height)))
    return poses.intrinsics(
        where, _focal(part, "focalLengthU", where) / unit * sx, _focal(part, "focalLengthV", where) / unit * sy,
        (_value(part, "centerPointU", where) / unit - left) * sx, (_value(part, "centerPointV", where) / unit - top) * sy, w, h)
