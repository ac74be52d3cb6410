# SPDX-License-Identifier: GPL-3.0-or-later
"""Antialiasing: fainter in coarser pixels than the capture's, softer in finer ones; nothing changes where the cameras stood."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.panorama import FACES, Panorama
from fastgs_blender.cameras.poses import look_at
from fastgs_blender.cameras.viewpoints import camera_of, viewpoint_of
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering import distance
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.visibility import order

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
    """From twice as near to 40 times as far in small steps: the opacity falls by little at a time.

    It hardly ever rises: where a splat of a third of a pixel lies in its pixel makes a little difference.
    """
    model, camera = board(rng, 4)
    sums, limit = [], 1.0
    for k in np.geomspace(0.5, 40, 90):
        lens = {name: getattr(camera, name) / k for name in ("fx", "fy")}
        eye = replace(camera, **lens)
        light = [shot(model, eye, settings)["alpha"].sum() for settings in (SOFT, PLAIN)]
        sums.append(light[0] / light[1])
        limit = k if sums[-1] == 1 else limit
    assert 0.8 < limit < 1.3 and sums[-1] < 0.05, "it begins at the capture's distance"
    assert (np.diff(sums) < 5e-3).all() and np.diff(sums).min() > -0.12


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_smaller_picture_is_the_large_one_averaged(rng, backend):
    """Of the farther of two cameras, too, whose pixels were not the coarsest of the capture; the plain renderer's is far off."""
    model, near = board(rng)
    far = fg.Camera(192, 192, 60, 60, 96, 96, look_at(np.array([0.8, -0.6, -5.2]), np.zeros(3)))
    model = knowing(model, [near, far])
    for k in (2, 4):
        large = shot(model, near, backend=backend)["rgb"]
        wanted = large.reshape(192 // k, k, 192 // k, k, 3).mean((1, 3))
        one, other = (np.abs(shot(model, coarser(near, k), settings, backend)["rgb"] - wanted).mean() for settings in (SOFT, PLAIN))
        assert one < 0.25 * other, (k, one, other)


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


@pytest.mark.parametrize("view", [lambda camera: coarser(camera, 8), lambda camera: finer(camera, 3)], ids=["far", "near"])
def test_exposures_do_it_as_sharp_pictures_do(rng, view):
    model, camera = board(rng, 24)
    still, eye = replace(model, clip=fg.Clip(10)), view(camera)
    sharp = shot(still, eye)
    for exposure in (Exposure(-0.5, 0.5, steps=4), Exposure(aperture=Aperture(1e-6, 2.0, samples=4))):
        found = shot(still, eye, exposure=exposure)
        assert np.abs(found["alpha"] - sharp["alpha"]).max() < 1e-3
    assert np.abs(shot(still, eye, PLAIN)["alpha"] - sharp["alpha"]).max() > 0.05


def test_panoramas_do_it_all_around(rng):
    """Four times as fine as six cameras that look all around: averaged down it has about the light of the coarse one."""
    places = rng.normal(size=(3000, 3))
    places *= 2 / np.linalg.norm(places, axis=1, keepdims=True)
    specks = fg.GaussianModel(position=places, rotation=np.tile([1.0, 0, 0, 0], (3000, 1)), scale=np.full((3000, 3), -8.0),
                              opacity=np.full(3000, 1.0), features=np.ones((3000, 3)))
    faces = []
    for turn in FACES:
        pose = np.eye(4)
        pose[:3, :3] = turn
        faces.append(fg.Camera(40, 40, 20, 20, 20, 20, pose))
    model, small = knowing(specks, faces), Panorama(96, 48, np.eye(4))
    fine = replace(small, width=384, height=192, window=None)
    wanted = shot(model, small)["alpha"].reshape(6, 8, 12, 8).mean((1, 3))
    on, off = (shot(model, fine, settings)["alpha"].reshape(6, 32, 12, 32).mean((1, 3)) for settings in (SOFT, PLAIN))
    assert np.abs(on / wanted - 1)[1:5].max() < 0.35 and (off / wanted)[1:5].max() < 0.5


def test_the_ball_around_the_cameras(rng):
    """It holds them all and is hardly larger than needed; one camera is its own ball."""
    cameras = tuple(viewpoint_of(camera) for camera in ring(9, 2.0))
    *centre, radius, focal = distance.camera_ball(cameras)
    away = np.linalg.norm(np.array([camera.position for camera in cameras]) - centre, axis=1)
    assert away.max() <= radius * (1 + 1e-12) and radius < 1.25 * 2.0 * np.sqrt(1.09) and focal == 60
    alone = distance.camera_ball(cameras[:1])
    assert alone[:3] == pytest.approx(cameras[0].position) and alone[3] == pytest.approx(0, abs=1e-12)


def finer(camera, k: float):
    """The camera with pixels k times as fine."""
    lens = {name: getattr(camera, name) * k for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, width=round(camera.width * k), height=round(camera.height * k), window=None, **lens)


def uneven() -> list[fg.Camera]:
    """Two cameras with unlike lenses near the middle, and one three times as far away: each sees places that others do not."""
    places = ([0.1, -2.0, 0.3], [1.9, 0.4, -0.2], [-4.0, -5.0, 1.0])
    focals, targets = (45.0, 90.0, 60.0), ([0.6, 0, 0], [0, 0.7, 0], [0, 0, 0])
    return [fg.Camera(64, 48, focal, 1.1 * focal, 30, 25, look_at(np.array(place), np.array(target)))
            for place, focal, target in zip(places, focals, targets)]


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_uneven_cameras_see_what_they_always_saw(rng, backend):
    """Large Gaussians reach into a picture from far outside, where another camera saw them less sharply."""
    model = random_model(rng, 300, "paper", "line", "radial", "rgb", size=0.02)
    model.scale[:100] += 3
    model = knowing(model, uneven())
    for camera in uneven():
        for settings in (SOFT, ObjectSettings(bends=False)):
            one, other = (shot(model, camera, replace(settings, antialias=on), backend) for on in (True, False))
            assert one["alpha"].max() > 0.3 and all(np.array_equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("appearance", ["sh1", "sigmoid"])
def test_kernels_agree_with_the_oracle_in_fine_pixels(rng, appearance, orthographic):
    model = knowing(random_model(rng, 200, "paper", "line", "radial", appearance, size=0.01), uneven())
    camera = replace(finer(uneven()[0], 3), orthographic=orthographic)
    camera = replace(camera, fx=64.0, fy=64.0) if orthographic else camera
    fast, exact, plain = (shot(model, camera, settings, backend, passes=("rgb", "alpha", "depth"))
                          for settings, backend in ((SOFT, "cpu"), (SOFT, "reference"), (PLAIN, "cpu")))
    assert np.abs(fast["rgb"] - exact["rgb"]).max() < 2e-4 and np.abs(fast["alpha"] - exact["alpha"]).max() < 2e-4
    assert np.abs(plain["alpha"] - fast["alpha"]).max() > 0.05
    covered = exact["alpha"] > 1e-3
    np.testing.assert_allclose(fast["depth"][covered], exact["depth"][covered], rtol=1e-3)


@pytest.mark.parametrize("antialiased", [False, True])
def test_in_fine_pixels_the_blur_is_as_wide_on_the_surface_as_in_training(rng, antialiased):
    """One camera, enlarged: as a rasteriser draws it whose constant blur is that many pixels."""
    model, camera = board(rng, 24)
    model = replace(model, raster=fg.Raster(antialiased=antialiased))
    for k in (2, 4):
        wide = replace(model, raster=fg.Raster(blur=0.3 * (k / distance.MARGIN) ** 2, antialiased=antialiased))
        one, other, before = shot(model, finer(camera, k)), shot(wide, finer(camera, k), PLAIN), shot(model, finer(camera, k), PLAIN)
        assert np.abs(one["rgb"] - other["rgb"]).max() < 1e-5 and np.abs(one["rgb"] - before["rgb"]).max() > 0.1


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_camera_enlarged_is_as_soft_as_its_own_picture_though_another_saw_more(rng, backend):
    """The farther of two cameras, in finer pixels: as wide a blur as in its own picture.  Nearer than both, the nearer one decides."""
    model, far = board(rng, 24)
    near = replace(far, world_to_camera=look_at(np.array([-0.1, 0.2, -0.9]), np.zeros(3)))
    model = knowing(model, [near, far])
    for k in (2, 4):
        wide = replace(model, raster=fg.Raster(blur=0.3 * (k / distance.MARGIN) ** 2))
        one, other = shot(model, finer(far, k), backend=backend), shot(wide, finer(far, k), PLAIN, backend)
        assert np.abs(one["rgb"] - other["rgb"]).max() < 1e-5
    nearest = replace(far, world_to_camera=look_at(np.array([-0.05, 0.1, -0.45]), np.zeros(3)))
    alone = knowing(model, [near])
    one, other = shot(model, nearest, backend=backend), shot(alone, nearest, backend=backend)
    assert np.abs(one["rgb"] - other["rgb"]).max() < 1e-5 and np.abs(one["rgb"] - shot(model, nearest, PLAIN)["rgb"]).max() > 0.02


def test_a_view_is_compared_with_the_lenses_around_it():
    """A camera's own place has its own lens, also beside another lens in the same place; between two it has something between."""
    places, focals = ([0.0, 0, 0], [0.0, 0, 0], [4.0, 0, 0], [0.0, 4.0, 0]), (50.0, 100.0, 60.0, 80.0)
    cameras = [fg.Camera(64, 48, focal, focal, 32, 24, look_at(np.array(place), np.array(place) + [0.0, 1, 0]))
               for place, focal in zip(places, focals)]
    instance = Instance(knowing(random_model(np.random.default_rng(0), 3), cameras), np.eye(4), 0.0)
    for camera in cameras:
        assert instance.viewed(camera).sampling.zoom == pytest.approx(1, abs=1e-6)
    assert [instance.viewed(finer(camera, 4)).sampling.zoom for camera in cameras] == pytest.approx([2, 4, 4, 4], rel=0.2)
    path = [replace(cameras[2], world_to_camera=look_at(np.array([x, 0.0, 0]), np.array([x, 1.0, 0]))) for x in np.linspace(0.5, 4, 400)]
    zooms = [instance.viewed(camera).sampling.zoom for camera in path]
    assert min(zooms) > 0.6 and max(zooms) < 1.2 and np.abs(np.diff(zooms)).max() < 0.01
    assert instance.viewed(replace(cameras[0], orthographic=True)).sampling.zoom == 1


def test_the_finest_pixel_is_that_of_the_sharpest_camera_that_sees_a_place(rng):
    """Depth by focal length, the least over those in whose picture the place is; never more than the coarsest."""
    cameras = uneven()
    sampling = Instance(knowing(random_model(rng, 3), cameras), np.eye(4), 0.0).viewed(cameras[0]).sampling
    places = rng.uniform(-2.5, 2.5, (400, 3))
    least = np.full(400, np.inf)
    for camera in cameras:
        p = places @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        x, y = camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy
        inside = (p[:, 2] > 0) & (x > 0) & (x < 64) & (y > 0) & (y < 48)
        least = np.where(inside, np.minimum(least, p[:, 2] / np.sqrt(camera.fx * camera.fy)), least)
    found, seen = sampling.finest(places, np.zeros(400)), np.isfinite(least)
    assert 50 < seen.sum() < 400 and (found <= sampling.coarsest(places)).all()
    assert (found[seen] <= least[seen] * (1 + 1e-9)).all() and np.mean(np.isclose(found[seen], least[seen])) > 0.5
    assert (found[~seen] > 0).all()


def test_nothing_jumps_where_a_gaussian_leaves_a_picture(rng):
    """Along lines through all three pictures and past the cameras."""
    sampling = Instance(knowing(random_model(rng, 3), uneven()), np.eye(4), 0.0).viewed(uneven()[0]).sampling
    for start, end in rng.uniform(-5, 5, (20, 2, 3)):
        found = sampling.finest(start + (end - start) * np.linspace(0, 1, 4000)[:, None], np.full(4000, 0.01))
        assert np.abs(np.diff(found)).max() < 0.03 * found.max()


def test_it_softens_without_a_jump(rng):
    """In ever finer pixels the splats cover what they covered in training."""
    model, camera = board(rng, 8)
    covered = []
    for k in np.geomspace(1.05, 5, 20):
        eye = finer(camera, k)
        covered.append(shot(model, eye, passes=("alpha",))["alpha"].sum() / k**2)
    assert max(covered) / min(covered) < 1.001


def test_files_that_know_no_cameras_have_a_setting(rng):
    """The size of a pixel on the surface, in the model's own units.  Far views stay as they are, and so does all without it."""
    model, camera = board(rng, 24)
    model, size = replace(model, surroundings=Surroundings()), 0.02
    asked = ObjectSettings(pixel_size=size)
    for focal in (30.0, 90.0, 200.0):
        eye = replace(camera, orthographic=True, fx=focal, fy=focal)
        wide = replace(model, raster=fg.Raster(blur=0.3 * max(size * focal / distance.MARGIN, 1) ** 2))
        one, other, before = shot(model, eye, asked), shot(wide, eye, PLAIN), shot(model, eye)
        assert np.abs(one["rgb"] - other["rgb"]).max() < 1e-5 and np.array_equal(before["rgb"], shot(model, eye, PLAIN)["rgb"])
        assert np.array_equal(one["rgb"], before["rgb"]) == (size * focal < 1)
    assert np.array_equal(shot(model, eye, replace(asked, antialias=False))["rgb"], before["rgb"])


def test_an_object_that_is_enlarged_is_a_near_view_of_it(rng):
    """Three times as large at three times the distance: the same picture."""
    model, camera = board(rng, 24)
    for eye in (finer(camera, 3), coarser(camera, 4)):
        away = replace(eye, world_to_camera=eye.world_to_camera @ np.diag([1 / 3, 1 / 3, 1 / 3, 1]))
        away = replace(away, world_to_camera=np.diag([3.0, 3.0, 3.0, 1]) @ away.world_to_camera)
        large = fg.render([Instance(model, np.diag([3.0, 3.0, 3.0, 1.0]), 0.4)], away, backend="cpu")
        assert np.abs(large["rgb"] - shot(model, eye)["rgb"]).max() < 1e-4


def test_viewports_list_all_that_is_soft_enough_to_be_seen(rng):
    """A speck outside of the picture whose blur reaches into it."""
    model = fg.GaussianModel(position=[[0.0, 0, 0]], rotation=[[1.0, 0, 0, 0]], scale=np.full((1, 3), -12.0), opacity=[5.0],
                             features=[[1.0, 1, 1]])
    camera = fg.Camera(32, 32, 32, 32, 16, 16, look_at(np.array([0, -4.0, 0]), np.zeros(3)))
    eye = finer(camera, 8)
    eye = replace(eye, cx=-8.0)
    instance = Instance(knowing(model, [camera]), np.eye(4), 0.0)
    assert fg.render([instance], eye, backend="cpu")["alpha"].max() > 0.1
    for backend in ("cpu", "reference"):
        assert len(order([instance.viewed(eye)], eye, backend=backend)) == 1
        assert len(order([replace(instance, settings=PLAIN).viewed(eye)], eye, backend=backend)) == 0
