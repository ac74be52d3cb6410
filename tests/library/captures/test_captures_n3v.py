# SPDX-License-Identifier: GPL-3.0-or-later
"""Neural 3D Video: rows of poses_bounds.npy belong to videos by order, columns point down, right and backwards."""
from __future__ import annotations

import numpy as np
import pytest
from spots import SpotRig

from fastgs_blender.cameras.lens import Intrinsics
from fastgs_blender.captures import Options
from fastgs_blender.captures.layouts import n3v
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util.errors import FastGSError

NAMES = ["cam00", "cam02", "cam03", "cam13"]
RIG = SpotRig(Intrinsics(300, 300, 160, 120, 320, 240))


def rows(rig, height=240, width=320, focal=300):
    """poses_bounds.npy of the rig, as LLFF writes it."""
    found = []
    for pose in rig.poses:
        to_world = np.linalg.inv(pose)
        right, down, forward, centre = to_world[:3].T
        matrix = np.stack([down, right, -forward, centre, [height, width, focal]], 1)
        found.append(np.r_[matrix.ravel(), 0.5, 20])
    return np.array(found)


@pytest.fixture
def videos(tmp_path):
    """A scene as it is published."""
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / f"{name}.mp4", i)
    np.save(tmp_path / "poses_bounds.npy", rows(RIG))
    return tmp_path


@pytest.fixture
def pictures(tmp_path):
    """A scene whose frames have been extracted at half the size."""
    rig = SpotRig(Intrinsics(150, 150, 80, 60, 160, 120), sigma=2)
    for i, name in enumerate(NAMES):
        for frame in range(rig.frames):
            rig.write_picture(tmp_path / name / "images" / f"{frame:04d}.png", i, frame)
    np.save(tmp_path / "poses_bounds.npy", rows(rig))
    return tmp_path, rig


def load(path, **options):
    return n3v.load(path, Options(**options))


def test_videos(videos, tmp_path_factory):
    assert n3v.recognises(videos)
    capture = load(videos)
    assert capture.held_out_views == ["cam00"] and capture.clip.fps == 30 and capture.clip.frame_count == 3
    assert ["used at 50% of their size" in note for note in capture.notes] == [True] and not load(videos, scale=0.5).notes
    assert {(s.camera.width, s.camera.height, s.camera.fx) for s in capture.shots} == {(160, 120, 150)}  # halved
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    RIG.check(load(videos, scale=1.0), tmp_path_factory.mktemp("cache"), NAMES)


def test_extracted_frames_of_half_the_size_stay_as_they_are(pictures, tmp_path_factory):
    path, rig = pictures
    assert n3v.recognises(path)
    capture = load(path)
    assert capture.scale == 1
    rig.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_camera_that_is_not_synchronised_is_left_out(pictures):
    path, _ = pictures
    scene = path.rename(path.with_name("coffee_martini"))
    capture = load(scene)
    assert capture.views == NAMES[:3] and "cam13 is left out" in capture.notes[0]
    assert load(scene, held_out=("cam13",)).held_out_views == ["cam13"]


def test_missing_frame_is_told(pictures):
    path, _ = pictures
    (path / "cam02" / "images" / "0001.png").unlink()
    capture = load(path)
    assert not problems(capture) and any("cam02 lacks the frame 1" in text for text in capture.notes)


def test_deleted_camera_is_refused(pictures):
    path, _ = pictures
    (path / "cam02").rename(path / "gone")
    with pytest.raises(FastGSError, match="4 rows.*3 cameras"):
        load(path)


@pytest.mark.parametrize(("content", "sentence"), [
    (b"\x93NUMPY", "cannot be read"), (b"", "cannot be read"), (np.zeros((4, 16)), "row of 17 numbers"),
    (np.array([{}], object), "cannot be read"), (np.full((4, 17), np.nan), "finite"), (np.zeros((4, 17)), "size|width|height|lie"),
    (np.ones((4, 17)), "rotation"),
])
def test_damaged_poses_are_one_sentence(pictures, content, sentence):
    path, _ = pictures
    file = path / "poses_bounds.npy"
    if isinstance(content, bytes):
        file.write_bytes(content)
    else:
        np.save(file, content, allow_pickle=True)
    with pytest.raises(FastGSError, match=sentence) as error:
        load(path)
    assert "poses_bounds.npy" in str(error.value) and str(error.value).count("\n") == 0


def test_films_that_cannot_be_read_are_left_out_up_to_a_third(videos):
    (videos / "cam02.mp4").write_bytes(b"no video")
    capture = load(videos)
    assert not problems(capture) and capture.views == ["cam00", "cam03", "cam13"]
    assert any("cam02.mp4" in text and "cam02 lacks 3 frames: 0-2" in text for text in capture.notes)
    (videos / "cam03.mp4").write_bytes(b"no video")
    assert any("a third" in text and "cam03.mp4" in text for text in problems(load(videos)))
