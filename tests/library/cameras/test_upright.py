# SPDX-License-Identifier: GPL-3.0-or-later
"""Setting captures upright: the transform is rigid, and the ground becomes level at height 0."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fastgs_blender as fg
from fastgs_blender.cameras.upright import ground_from_cameras, ground_from_points
from fastgs_blender.util.rotations import to_matrices


def random_rotation(rng):
    q = rng.normal(size=4)
    return to_matrices((q / np.linalg.norm(q))[None])[0]


def applied(motion, points):
    return points @ motion[:3, :3].T + motion[:3, 3]


def assert_rigid(motion):
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(motion[:3, :3]) == pytest.approx(1)


@given(st.integers(0, 2**32 - 1))
def test_three_points_come_to_lie_on_the_floor(seed):
    rng = np.random.default_rng(seed)
    points, eye = rng.uniform(-5, 5, (3, 3)), rng.uniform(-20, 20, 3)
    motion = ground_from_points(points, eye)
    assert_rigid(motion)
    np.testing.assert_allclose(applied(motion, points)[:, 2], 0, atol=1e-9)
    assert applied(motion, eye)[2] >= 0
    np.testing.assert_allclose(applied(motion, points).mean(0)[:2], points.mean(0)[:2], atol=1e-9)
    np.testing.assert_allclose(motion, ground_from_points(points[[2, 1, 0]], eye), atol=1e-6)


def test_without_a_side_up_stays_up():
    motion = ground_from_points([[0, 0, 1], [1, 0, 1.2], [0, 1, 1.1]])
    assert motion[2, 2] > 0.9
    below = ground_from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0]], above=[0, 0, -1])
    np.testing.assert_allclose(below[:3, :3] @ [0, 0, 1], [0, 0, -1], atol=1e-12)


@pytest.mark.parametrize("points", [[[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 0], [0, 0, 0], [1, 0, 0]], np.zeros((3, 3))])
def test_points_on_a_line_are_refused(points):
    with pytest.raises(fg.FastGSError, match="line"):
        ground_from_points(points)


def rig(rng, count, tilt=0.0, roll=0.0):
    """Camera-to-world matrices [n, 4, 4] around the origin, z up, looking inwards and down by `tilt`, with some roll."""
    matrices = np.tile(np.eye(4), (count, 1, 1))
    for matrix, angle in zip(matrices, np.linspace(0, 4, count)):
        forward = np.array([-np.cos(angle), -np.sin(angle), -np.tan(tilt)])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        turn = rng.normal(0, roll)
        right, down = np.cos(turn) * right + np.sin(turn) * down, np.cos(turn) * down - np.sin(turn) * right
        matrix[:3, :3], matrix[:3, 3] = np.stack([right, down, forward], 1), [3 * np.cos(angle), 3 * np.sin(angle), 1.5]
    return matrices


@given(st.integers(0, 2**32 - 1))
def test_cameras_say_where_up_is(seed):
    """Level cameras that look steeply down: their mean `up` is far from the truth, their horizontal axes are not."""
    rng = np.random.default_rng(seed)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = random_rotation(rng), rng.uniform(-3, 3, 3)
    floor = world[:3, 3]
    motion = ground_from_cameras(world @ rig(rng, 12, tilt=0.9), floor)
    assert_rigid(motion)
    np.testing.assert_allclose(motion[:3, :3] @ world[:3, 2], [0, 0, 1], atol=1e-6)
    assert applied(motion, floor)[2] == pytest.approx(0, abs=1e-9)
    rolled = ground_from_cameras(world @ rig(rng, 40, tilt=0.3, roll=0.03), floor)
    assert (rolled[:3, :3] @ world[:3, 2])[2] > np.cos(0.03)


def test_cameras_that_all_look_one_way_or_disagree(rng):
    (one,) = rig(rng, 1, tilt=0.2)
    motion = ground_from_cameras([one, one])
    np.testing.assert_allclose(motion[:3, :3] @ -one[:3, 1], [0, 0, 1], atol=1e-9)
    upside_down = one @ np.diag([-1.0, -1, 1, 1])
    for cameras in ([one, upside_down], []):
        with pytest.raises(fg.FastGSError, match="three points"):
            ground_from_cameras(np.array(cameras).reshape(-1, 4, 4))
