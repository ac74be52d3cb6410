# SPDX-License-Identifier: GPL-3.0-or-later
"""Far views: splats become fainter beyond the capture's cameras, gradually, and nothing changes where these stood."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import camera_of, viewpoint_of
from fastgs_blender.captures.generated import look_at
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering import distance
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.instances import Instance, ObjectSettings

SOFT, PLAIN = ObjectSettings(), ObjectSettings(antialias=False)


def ring(count=7, radius=3.0, focal=60.0) -> list[fg.Camera]:
    """Cameras around the middle, not all as far from it or with the same lens, which look at it."""
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    places = [radius * (1 + 0.2 * np.sin(5 * a)) * np.array([np.cos(a), np.sin(a), 0.3]) for a in turns]
    return [fg.Camera(64, 48, focal * (1 + 0.3 * (i % 2)), focal, 32, 24, look_at(place, np.zeros(3))) for i, place in enumerate(places)]


def knowing(model, cameras):
    """The model, as of a capture with these cameras."""
    return replace(model, surroundings=Surroundings(cameras=tuple(viewpoint_of(camera) for camera in cameras)))


def coarser(camera, k: int):
    """The camera with pixels k times as large: what it sees is as if k times as far away."""
    lens = {name: getattr(camera, name) / k for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, width=camera.width // k, height=camera.height // k, window=None, **lens)


def shot(model, camera, settings=SOFT, backend="cpu", **options):
    return fg.render([Instance(model, np.eye(4), 0.4, settings)], camera, backend=backend, **options)


@pytest.fixture
def moving(rng):
    return knowing(random_model(rng, 300, "paper", "line", "radial", "sh1", size=0.05), ring())


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_the_captures_own_cameras_see_what_they_always_saw(moving, backend):
    """To the byte, of what moves too; as a file's numbers and an object's size give the cameras."""
    for camera in (*map(camera_of, moving.surroundings.cameras[:4]), *ring()[:2]):
        one, other = (shot(moving, camera, settings, backend) for settings in (SOFT, PLAIN))
        assert one["alpha"].max() > 0.3 and all(np.array_equal(one[name], other[name]) for name in one)
    placement = np.diag([3.0, 3.0, 3.0, 1.0]) @ np.linalg.inv(random_pose(np.random.default_rng(2), 1.0))
    eye = replace(ring()[1], world_to_camera=np.diag([3.0, 3.0, 3.0, 1.0]) @ ring()[1].world_to_camera @ np.linalg.inv(placement))
    eye = replace(eye, world_to_camera=eye.world_to_camera.round(5))
    one, other = (fg.render([Instance(moving, placement, 0.4, settings)], eye, backend=backend) for settings in (SOFT, PLAIN))
    assert one["alpha"].max() > 0.3 and np.array_equal(one["rgb"], other["rgb"])


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("appearance", ["sh1", "sigmoid"])
def test_kernels_agree_with_the_oracle(rng, appearance, orthographic):
    model = knowing(random_model(rng, 200, "paper", "line", "radial", appearance, size=0.03), ring())
    model.scale[:40] -= 4
    camera = replace(coarser(ring()[0], 4), orthographic=orthographic)
    camera = replace(camera, fx=5.0, fy=5.5) if orthographic else camera
    wanted = ("rgb", "alpha", "depth", "count")
    fast, exact, plain = (shot(model, camera, settings, backend, passes=wanted)
                          for settings, backend in ((SOFT, "cpu"), (SOFT, "reference"), (PLAIN, "cpu")))
    assert np.abs(fast["rgb"] - exact["rgb"]).max() < 2e-4 and np.abs(fast["alpha"] - exact["alpha"]).max() < 2e-4
    assert np.abs(plain["alpha"] - fast["alpha"]).max() > 0.05
    covered = exact["alpha"] > 1e-3
    np.testing.assert_allclose(fast["depth"][covered], exact["depth"][covered], rtol=1e-3)


def board(rng, side=96):
    """A wall of fine squares, at the distance from which a camera of 192 pixels made it."""
    place = np.stack(np.meshgrid(*[np.linspace(-1, 1, side)] * 2), -1).reshape(-1, 2)
    squares = (np.floor(place * 9).sum(1) % 2)[:, None] * [0.7, 0.8, 0.6] + 0.1
    model = fg.GaussianModel(position=np.c_[place, np.zeros(len(place))], rotation=np.tile([1.0, 0, 0, 0], (len(place), 1)),
                             scale=np.log(np.tile([0.007, 0.007, 0.001], (len(place), 1))), opacity=rng.normal(2, 0.5, len(place)),
                             features=squares)
    camera = fg.Camera(192, 192, 192, 192, 96, 96, look_at(np.array([0.4, -0.3, -2.6]), np.zeros(3)))
    return knowing(model, [camera]), camera


def test_a_fine_texture_from_far_away_is_its_picture_made_small(rng):
    """8 times as far, compared with the average over 8 x 8 pixels: the error is less than half of the plain renderer's."""
    model, camera = board(rng)
    near = shot(model, camera)
    for k, error in ((4, 0.09), (8, 0.09)):
        wanted = {name: image.reshape(192 // k, k, 192 // k, k, -1).mean((1, 3)) for name, image in near.items()}
        errors = []
        for settings in (SOFT, PLAIN):
            found = shot(model, coarser(camera, k), settings)
            errors.append(np.sqrt(np.mean((found["rgb"] - wanted["rgb"]) ** 2)))
        assert errors[0] < min(error, errors[1] / 2), (k, errors)


def test_it_begins_without_a_jump_and_goes_on_evenly(rng):
    """From twice as near to 40 times as far in small steps: the opacity never rises, and falls by little at a time."""
    model, camera = board(rng, 4)
    sums, limit = [], 1.0
    for k in np.geomspace(0.5, 40, 90):
        lens = {name: getattr(camera, name) / k for name in ("fx", "fy")}
        eye = replace(camera, **lens)
        light = [shot(model, eye, settings)["alpha"].sum() for settings in (SOFT, PLAIN)]
        sums.append(light[0] / light[1])
        limit = k if sums[-1] == 1 else limit
    assert 0.8 < limit < 1.3 and sums[-1] < 0.05, "it begins at the capture's distance"
    assert (np.diff(sums) < 1e-3).all() and np.diff(sums).min() > -0.12


def test_a_dense_model_does_not_vanish_in_the_distance(rng):
    """Each splat is fainter than the cut of its opacity, which falls with it: together they still cover what they covered."""
    model, camera = board(rng)
    model = replace(model, scale=model.scale - 1)  # a third of a pixel
    near, far = shot(model, camera)["alpha"].mean(), shot(model, coarser(camera, 48))["alpha"].mean()
    assert near > 0.2 and 0.75 < far / near < 1.2


def test_models_that_need_no_help_stay_as_they_are(rng):
    far = coarser(ring()[0], 8)
    unknown = random_model(rng, 100, size=0.02)
    trained = knowing(replace(unknown, raster=fg.Raster(blur=0.1, antialiased=True)), ring())
    flat = Instance(knowing(unknown, ring()), np.diag([1.0, 1.0, 0.0, 1.0]), 0.0)
    for given in (unknown, trained):
        one, other = (shot(given, far, settings) for settings in (SOFT, PLAIN))
        assert one["alpha"].any() and np.array_equal(one["rgb"], other["rgb"])
    assert np.isfinite(fg.render([flat], far)["rgb"]).all()


def test_exposures_do_it_as_sharp_pictures_do(rng):
    model, camera = board(rng, 24)
    still, far = replace(model, clip=fg.Clip(10)), coarser(camera, 8)
    sharp = shot(still, far)
    for exposure in (Exposure(-0.5, 0.5, steps=4), Exposure(aperture=Aperture(1e-6, 2.0, samples=4))):
        found = shot(still, far, exposure=exposure)
        assert np.abs(found["alpha"] - sharp["alpha"]).max() < 1e-4
    assert np.abs(shot(still, far, PLAIN)["alpha"] - sharp["alpha"]).max() > 0.05


def test_the_ball_around_the_cameras(rng):
    """It holds them all and is hardly larger than needed; one camera is its own ball."""
    cameras = tuple(viewpoint_of(camera) for camera in ring(9, 2.0))
    *centre, radius, focal = distance.camera_ball(cameras)
    away = np.linalg.norm(np.array([camera.position for camera in cameras]) - centre, axis=1)
    assert away.max() <= radius * (1 + 1e-12) and radius < 1.25 * 2.0 * np.sqrt(1.09) and focal == 60
    alone = distance.camera_ball(cameras[:1])
    assert alone[:3] == pytest.approx(cameras[0].position) and alone[3] == pytest.approx(0, abs=1e-12)
