# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera that shows a model first."""
from dataclasses import replace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.cameras.opening import middle_camera, opening, overview, up_of

VIEW = fg.Viewpoint(width=64, height=48, fx=50, fy=50, cx=32, cy=24, position=(0, 0, -4), distance=3)


def seen(camera, place):
    """Pixels of a point of the world."""
    matrix = camera.world_to_camera
    return camera.pixels(np.asarray(place) @ matrix[:3, :3].T + matrix[:3, 3])


@pytest.fixture
def model(rng, make_model):
    return make_model(rng, 200, axes="RDF")


def test_the_view_of_the_author_comes_first(model):
    camera, pivot = opening(replace(model, surroundings=fg.Surroundings(cameras=(replace(VIEW, position=(9, 0, 0)),), view=VIEW)))
    assert (camera.width, camera.fx) == (64, 50) and pivot == pytest.approx([0, 0, -1])
    assert np.linalg.inv(camera.world_to_camera)[:3, 3] == pytest.approx([0, 0, -4])


def test_of_a_capture_the_middle_camera_looks_at_the_depth_of_the_subject(model):
    cameras = tuple(replace(VIEW, position=(x, 0, -4), distance=0) for x in (-1, 0.1, 1))
    camera, pivot = opening(replace(model, position=model.position + np.float32([0, 0, 2]), surroundings=fg.Surroundings(cameras=cameras)))
    assert np.linalg.inv(camera.world_to_camera)[:3, 3] == pytest.approx([0.1, 0, -4])
    assert pivot[:2] == pytest.approx([0.1, 0]) and 1 < pivot[2] < 3


@pytest.mark.parametrize(("axes", "up"), [("RDF", (0, -1, 0)), ("RFU", (0, 0, 1)), ("RUB", (0, 1, 0))])
def test_without_cameras_all_of_it_is_seen_upright(model, axes, up):
    turned = replace(model, axes=axes)
    assert tuple(up_of(turned)) == up
    for camera in (overview(turned, 64, 48), opening(turned, 64, 48)[0]):
        foot, head = seen(camera, (0, 0, 0)), seen(camera, np.array(up) * 0.2)
        assert head[1] < foot[1] and 0 < foot[0] < 64 and 0 < foot[1] < 48


def test_the_middle_camera_of_a_dome_looks_from_the_side():
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = [(np.cos(a), np.sin(a), height) for height in (0.2, 0.6) for a in turn]
    dome = tuple(fg.Viewpoint(position=tuple(map(float, place))) for place in [*ring, (0.1, 0.0, 1.0)])
    assert dome[middle_camera(dome, (0, 0, 1))].position[2] < 1 and middle_camera(dome, (0, 1, 0)) == len(dome) - 1
