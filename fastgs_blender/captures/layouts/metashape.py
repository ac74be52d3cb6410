# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of Agisoft Metashape (File > Export > Export Cameras, Agisoft XML), with a film or a picture for each camera beside them.

    <document><chunk>
      <sensors><sensor id="0" type="frame"><resolution width="" height=""/>
        <calibration type="frame" class="adjusted"><f/> <cx/> <cy/> <b1/> <b2/> <k1/> ... <k4/> <p1/> <p2/></calibration></sensor></sensors>
      <components><component id="0"><transform><rotation/> <translation/> <scale/></transform></component></components>
      <cameras><camera id="0" sensor_id="0" component_id="0" label="cam01"><transform>16 numbers</transform></camera></cameras>

A camera's transform is camera-to-world with OpenCV's camera axes.  Metashape's manual has the equations of its camera models: p1 and p2 are
OpenCV's p2 and p1, cx and cy count from the middle of the picture, b1 is added to the horizontal focal length, b2 is a skew, and its
fisheye is OpenCV's.  A component's transform goes to metres; where it is geocentric, up is where the Earth's centre is not.
"""
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ...cameras import opencv, poses
from ...cameras.lens import Lens
from ...util import rotations
from ...util.errors import FastGSError
from ...util.xml_files import plain_xml
from .. import beside
from ..capture import Capture, Options
from ..sources import PICTURES, VIDEOS, beginning, files_at, only

name = "Metashape"
LARGEST_FILE = 64 << 20
MOST_CAMERAS = 10_000
GEOCENTRIC = 1e6
"""Metres from the origin beyond which a translation is one from the Earth's centre."""


def recognises(path: Path) -> bool:
    """A folder with such an XML file, or that file."""
    return bool(files_at(path, _is_export, "*/*.xml"))


def load(path: Path, options: Options) -> Capture:
    """The capture of the aligned cameras that have a film, or else a picture."""
    file = only(path, files_at(path, _is_export, "*/*.xml"), "exports of Metashape's cameras")
    return beside.capture_of(path, name, file, read_cameras(file), options, unit=1.0, photographed=True)


def read_cameras(file: Path) -> list[opencv.Calibrated]:
    """The aligned cameras in a file, in metres where it says so; raises FastGSError."""
    chunk = plain_xml(file, LARGEST_FILE).find("chunk")
    listed = [] if chunk is None else [camera for camera in chunk.iter("camera") if camera.find("transform") is not None]
    if chunk is None or not 0 < len(listed) <= MOST_CAMERAS:
        raise FastGSError(f"{file}: it has {len(listed)} aligned cameras, and 1 to {MOST_CAMERAS} are read; align the pictures, then "
                          "export the cameras.")
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    worlds = {part.get("id"): _world(part, f"{file}: component {part.get('id')}") for part in chunk.iter("component")}
    found = []
    for camera in listed:
        label = camera.get("label", "")
        where = f"{file}: camera {label}"
        sensor = sensors.get(camera.get("sensor_id"))
        if sensor is None:
            raise FastGSError(f"{where} has no sensor; export the cameras again.")
        matrix, lens, size = _calibration(sensor, where)
        turn, scale, shift = worlds.get(camera.get("component_id"), (np.eye(3), 1.0, np.zeros(3)))
        to_world = poses.rigid(poses.numbers(_floats(camera.findtext("transform"), where), (16,), f"{where}: its transform").reshape(4, 4),
                               f"{where}: its transform")
        pose = rotations.transform((turn @ to_world[:3, :3]).T)
        pose[:3, 3] = -pose[:3, :3] @ (scale * turn @ to_world[:3, 3] + shift)
        called = Path(label).stem if Path(label).suffix.lower() in (*PICTURES, *VIDEOS) else label
        found.append(opencv.Calibrated(called, matrix, lens, poses.rigid(pose, f"{where}: its place"), size))
    return found


def _world(component: ET.Element, where: str) -> tuple[np.ndarray, float, np.ndarray]:
    """Rotation, scale and translation from a component to metres, z up; a geocentric place becomes the origin."""
    values = [_floats(component.findtext(f"transform/{part}"), where) for part in ("rotation", "scale", "translation")]
    turn = poses.numbers(values[0] or np.eye(3).ravel(), (9,), f"{where}: its rotation").reshape(3, 3)
    scale = poses.number((values[1] or [1.0])[0], f"{where}: its scale", 1e-9, 1e9)
    shift = poses.numbers(values[2] or np.zeros(3), (3,), f"{where}: its translation")
    if np.linalg.norm(shift) < GEOCENTRIC:
        return turn, scale, shift
    up = shift / np.linalg.norm(shift)
    east = np.cross([0, 0, 1], up)
    east = east / np.linalg.norm(east) if np.linalg.norm(east) > 1e-9 else np.array([1.0, 0, 0])
    return np.stack([east, np.cross(up, east), up]) @ turn, scale, np.zeros(3)


def _calibration(sensor: ET.Element, where: str) -> tuple[np.ndarray, Lens, tuple[int, int]]:
    kind = sensor.get("type", "frame")
    given = sensor.findall("calibration")
    calibration = next((each for each in given if each.get("class") == "adjusted"), given[0] if given else None)
    resolution = sensor.find("resolution")
    if kind not in ("frame", "fisheye") or calibration is None or resolution is None:
        raise FastGSError(f"{where}: its sensor must be a calibrated frame or fisheye, not {kind}; undistort the pictures, then export "
                          "again.")
    value = {key: poses.number((_floats(calibration.findtext(key), where) or [0.0])[0], f"{where}: its {key}")
             for key in ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")}
    width, height = (poses.integer((_floats(resolution.get(side), where) or [0.0])[0], f"{where}: its {side}", 1, 1 << 20)
                     for side in ("width", "height"))
    if not value["f"] > 0:
        raise FastGSError(f"{where}: its sensor has no focal length f; export the cameras again.")
    if value["p3"] or value["p4"] or (kind == "fisheye" and (value["p1"] or value["p2"])):
        raise FastGSError(f"{where}: its lens has coefficients that are not known here (p3, p4, or p1 and p2 of a fisheye); optimise the "
                          "cameras without them, or undistort the pictures.")
    fx, reach = value["f"] + value["b1"], np.hypot(width, height) / 2 / value["f"]
    matrix = np.array([[fx, value["b2"], width / 2 + value["cx"] - 0.5], [0, value["f"], height / 2 + value["cy"] - 0.5], [0, 0, 1]])
    radial = tuple(value[f"k{i}"] for i in range(1, 5))
    lens = (opencv.Lens("fisheye", radial, skew=value["b2"] / fx) if kind == "fisheye" else
            opencv.brown(radial, (value["p2"], value["p1"]), value["b2"] / fx, reach, where))
    return matrix, lens, (width, height)


def _floats(text: str | None, where: str) -> list[float]:
    return [poses.read(word, f"{where}: a number of it") for word in (text or "").split()]


def _is_export(file: Path) -> bool:
    head = beginning(file, (".xml",))
    return b"<document" in head and b"<chunk" in head and b"<sensor" in head
