# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrations of other programs beside films: TOML of aniposelib, Pose2Sim, FreeMoCap and caliscope, OpenCV's YAML and XML."""
from __future__ import annotations

import numpy as np
import pytest
import tiny_captures
from spots import SpotRig

from fastgs_blender.cameras.file_storage import read_storage
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import identify, open_capture
from fastgs_blender.captures.beside import matched
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util import rotations
from fastgs_blender.util.errors import FastGSError

NAMES = ["cam01", "cam02", "cam03"]
GIVEN = Intrinsics(300.25, 299.5, 163, 118.5, 320, 240)
LENS = Lens("opencv", (-0.15, 0.08, 0.01), (0.002, -0.001))
RIG = SpotRig(GIVEN, LENS, cameras=3)


def values(i: int, scale: float = 1.0) -> dict:
    """What a calibration by OpenCV says of the rig's i-th camera; lengths times scale."""
    return {"matrix": np.array([[GIVEN.fx, 0, GIVEN.cx - 0.5], [0, GIVEN.fy, GIVEN.cy - 0.5], [0, 0, 1]]),
            "distortion": np.array([*LENS.k[:2], *LENS.p, LENS.k[2]]), "rotation": RIG.poses[i][:3, :3],
            "rodrigues": 2 * rotations.log(rotations.from_matrices(RIG.poses[i][:3, :3])), "translation": scale * RIG.poses[i][:3, 3]}


def toml(i: int, name: str, scale: float = 1.0, head: str | None = None, turn: str = "rodrigues") -> str:
    found = values(i, scale)
    return (f'[{head or f"cam_{i}"}]\n{name}\nsize = [{GIVEN.width}, {GIVEN.height}]\nmatrix = {found["matrix"].tolist()}\n'
            f'distortions = {found["distortion"].tolist()}\nrotation = {found[turn].tolist()}\n'
            f'translation = {found["translation"].tolist()}\n')


def films(folder, names=NAMES):
    for i, name in enumerate(names):
        RIG.write_video(folder / f"{name}.mp4", i, fps=50)


@pytest.mark.slow
def test_aniposelib_and_freemocap(tmp_path, tmp_path_factory):
    """The spots are where the cameras say; a calibration in millimetres becomes metres."""
    films(tmp_path)
    text = "".join(toml(i, f'name = "{name}"') for i, name in enumerate(NAMES))
    (tmp_path / "calibration.toml").write_text(text + "[metadata]\nadjusted = false\nerror = 0.4\n")
    capture = open_capture(tmp_path)
    assert capture.layout == "calibration in TOML" and capture.clip.fps == 50 and not capture.notes and not capture.held_out_views
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    for said in ("", '[metadata]\nunits = "mm"\n'):
        (tmp_path / "calibration.toml").write_text(
            "".join(toml(i, f'name = "{name}"', 1000) for i, name in enumerate(NAMES)) + said)
        capture = open_capture(tmp_path / "calibration.toml")
        RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
        assert "metres" in capture.notes[0]


def test_pose2sim(tmp_path, tmp_path_factory):
    """The calibration in a folder of its own, films in another, names with decorations."""
    for folder in ("calibration", "videos"):
        (tmp_path / folder).mkdir()
    films(tmp_path / "videos", [f"walk_{name}" for name in NAMES])
    (tmp_path / "Config.toml").write_text('[calibration]\ncalibration_type = "calculate"\n')
    text = "".join(toml(i, f'name = "int_{name}_img"', head=f"int_{name}_img") for i, name in enumerate(NAMES))
    (tmp_path / "calibration" / "Calib.toml").write_text(text)
    for path in (tmp_path, tmp_path / "calibration" / "Calib.toml"):
        RIG.check(open_capture(path), tmp_path_factory.mktemp("cache"), [f"int_{name}_img" for name in NAMES])


def test_a_folder_for_each_camera_with_its_film_in_it(tmp_path, tmp_path_factory):
    """anipose's back/minimal_back.mp4, a GoPro's cam01/GX010010.MP4; parts of one film are to be joined."""
    (tmp_path / "calibration.toml").write_text("".join(toml(i, f'name = "{name}"') for i, name in enumerate(NAMES)))
    for name in NAMES:
        (tmp_path / name).mkdir()
    films(tmp_path, [f"{name}/minimal_{name}" for name in NAMES])
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)
    for i, name in enumerate(NAMES):
        (tmp_path / name / f"minimal_{name}.mp4").rename(tmp_path / name / f"GX01001{i}.MP4")
    RIG.write_picture(tmp_path / "cam01" / "GX010010.jpg", 0, 0)  # its thumbnail
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)
    (tmp_path / "calibration.toml").rename(tmp_path / "calibration.txt")
    capture = open_capture(tmp_path)
    assert capture.layout == "folders without poses" and capture.views == NAMES and not capture.posed and not problems(capture)
    assert capture.clip.frame_count == RIG.frames and capture.clip.fps == 50
    (tmp_path / "cam02" / "take.mp4").write_bytes((tmp_path / "cam02" / "GX010011.MP4").read_bytes())
    with pytest.raises(FastGSError, match=r"cam02: it holds 2 videos, GX010011\.MP4 and take\.mp4"):
        open_capture(tmp_path)


@pytest.mark.parametrize("beside", [True, False])
def test_chapters_of_one_film_are_joined(tmp_path, beside):
    """A GoPro begins a new file every few minutes.  Copied cards have their films in DCIM/100GOPRO."""
    names = ["GX{}0010", "GOPR0011", "GX{}0012"]
    folders = [tmp_path] * 3 if beside else [tmp_path / name / "DCIM" / "100GOPRO" for name in NAMES]
    for folder, name in zip(folders, names):
        folder.mkdir(parents=True, exist_ok=True)
        films(folder, [name.format("01")])
        for chapter in (("01", "02") if "GOPR" in name else ("02", "03")):
            later = folder / f"{name.replace('GOPR', 'GP{}').format(chapter)}.MP4"
            later.write_bytes((folder / f"{name.format('01')}.mp4").read_bytes())
    capture = open_capture(tmp_path)
    assert capture.views == (sorted(name.format("01") for name in names) if beside else NAMES) and not problems(capture)
    assert capture.clip.frame_count == 3 * RIG.frames and capture.clip.fps == 50
    view = [shot.image for shot in capture.shots if shot.view == ("GOPR0011" if beside else "cam02")]
    assert [(image.path.stem, image.frame) for image in view] == [
        (name, frame) for name in ("GOPR0011", "GP010011", "GP020011") for frame in range(RIG.frames)]
    (folders[0] / "GX020010.MP4").unlink()
    assert any("GX030010.MP4: the chapter 2" in text for text in problems(open_capture(tmp_path)))


@pytest.mark.parametrize("make", [tiny_captures.aniposelib, tiny_captures.opencv_files, tiny_captures.immersive, tiny_captures.qualisys])
def test_one_camera_of_a_rig_is_refused(make, tmp_path):
    """Of two cameras that are listed, one film is there: nothing is trained on it alone."""
    make(tmp_path)
    lost = next(p for p in (tmp_path / "cam01", tmp_path / "camera_0002.mp4", tmp_path / "film 1001") if p.exists())
    lost.rename(tmp_path / ".gone")
    found = problems(open_capture(tmp_path))
    assert len(found) == 1 and "only" in found[0] and "of its 2 cameras" in found[0]


def test_films_that_are_called_otherwise_are_taken_in_order(tmp_path):
    films(tmp_path, ["GX10", "GX9", "GX100"])
    (tmp_path / "calibration.toml").write_text("".join(toml(i, f'name = "{name}"') for i, name in enumerate("ABC")))
    capture = open_capture(tmp_path)
    assert {shot.view: shot.image.path.name for shot in capture.at_frame(0)} == {"A": "GX9.mp4", "B": "GX10.mp4", "C": "GX100.mp4"}
    assert "GX9.mp4 is A" in capture.notes[0]


def test_caliscope_frames_have_their_own_times(tmp_path, tmp_path_factory):
    """Cameras that are not genlocked: each frame keeps the moment at which it was taken, also of a part of the clip."""
    films(tmp_path, [f"cam_{i}" for i in range(3)])
    text = "".join(toml(i, f"cam_id = {i}\nignore = {str(i == 2).lower()}", head=f"cameras.{i}", turn="rotation") for i in range(3))
    (tmp_path / "camera_array.toml").write_text(text)
    late = {0: 0.0, 1: 0.004, 2: 0.0}
    rows = [f"{35 + frame},{i},{7 + frame / 25 + late[i]}" for frame in reversed(range(RIG.frames)) for i in range(3)]
    (tmp_path / "timestamps.csv").write_text("\n".join(["sync_index,cam_id,frame_time", *rows]))
    capture = open_capture(tmp_path)
    assert capture.views == ["cam_0", "cam_1"] and capture.clip.frame_count == RIG.frames and abs(capture.clip.fps - 25) < 1e-6
    for shot in capture.shots:
        assert abs(shot.t - (shot.frame + 25 * late[int(shot.view[-1])]) / RIG.frames) < 1e-6 and shot.image.frame == shot.frame
    assert not problems(capture)
    (tmp_path / "timestamps.csv").write_text("\n".join(["port,frame_time", *(row.partition(",")[2] for row in rows)]))
    assert [(shot.view, shot.frame, round(shot.t, 6)) for shot in open_capture(tmp_path).shots] == [
        (shot.view, shot.frame, round(shot.t, 6)) for shot in capture.shots]


@pytest.mark.parametrize("make", tiny_captures.LAYOUTS["opencv"])
def test_opencv_storage(make, tmp_path):
    make(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.layout == "calibration by OpenCV" and not problems(capture) and capture.clip.frame_count == tiny_captures.FRAMES
    base = np.eye(4) if make is not tiny_captures.opencv_pair else np.linalg.inv(tiny_captures.pose(0))
    for i, shot in enumerate(capture.at_frame(0)):
        assert np.abs(shot.camera.world_to_camera - tiny_captures.pose(i) @ base).max() < 1e-9
        assert shot.image.intrinsics == Intrinsics(30, 30, 16, 12, 32, 24) and shot.image.lens == Lens("opencv", (0.05, -0.01), (0.001, 0))


def test_opencv_spots(tmp_path, tmp_path_factory):
    films(tmp_path)
    for i, name in enumerate(NAMES):
        found = values(i)
        keys = {"camera_matrix": "matrix", "dist_coeffs": "distortion", "R": "rotation", "T": "translation"}
        text = "".join(f"{key}:{tiny_captures.storage_matrix(found[own])}" for key, own in keys.items())
        (tmp_path / f"{name}.yaml").write_text(f"%YAML:1.0\n---\n{text}")
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)


def test_calibrations_without_poses_or_cameras_are_left_to_others(tmp_path):
    """A board's calibration has no pose in the room; a TOML of settings no camera: both folders are films without poses."""
    for i, name in enumerate(NAMES):
        RIG.write_picture(tmp_path / name / "0001.png", i, 0)
    (tmp_path / "camera.yml").write_text(f"%YAML:1.0\n---\ncamera_matrix:{tiny_captures.storage_matrix(np.eye(3))}")
    (tmp_path / "pyproject.toml").write_text('[tool]\nmatrix = "rotation and translation"\n')
    assert identify(tmp_path).name == "folders without poses"


@pytest.mark.parametrize(("name", "film", "fits"), [
    ("cam_01", "Cam1", True), ("int_cam01_img", "cam01", True), ("cam1", "cam10", False), ("2", "take3_cam2", True),
    ("cam2", "take2_cam1", False),
    ("Camera_000_synchronized", "Camera_000_synchronized", True), ("A", "B", False)])
def test_names(name, film, fits, tmp_path):
    place = tmp_path / f"{film}.mp4"
    place.write_bytes(b"-")
    assert bool(matched([name], [place])) == fits


@pytest.mark.parametrize(("change", "sentence"), [
    (("matrix = [[300.25", "matrix = [[-1.0"), "focal length"),
    (("rotation = [", "rotation = [9.0, "), "rotation.*3 finite"),
    (("translation = [", "translation = ['x', "), "translation.*finite"),
    (("translation", "place"), "lacks translation"),
    (("size = [320", "size = [240"), "calibrated for 240 x 240"),
    (('name = "cam02"', 'name = "cam01"'), "cam01.*twice"),
    (('name = "cam02"', "name = 3.5"), "name.*number"),
    (("distortions = [", "distortions = [0, 0, 0, 0, 0, 0, 0, 0, 0.1, "), "has 14 coefficients, and 8 are known"),
    (("[cam_1]", "[cam_1"), "TOML"),
    (("[metadata]", '[metadata]\nunits = "inches"'), "m, cm or mm.*'inches'"),
])
def test_damaged_toml_is_one_sentence(tmp_path, change, sentence):
    films(tmp_path)
    text = "".join(toml(i, f'name = "{name}"') for i, name in enumerate(NAMES)) + "[metadata]\nerror = 1\n"
    assert change[0] in text
    (tmp_path / "calibration.toml").write_text(text.replace(*change, 1))
    with pytest.raises(FastGSError, match=sentence) as error:
        open_capture(tmp_path)
    assert str(tmp_path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("text", "sentence"), [
    ("a: [1, 2", "never closed"), ("a: 1\n- 2", "mixes"), ("a: {b 1}", "no colon"),
    ("a:\n  rows: 2\n  cols: 2\n  data: [1, 2, 3]", "2 x 2 .*3"),
    ("a: [1 2, ]]", "bracket"), ("just text", "name.*colon"), ("a: 1\n   b: 2", "belong"),
    ("a: " + "[" * 99 + "]" * 99, "nested")])
def test_damaged_storage_is_one_sentence(tmp_path, text, sentence):
    (tmp_path / "a.yml").write_text(f"%YAML:1.0\n---\n{text}\n")
    with pytest.raises(FastGSError, match=sentence):
        read_storage(tmp_path / "a.yml")


def test_storage_values(tmp_path):
    (tmp_path / "a.yml").write_text(
        '%YAML:1.0\n---\ncount: 3\nsize: [ 4, 5 ]\n"quoted name": "a: # b"\nlist:\n   - 1\n   - { x:.5, y: -1e-3, z:.Inf }\n'
        "inner:\n   text: plain words # remark\n   flows: [[1,\n       2], [3, 4]]\nentries:\n   -\n      k: 1\n   - k: 2\n     l: 3\n")
    found = read_storage(tmp_path / "a.yml")
    assert found == {"count": 3, "size": [4, 5], "quoted name": "a: # b", "list": [1, {"x": 0.5, "y": -1e-3, "z": np.inf}],
                     "inner": {"text": "plain words", "flows": [[1, 2], [3, 4]]}, "entries": [{"k": 1}, {"k": 2, "l": 3}]}


def test_real_room_that_is_not_genlocked(shared_data):
    """Four webcams around a table: they look at one place, and their frames keep their own times."""
    capture = open_capture(shared_data / "board")
    assert capture.views == [f"cam_{i}" for i in range(4)] and capture.clip.frame_count == 57 and abs(capture.clip.fps - 6) < 0.01
    assert capture.axes == "RFU" and not problems(capture) and len({shot.t for shot in capture.at_frame(0)}) == 4
    for shot in capture.at_frame(0):
        there = (shot.camera.world_to_camera @ [*capture.focus, 1])[:3]
        at = shot.camera.pixels(there)
        assert there[2] > 0.3 and (at > 0.2 * np.array([1280, 720])).all() and (at < 0.8 * np.array([1280, 720])).all()
