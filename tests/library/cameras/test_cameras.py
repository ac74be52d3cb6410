# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json: read as INRIA's trainer means it, and one sentence for what is wrong with it."""
from __future__ import annotations

import json

import numpy as np
import pytest
from random_cameras import random_pose

import fastgs_blender as fg
from fastgs_blender.cameras.cameras_json import choose, load_cameras, resized


def entry(world_to_camera=None, **fields) -> dict:
    """One camera as INRIA's trainer writes it."""
    to_world = np.linalg.inv(np.eye(4) if world_to_camera is None else world_to_camera)
    return {"id": 0, "img_name": "cam00", "width": 64, "height": 48, "position": to_world[:3, 3].tolist(),
            "rotation": to_world[:3, :3].tolist(), "fx": 50.0, "fy": 51.0} | fields


@pytest.fixture
def write(tmp_path):
    """write(value): the path of a cameras.json with that content; a str or bytes as it is."""

    def write(value):
        path = tmp_path / "cameras.json"
        if isinstance(value, bytes):
            path.write_bytes(value)
        else:
            path.write_text(value if isinstance(value, str) else json.dumps(value))
        return path

    return write


def test_reads_what_inria_writes(write, rng):
    pose = random_pose(rng, 3.0)
    (view,) = load_cameras(write([entry(pose)]))
    camera = view.camera
    assert view.name == "cam00"
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 50, 51, 32, 24)
    np.testing.assert_allclose(camera.world_to_camera, pose, atol=1e-12)


def test_principal_point_names_and_unknown_keys(write):
    views = load_cameras(write([entry(cx=30.5, cy=20.25, k1=0.1), entry(img_name="left"), {"img_name": 7} | entry(img_name=7)]))
    assert (views[0].camera.cx, views[0].camera.cy) == (30.5, 20.25)
    assert [v.name for v in views] == ["cam00", "left", "7"]


def test_a_single_camera_may_stand_alone(write):
    assert len(load_cameras(write(entry()))) == 1


def test_views_are_chosen_by_name_then_number(write):
    views = load_cameras(write([entry(img_name="a"), entry(img_name="0"), entry(img_name="c")]))
    assert choose(views, "c", "f").name == "c"
    assert choose(views, "2", "f").name == "c"
    with pytest.raises(fg.FastGSError, match="number 0, named a"):
        choose(views[:1], "2", "f")
    assert choose(views, "0", "f").name == "0"
    for absent in ("3", "-1", "", "b", "²"):
        with pytest.raises(fg.FastGSError, match="no view"):
            choose(views, absent, "f")


def test_another_size_keeps_the_horizontal_view_and_stretches_nothing(write):
    camera = load_cameras(write([entry(cx=30, cy=20)]))[0].camera
    small = resized(camera, 32, 24)
    assert (small.fx, small.fy, small.cx, small.cy) == (25, 25.5, 15, 10)
    wide = resized(camera, 128, 48)
    assert (wide.fx, wide.fy, wide.cx, wide.cy) == (100, 102, 60, 16)
    assert wide.width / wide.fx == camera.width / camera.fx


BROKEN = {
    "not JSON": ("[{", "not JSON"),
    "a binary file": (b"\x89PNG\xff\xfe", "not JSON"),
    "empty": ("", "not JSON"),
    "nested without end": ("[" * 100_000, "not JSON"),
    "a number": ("3", "list"),
    "no cameras": ("[]", "at least one"),
    "not a table": ("[3]", "camera 0 must be a table"),
    "missing keys": ([{"width": 3}], "camera 0 lacks height, position, rotation, fx, fy"),
    "the second is wrong": ([entry(), entry(fx=0)], "camera 1"),
    "a size of 0": ([entry(width=0)], "whole pixels"),
    "half a pixel": ([entry(height=10.5)], "whole pixels"),
    "a huge size": ([entry(width=10**9)], "whole pixels"),
    "a size in words": ([entry(width="64")], "width"),
    "a size that is no number": ([entry(width=None)], "width"),
    "a truth value": ([entry(height=True)], "height"),
    "a negative focal length": ([entry(fy=-3)], "focal"),
    "NaN": ('[{"width": 4, "height": 4, "fx": NaN, "fy": 1, "position": [0,0,0], "rotation": [[1,0,0],[0,1,0],[0,0,1]]}]', "fx"),
    "an integer beyond float": ([entry(fx=10**400)], "fx"),
    "a short position": ([entry(position=[1, 2])], "3 finite numbers"),
    "a ragged rotation": ([entry(rotation=[[1, 0, 0], [0, 1], [0, 0, 1]])], "3 x 3"),
    "a scaled rotation": ([entry(rotation=(2 * np.eye(3)).tolist())], "rotation matrix"),
    "a mirror": ([entry(rotation=np.diag([1, 1, -1]).tolist())], "rotation matrix"),
    "a singular rotation": ([entry(rotation=np.zeros((3, 3)).tolist())], "rotation matrix"),
    "a principal point of text": ([entry(cx="left")], "cx"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_is_wrong_is_one_sentence_with_the_file(write, what):
    content, words = BROKEN[what]
    path = write(content)
    with pytest.raises(fg.FastGSError, match=words) as error:
        load_cameras(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    for path, words in ((tmp_path / "none.json", "no such file"), (tmp_path, "a folder")):
        with pytest.raises(fg.FastGSError, match=words) as error:
            load_cameras(path)
        assert str(path) in str(error.value)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0)])
def test_a_camera_looks_at_a_point_upright(up):
    eye, target = np.array([2.0, -3, 1.5]), np.array([0.5, 0.2, -1])
    matrix = fg.look_at(eye, target, up)
    turn = matrix[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(matrix @ [*eye, 1], [0, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(matrix @ [*target, 1], [0, 0, np.linalg.norm(target - eye), 1], atol=1e-12)
    assert turn[0] @ up == pytest.approx(0) and turn[1] @ up < 0, "x stays level, and y is down"
    for wrong in (eye, eye + 2 * np.array(up)):
        with pytest.raises(fg.FastGSError, match="look at"):
            fg.look_at(eye, wrong, up)
