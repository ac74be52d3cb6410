# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that were bumped after they were calibrated: points of the others say where they look."""
from dataclasses import replace

import numpy as np
import pytest
from filmed_room import write_room

import fastgs_blender as fg
from fastgs_blender.cameras.poses import look_at, turned
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial import refine
from fastgs_blender.training.initial.bumped import pose_by_points, turned_by_points
from fastgs_blender.training.initial.geometry import project

CAMERA = fg.Camera(640, 360, 540.0, 550.0, 330.0, 170.0, look_at((2, -5, 1), (0, 0, 0)))
TURN = np.radians([0.8, -2.0, 1.5])


def seen(rng, camera, count, wrong=0):
    """Points before a camera, and where it sees them, to half a pixel; the last ones anywhere."""
    points = rng.uniform(-1, 1, (count, 3))
    places = project(camera, points)[0] + rng.normal(0, 0.5, (count, 2))
    places[count - wrong:] = rng.uniform((0, 0), (camera.width, camera.height), (wrong, 2))
    return places, points


def apart(pose, other):
    """Degrees, and distance, between two poses."""
    cosine = (np.trace(pose[:3, :3] @ other[:3, :3].T) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.linalg.norm(np.linalg.inv(pose)[:3, 3] - np.linalg.inv(other)[:3, 3])


@pytest.mark.parametrize(("count", "within"), [(12, 0.3), (200, 0.1)])
def test_a_turned_camera_is_found_among_wrong_matches(rng, count, within):
    """Also where a move would explain few points as well: it stands where it was."""
    given = replace(CAMERA, world_to_camera=turned(CAMERA.world_to_camera, TURN))
    places, points = seen(rng, CAMERA, count, wrong=count // 3)
    for solve in (turned_by_points, pose_by_points):
        angle, moved = apart(solve(places, points, given), CAMERA.world_to_camera)
        assert angle < within and moved < 1e-9


def test_a_moved_camera_is_found_by_many_points_alone(rng):
    given = replace(CAMERA, world_to_camera=look_at((2.6, -4.6, 1.2), (0.2, 0, 0)))
    places, points = seen(rng, CAMERA, 100, wrong=30)
    angle, moved = apart(pose_by_points(places, points, given), CAMERA.world_to_camera)
    assert angle < 0.3 and moved < 0.03
    assert pose_by_points(places[:20], points[:20], given) is None


def test_a_true_pose_and_chance_stay(rng):
    assert pose_by_points(*seen(rng, CAMERA, 100, wrong=30), CAMERA) is None
    given = replace(CAMERA, world_to_camera=turned(CAMERA.world_to_camera, TURN))
    assert pose_by_points(*seen(rng, CAMERA, 100, wrong=90), given) is None


@pytest.mark.slow
def test_training_puts_a_bumped_camera_right(tmp_path):
    """By 2 degrees, 14 pixels: along the lines of its calibration it has no matches at all."""
    bump = np.radians([0.0, 2.0, 0.0])
    path = write_room(tmp_path / "made", 8, 1, detail=1, calibrated={5: lambda pose: turned(pose, bump)})
    said = []
    capture = open_capture(path)
    found = refine.found_by_tracks(capture, FrameStore(capture, folder=tmp_path / "cache"), settings(), said.append)
    assert "cam05" in said[0] and list(found["cameras"]) == ["cam05"]
    change = found["cameras"]["cam05"]
    assert np.degrees(np.linalg.norm(change["turn"] + bump)) < 0.15 and np.linalg.norm(change["shift"]) < 0.02
