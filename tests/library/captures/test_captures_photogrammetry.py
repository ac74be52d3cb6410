# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of Metashape and RealityScan beside films and photographs: spots are where the cameras put them."""
from __future__ import annotations

import numpy as np
import pytest
import tiny_captures
from spots import SpotRig

from fastgs_blender.cameras import opencv
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util.errors import FastGSError

NAMES = ["cam01", "cam02", "cam03"]
LENS = Lens("opencv", (-0.15, 0.08, 0.01), (0.002, -0.001))
SKEWED = Lens("opencv", LENS.k[:3], LENS.p, 0.01)
RIG = SpotRig(Intrinsics(301.25, 299.5, 163, 118.5, 320, 240), SKEWED, cameras=3)
SQUARE = SpotRig(Intrinsics(300, 300, 163, 118.5, 320, 240), LENS, cameras=3)
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""From a world with z up to the rig's, whose y points down."""
WORLD = np.linalg.inv(UPRIGHT)
SAME, ORIGIN = np.eye(3), np.zeros(3)


def numbers(values) -> str:
    return " ".join(map(repr, np.ravel(values).tolist()))


def films(folder, rig):
    for i, name in enumerate(NAMES):
        rig.write_video(folder / f"{name}.mp4", i, fps=50)


def metashape(folder, scale=1.0, turn=SAME, shift=ORIGIN, label="{name}", names=NAMES):
    """Agisoft XML of RIG, in units of 1 / scale m in another frame: world = scale * turn * component + shift."""
    cameras = ""
    for i, name in enumerate(names):
        place = np.linalg.inv(RIG.poses[i % 3] @ UPRIGHT)
        place[:3, :3] = turn.T @ place[:3, :3]
        place[:3, 3] = turn.T @ (place[:3, 3] - shift) / scale
        cameras += (f'<camera id="{i}" sensor_id="4" component_id="7" label="{label.format(name=name)}"><transform>{numbers(place)}'
                    '</transform></camera>')
    given, k = RIG.given, LENS.k
    (folder / "cameras.xml").write_text(
        f'<document version="2.0.0"><chunk label="Chunk 1"><sensors next_id="5"><sensor id="4" label="unknown" type="frame"><resolution '
        f'width="320" height="240"/><calibration type="frame" class="initial"><f>1</f></calibration><calibration type="frame" '
        f'class="adjusted"><f>{given.fy}</f><cx>{given.cx - 160}</cx><cy>{given.cy - 120}</cy><b1>{given.fx - given.fy}</b1>'
        f'<b2>{0.01 * given.fx}</b2><k1>{k[0]}</k1><k2>{k[1]}</k2><k3>{k[2]}</k3><p1>{LENS.p[1]}</p1><p2>{LENS.p[0]}</p2></calibration>'
        f'</sensor></sensors><components><component id="7"><transform><rotation>{numbers(turn)}</rotation><translation>{numbers(shift)}'
        f'</translation><scale>{scale}</scale></transform></component></components><cameras>{cameras}<camera id="99" sensor_id="4" '
        'label="not aligned"/></cameras></chunk></document>')


@pytest.mark.parametrize("label", ["{name}.jpg", "{name}_frame0001", "{name}_0001.png"])
def test_metashape_beside_films(tmp_path, tmp_path_factory, label):
    films(tmp_path, RIG)
    about = np.radians(30) / 2 * np.array([0.0, 0, 1])
    turn = opencv.from_rodrigues(2 * about, "")
    metashape(tmp_path, 0.4, turn, np.array([10.0, 20, 3]), label, [*NAMES, "IMG-7", "IMG-8"])
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.axes, capture.clip.fps) == ("Metashape", "RFU", 50)
    assert "IMG-7" in capture.notes[0] and "IMG-8" in capture.notes[0]
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES, WORLD)


def test_metashape_without_the_size_of_its_pictures(tmp_path):
    films(tmp_path, RIG)
    metashape(tmp_path)
    file = tmp_path / "cameras.xml"
    file.write_text(file.read_text().replace('width="320"', 'width=""'))
    with pytest.raises(FastGSError, match=r"cameras\.xml.*its width"):
        open_capture(tmp_path)


def test_metashape_on_the_globe(tmp_path):
    """With GPS in the photographs, places count from the Earth's centre: here on the equator, where x points up."""
    films(tmp_path, RIG)
    globe = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # columns: east, north and up at longitude 0
    place = np.array([6.4e6, 0, 0])
    metashape(tmp_path)
    text = (tmp_path / "cameras.xml").read_text()
    text = text.replace(f"<rotation>{numbers(np.eye(3))}", f"<rotation>{numbers(globe)}")
    (tmp_path / "cameras.xml").write_text(text.replace(f"<translation>{numbers(np.zeros(3))}", f"<translation>{numbers(place)}"))
    capture = open_capture(tmp_path)
    assert capture.axes == "RFU"
    for shot in capture.at_frame(0):
        np.testing.assert_allclose(shot.camera.world_to_camera @ WORLD, RIG.poses[NAMES.index(shot.view)], atol=1e-6)


def test_photographs_alone_are_a_moment(tmp_path, tmp_path_factory):
    rig = SpotRig(RIG.given, SKEWED, cameras=3, frames=1)
    for i, name in enumerate(NAMES):
        rig.write_picture(tmp_path / "images" / f"{name}.png", i, 0)
    metashape(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.clip.frame_count == 1 and "one moment" in capture.notes[0]
    rig.check(capture, tmp_path_factory.mktemp("cache"), NAMES, WORLD)


def test_photographs_in_a_folder_that_is_called_like_them_are_a_moment(tmp_path):
    """The folder is no film of theirs, though it holds numbered pictures."""
    rig = SpotRig(RIG.given, SKEWED, cameras=3, frames=1)
    for i in range(3):
        rig.write_picture(tmp_path / "walk" / f"walk_000{i}.png", i, 0)
    metashape(tmp_path, label="{name}.png", names=[f"walk_000{i}" for i in range(3)])
    capture = open_capture(tmp_path)
    assert len(capture.views) == 3 and capture.clip.frame_count == 1 and not problems(capture)


def table(folder, rig):
    """RealityScan's table: the camera looks down and is turned by roll about y, pitch about x, and against the heading about z."""
    rows = []
    for i, name in enumerate(NAMES):
        place = np.linalg.inv(rig.poses[i] @ UPRIGHT) @ np.diag([1.0, -1, -1, 1])  # OpenGL's camera axes
        pitch, roll = np.arcsin(place[2, 1]), np.arctan2(-place[2, 0], place[2, 2])
        heading = np.arctan2(place[0, 1], place[1, 1])
        angles = ",".join(map(repr, np.degrees([heading, pitch, roll]).tolist()))
        rows.append(f"{name}.jpg,{','.join(map(repr, place[:3, 3].tolist()))},{angles},{300 / 320 * 36},{3 / 320},{-1.5 / 320},"
                    f"{','.join(map(str, LENS.k[:3]))},0,{LENS.p[1]},{LENS.p[0]}")
    (folder / "cameras.csv").write_text("\n".join(["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2", *rows]))


def test_a_table_of_realityscan(tmp_path, tmp_path_factory):
    films(tmp_path, SQUARE)
    table(tmp_path, SQUARE)
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.axes) == ("RealityScan", "RFU") and not problems(capture)
    SQUARE.check(capture, tmp_path_factory.mktemp("cache"), NAMES, WORLD)
    text = (tmp_path / "cameras.csv").read_text()  # as spreadsheets save it where numbers have commas
    (tmp_path / "cameras.csv").write_text(text.replace(",", ";").replace(".", ",").replace(",jpg", ".jpg"))
    SQUARE.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES, WORLD)
    (tmp_path / "cameras.csv").write_text("#name,x,y,alt,heading,pitch,roll,f\n" + "".join(f"{name},0,0,0,90,90,0,30\n" for name in NAMES))
    turn = open_capture(tmp_path).shots[0].camera.world_to_camera[:3, :3]
    np.testing.assert_allclose(turn, [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-9)  # level, looking east: south is at its right


def test_films_beside_photographs_of_a_walk(tmp_path, tmp_path_factory):
    """Pictures taken from films lie among photographs with the same numbers; the table has whole paths, as RealityCapture may write."""
    films(tmp_path / "films", SQUARE)
    for name in (*NAMES, "IMG_0001", "IMG_0002"):
        SQUARE.write_picture(tmp_path / "images" / f"{name}.jpg", 0, 0)
    table(tmp_path, SQUARE)
    file = tmp_path / "cameras.csv"
    file.write_text(file.read_text().replace("cam0", "C:\\place\\cam0"))
    SQUARE.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES, WORLD)


def test_metadata_of_realityscan(tmp_path, tmp_path_factory):
    films(tmp_path, SQUARE)
    for i, name in enumerate(NAMES):
        pose = SQUARE.poses[i] @ UPRIGHT
        (tmp_path / f"{name}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
            'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:Version="3" xcr:DistortionModel="brown3t2" '
            f'xcr:FocalLength35mm="{300 / 320 * 36}" xcr:Skew="0" xcr:AspectRatio="1" xcr:PrincipalPointU="{3 / 320}" '
            f'xcr:PrincipalPointV="{-1.5 / 320}" xcr:Rotation="{numbers(pose[:3, :3])}"><xcr:Position>'
            f'{numbers(np.linalg.inv(pose)[:3, 3])}</xcr:Position><xcr:DistortionCoeficients>{numbers(LENS.k[:3])} 0 {LENS.p[1]} '
            f'{LENS.p[0]}</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>')
    for place in (tmp_path, tmp_path / "cam02.xmp"):
        SQUARE.check(open_capture(place), tmp_path_factory.mktemp("cache"), NAMES, WORLD)
    text = (tmp_path / "cam01.xmp").read_text()
    for old, new, words in (("brown3t2", "tilted", "DistortionModel tilted"), ('Skew="0"', 'Skew="1"', "Skew"),
                            ("FocalLength35mm", "FocalLength", "no FocalLength35mm"), (f'"{300 / 320 * 36}"', '"x"', "number.*'x'")):
        (tmp_path / "cam01.xmp").write_text(text.replace(old, new))
        with pytest.raises(FastGSError, match=words):
            open_capture(tmp_path)


def test_a_table_with_a_camera_beyond_reason(tmp_path):
    """Its square would be no number any more."""
    tiny_captures.scan_table(tmp_path)
    table = tmp_path / "cameras.csv"
    table.write_text(table.read_text().replace(",2,3,", ",2e200,3,", 1))
    with pytest.raises(FastGSError, match="farther than"):
        open_capture(tmp_path)


def test_lenses_of_other_models_are_fitted():
    """Brown's fourth coefficient, and the division model, of which the pinhole's radius is r / (1 + k r^2)."""
    r = np.linspace(0.01, 0.8, 50)
    found = opencv.brown((-0.2, 0.1, -0.03, 0.01), (0, 0), 0.0, 0.8, "a")
    expected = r * (1 - 0.2 * r**2 + 0.1 * r**4 - 0.03 * r**6 + 0.01 * r**8)
    np.testing.assert_allclose(found.distort(np.stack([r, 0 * r], 1))[:, 0], expected, atol=1e-5)
    distorted = np.linspace(0.01, 0.6, 50)
    pinhole = distorted / (1 - 0.25 * distorted**2)
    found = opencv.fitted(lambda r: np.interp(r, np.r_[0, pinhole], np.r_[0, distorted]), pinhole[-1], "a")
    np.testing.assert_allclose(found.distort(np.stack([pinhole, 0 * pinhole], 1))[:, 0], distorted, atol=2e-4)


@pytest.mark.parametrize("make", [tiny_captures.metashape, tiny_captures.scan_table, tiny_captures.scan_metadata])
def test_the_smallest_captures_open(make, tmp_path):
    make(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.views == list(tiny_captures.VIEWS) and capture.clip.frame_count == tiny_captures.FRAMES and not problems(capture)
