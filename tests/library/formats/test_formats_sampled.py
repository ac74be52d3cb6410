# SPDX-License-Identifier: GPL-3.0-or-later
"""Exports for viewers that know no cameras: the capture's sampling limit is in the Gaussians, and the file says that it is antialiased."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender import formats
from fastgs_blender.cameras.poses import look_at
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.formats.scenes import as_seen
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering.instances import Instance, ObjectSettings

FOCAL, AWAY = 60.0, 3.0


@pytest.fixture
def filmed(rng):
    """A static model of small round Gaussians, and the one camera that filmed it, far away along its y axis."""
    model = random_model(rng, 60, appearance="rgb", size=0.004)
    camera = fg.Camera(64, 48, FOCAL, FOCAL, 32, 24, look_at(np.array([0, -AWAY, 0]), np.zeros(3)))
    model = replace(model, position=model.position * 0.2, surroundings=Surroundings(cameras=(viewpoint_of(camera),)))
    return model, camera


@pytest.mark.parametrize("extension", [".ply", ".compressed.ply", ".spz", ".sog"])
def test_files_that_can_say_so_hold_the_limit(filmed, tmp_path, extension):
    """Each squared standard deviation grows by 0.2 pixels squared, a pixel being depth by focal length; places, opacities, shapes stay."""
    model, camera = filmed
    assert formats.says_antialiased(extension)
    seen, _ = as_seen([Instance(model, np.eye(4), 0.0)], antialiased=True)
    plain, _ = as_seen([Instance(model, np.eye(4), 0.0)])
    depth = model.position.astype(float) @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    wanted = np.exp(2 * plain.scale.astype(float)) + 0.2 * (depth / FOCAL)[:, None] ** 2
    np.testing.assert_allclose(np.exp(2 * seen.scale.astype(float)), wanted, rtol=1e-4)
    assert np.array_equal(seen.position, plain.position) and np.array_equal(seen.opacity, plain.opacity)
    path = tmp_path / f"m{extension}"
    with pytest.warns(fg.LossWarning) if extension != ".ply" else pytest.MonkeyPatch.context():
        fg.save(seen, path)
    read = fg.load(path)
    assert read.raster.antialiased and not read.surroundings.cameras and not plain.raster.antialiased


def test_close_ups_of_the_file_are_as_soft_as_those_of_the_model(filmed):
    """As a viewer in Mip-Splatting's mode draws it."""
    model, camera = filmed
    near = replace(camera, width=512, height=384, fx=8 * FOCAL, fy=8 * FOCAL, cx=256, cy=192, window=None)
    seen, _ = as_seen([Instance(replace(model, axes="RFU"), np.eye(4), 0.0)], antialiased=True)
    wanted, got, plain = (fg.render(shown, near, backend="cpu")["rgb"]
                          for shown in (model, seen, replace(model, surroundings=Surroundings())))
    assert np.abs(got - wanted).mean() < 0.3 * np.abs(plain - wanted).mean() > 0


def test_the_limit_is_the_mean_over_the_cameras_that_have_a_gaussian_in_their_pictures(filmed):
    """Not the nearest camera's: the farther ones shaped the Gaussians, too.  One that looks away has no say."""
    model, _ = filmed
    places = np.array([[0, -AWAY, 0], [0, 1.5 * AWAY, 0], [2 * AWAY, 0, 0], [0.0, 0, AWAY / 2]])
    cameras = [fg.Camera(64, 48, FOCAL, FOCAL, 32, 24, look_at(place, place * aim, up=np.ones(3)))
               for place, aim in zip(places, (0, 0, 0, 2), strict=True)]
    model = replace(model, surroundings=Surroundings(cameras=tuple(map(viewpoint_of, cameras))))
    seen, plain = (as_seen([Instance(model, np.eye(4), 0.0)], antialiased=said)[0] for said in (True, False))
    added = np.exp(2 * seen.scale.astype(float)) - np.exp(2 * plain.scale.astype(float))
    depth = np.mean([model.position @ c.world_to_camera[2, :3] + c.world_to_camera[2, 3] for c in cameras[:3]], axis=0)
    np.testing.assert_allclose(np.sqrt(added / 0.2), (depth / FOCAL)[:, None].repeat(3, 1), rtol=0.02)


def test_what_is_not_known_or_not_wanted_stays(filmed, rng):
    model, _ = filmed
    unknown, off = replace(model, surroundings=Surroundings()), ObjectSettings(antialias=False)
    for instances in ([Instance(unknown, np.eye(4), 0.0)], [Instance(model, np.eye(4), 0.0, off)],
                      [Instance(model, np.eye(4), 0.0), Instance(unknown, np.eye(4), 0.0)]):
        one, other = as_seen(instances, antialiased=True)[0], as_seen(instances)[0]
        assert np.array_equal(one.scale, other.scale) and not one.raster.antialiased
    asked = as_seen([Instance(unknown, np.eye(4), 0.0, ObjectSettings(pixel_size=0.1))], antialiased=True)[0]
    np.testing.assert_allclose(np.exp(2 * asked.scale.astype(float)), np.exp(2 * unknown.scale.astype(float)) + 0.2 * 0.01, rtol=1e-4)
    assert not any(map(formats.says_antialiased, (".splat", ".glb", ".usdc")))
