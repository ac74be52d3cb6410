# SPDX-License-Identifier: GPL-3.0-or-later
"""Large planes are found among points, and a floor at a grazing angle has its depths by them."""
from __future__ import annotations

from dataclasses import replace

import filmed_room
import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.training.core.targets import small_camera, smaller
from fastgs_blender.training.initial import planes, sweep

NEAR, FAR, SMALLER = 1.2, 8.0, 3


@pytest.fixture(scope="module")
def pictures():
    """Of an arc of six cameras in the small room, (rgb [80, 106, 3], camera, None)."""
    (width, height), focal, found = filmed_room.SIZE, filmed_room.FOCAL, []
    for angle in np.linspace(-0.3, 0.3, 6):
        camera = fg.Camera(width, height, focal, focal, width / 2, height / 2, filmed_room.pose(angle))
        image = smaller(filmed_room.picture(angle, 0.0)[: height // SMALLER * SMALLER, : width // SMALLER * SMALLER], SMALLER)
        found.append((np.ascontiguousarray(image), small_camera(camera, SMALLER), None))
    return found


def floor_depth(camera) -> np.ndarray:
    """Depth [h, w] of the floor, y = 1, in each pixel; inf above the horizon."""
    x, y = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx, (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    turn, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    down = x * turn[0, 1] + (y * turn[1, 1])[:, None] + turn[2, 1]
    with np.errstate(divide="ignore"):
        return np.where(down > 1e-6, (1 + turn[:, 1] @ shift) / down, np.inf)


def right(pictures, depths, least=0.75) -> float:
    """Share of the lowest quarter of the pictures, where the floor is at a grazing angle, whose depths are right to 1 %."""
    good = [np.abs(its.depth / floor_depth(camera) - 1)[int(least * its.depth.shape[0]):] < 0.01
            for (_, camera, _), its in zip(pictures, depths)]
    return float(np.mean(good))


def test_a_floor_has_its_depths(pictures):
    before = sweep.swept(pictures, NEAR, FAR)
    cloud = np.concatenate([xyz for xyz, _ in sweep.surfaces(pictures, before)])
    large = planes.large(cloud, 0)
    floor = large[(np.abs(large[:, 1]) > 0.999) & (np.abs(np.abs(large[:, 3]) - 1) < 0.03)]
    assert len(floor), "the floor is among them"
    after = planes.laid(pictures, before, large, NEAR, FAR)
    assert right(pictures, after) > 1.35 * right(pictures, before)  # boxes hide half of the floor there
    for old, new in zip(before, after):
        same = new.cost == old.cost
        assert (new.cost <= old.cost).all() and np.array_equal(new.depth[same], old.depth[same]) and (new.range[~same] == 1).all()
    assert planes.laid(pictures, before, np.zeros((0, 4)), NEAR, FAR) is before
    edge_on = np.array([[0.0, 0.0, 0.0, 0.0]])
    assert all(a is b for a, b in zip(planes.laid(pictures, before, edge_on, NEAR, FAR), before))
    assert planes.laid(pictures[:1], before[:1], large, NEAR, FAR) == [None], "a camera alone tells no depth"


def test_what_a_neighbour_does_not_show_does_not_count(pictures):
    behind = np.diag([-1.0, 1, -1, 1])
    away = [(image, replace(camera, world_to_camera=behind @ camera.world_to_camera), None) for image, camera, _ in pictures]
    toward = np.array([[0, 0, 1 / 3.0], [0, 0, 1 / 5.0]])
    three = sweep.differences(pictures[0], pictures[1:4], toward)
    assert np.array_equal(sweep.differences(pictures[0], pictures[1:4] + away[1:4], toward), three)
    assert np.array_equal(sweep.differences(pictures[0], away[1:4] + pictures[1:4], toward), three)
    lonely = sweep.differences(pictures[0], pictures[1:2] + away[1:4], toward)
    assert (lonely > sweep.OUTSIDE / 2).all(), "one picture alone is no evidence among several"


def test_planes_among_points():
    rng = np.random.default_rng(0)
    floor, wall = rng.uniform(-2, 2, (3000, 3)), rng.uniform(-2, 2, (2000, 3))
    floor[:, 2], wall[:, 0] = 0.005 * rng.normal(size=3000), 2 + 0.005 * rng.normal(size=2000)
    stray = rng.uniform(-2, 2, (1500, 3))
    middle = planes.large(np.concatenate([floor, wall, stray]), 0)[planes.BESIDE::2 * planes.BESIDE + 1]
    assert len(middle) == 2
    np.testing.assert_allclose(np.abs(middle[0]), [0, 0, 1, 0], atol=0.02)
    np.testing.assert_allclose(np.abs(middle[1]), [1, 0, 0, 2], atol=0.03)
    assert len(planes.large(stray, 0)) == 0, "points everywhere lie on no plane"
    assert len(planes.large(stray[:20], 0)) == 0 and len(planes.large(np.zeros((0, 3)), 0)) == 0
    planes.large(np.zeros((500, 3)), 0)  # one place is no plane, and no error
