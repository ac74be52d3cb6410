# SPDX-License-Identifier: GPL-3.0-or-later
"""Technicolor: pictures named by scene, frame and camera, poses as COLMAP has them."""
from __future__ import annotations

import numpy as np
import pytest
from spots import SpotRig

from fastgs_blender.cameras.lens import Intrinsics
from fastgs_blender.captures import Options
from fastgs_blender.captures.layouts import technicolor
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util.errors import FastGSError

HEADER = "f cx cy ar sk qw qx qy qz tx ty tz"
NAMES = ["00", "01", "02", "10"]
RIG = SpotRig(Intrinsics(300, 300, 163, 118.5, 320, 240))


def quaternion(rotation):
    """w x y z of a rotation whose angle is under 90 degrees."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    x, y, z = rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    return np.array([w, x / (4 * w), y / (4 * w), z / (4 * w)])


def write_cameras(folder, **changes):
    """cameras_parameters.txt of 16 cameras; changes: text put in place of a camera's row, by c and its number."""
    poses = {int(name): pose for name, pose in zip(NAMES, RIG.poses)}
    lines = [HEADER]
    for i in range(16):
        pose = poses.get(i, np.eye(4))
        values = [RIG.given.fx, RIG.given.cx, RIG.given.cy, 1, 0, *quaternion(pose[:3, :3]), *pose[:3, 3]]
        lines.append(changes.get(f"c{i}", " ".join(f"{v:.12g}" for v in values) + " "))
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n", "utf-8")


@pytest.fixture
def scene(tmp_path):
    for i, name in enumerate(NAMES):
        for frame in range(RIG.frames):
            RIG.write_picture(tmp_path / f"Fabien_undist_{frame + 51:05d}_{name}.png", i, frame)
    write_cameras(tmp_path)
    return tmp_path


def load(path, **options):
    return technicolor.load(path, Options(**options))


def test_pictures(scene, tmp_path_factory):
    assert technicolor.recognises(scene)
    capture = load(scene)
    assert capture.held_out_views == ["10"] and capture.clip.start_frame == 51 and capture.clip.frame_count == 3 and capture.scale == 1
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_skew_is_undone_with_the_lens(scene):
    write_cameras(scene, c0=" ".join(map(str, [300, 163, 118.5, 1, 6, *quaternion(RIG.poses[0][:3, :3]), *RIG.poses[0][:3, 3]])))
    assert load(scene).shots[0].image.lens.skew == pytest.approx(0.02)


def test_missing_picture_is_told(scene):
    (scene / "Fabien_undist_00052_01.png").unlink()
    capture = load(scene)
    assert not problems(capture) and "01 lacks the frame 52" in capture.notes[-1]


def test_corrupt_picture_of_birthday_is_left_out(tmp_path):
    rig = SpotRig(Intrinsics(30, 30, 16, 12, 32, 24))
    for frame in (172, 173, 174):
        for name in ("08", "09"):
            rig.write_picture(tmp_path / f"Birthday_undist_{frame:05d}_{name}.png", 0, 0)
    write_cameras(tmp_path)
    capture = load(tmp_path)
    assert len(capture) == 5 and not problems(capture) and "frame 173 of camera 09" in capture.notes[0]


@pytest.mark.parametrize(("row", "sentence"), [
    ("300 163 118.5 1 0 1 0 0 0 0 0", "line 2 must be 12 finite numbers"),
    ("300 163 118.5 1 0 0.1 0.2 1 0 0 0 0 0 0", "distorted pictures"),
    ("300 163 x 1 0 1 0 0 0 0 0 0", "line 2 .*'x'"),
    ("300 163 118.5 1 0 0 0 0 0 0 0 0", "quaternion.* 0"),
    ("300 163 118.5 1.5 0 1 0 0 0 0 0 0", "aspect of 1.5"),
    ("-300 163 118.5 1 0 1 0 0 0 0 0 0", "above 0"),
    ("nan 163 118.5 1 0 1 0 0 0 0 0 0", "line 2 .*finite"),
])
def test_damaged_cameras_are_one_sentence(scene, row, sentence):
    write_cameras(scene, c0=row)
    with pytest.raises(FastGSError, match=sentence) as error:
        load(scene)
    assert "cameras_parameters.txt" in str(error.value)


def test_other_damage(scene):
    file = scene / "cameras_parameters.txt"
    file.write_text(file.read_text("utf-8").split("\n", 5)[0], "utf-8")
    with pytest.raises(FastGSError, match="no cameras"):
        load(scene)
    write_cameras(scene)
    file.write_text("\n".join(file.read_text("utf-8").splitlines()[:9]), "utf-8")
    with pytest.raises(FastGSError, match="8 cameras.*camera 10"):
        load(scene)
    RIG.write_picture(scene / "Train_undist_00051_00.png", 0, 0)
    with pytest.raises(FastGSError, match="several scenes"):
        load(scene)
