# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of splats on meshes, in scenes whose shadows are known."""
from __future__ import annotations

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.shadow import Light, Shadow

CAMERA = fg.Camera(96, 64, 80, 80, 48, 32, np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 8], [0, 0, 0, 1.0]]))
"""It looks down at the ground z = 0 from z = 8, x to the right and y up: 10 pixels a unit."""


def ground(z=0.0, half=20.0):
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]], np.float32)
    return corners[[[0, 1, 2], [0, 2, 3]]]


def ball(x, y, z, size=0.3, alpha=0.9):
    return fg.GaussianModel(position=[[x, y, z]], rotation=[[1, 0, 0, 0]], scale=np.log([[size] * 3]),
                            opacity=[np.log(alpha / (1 - alpha))], features=[[0.5, 0.5, 0.5]])


def shadow(model, light, backend="cpu", camera=CAMERA, meshes=None, **options):
    settings = PassSettings(shadows=(Shadow(light, ground() if meshes is None else meshes, **{"size": 192} | options),))
    return fg.render(model, camera, passes=("shadow",), backend=backend, settings=settings)["shadow"]


def at(image, x, y):
    return image[round(31.5 - 10 * y), round(47.5 + 10 * x)]


def centre(image):
    """Where a shadow lies on the ground."""
    dark = 1 - image
    y, x = np.mgrid[:64, :96] + 0.5
    return (dark * x).sum() / dark.sum() / 10 - 4.8, 3.2 - (dark * y).sum() / dark.sum() / 10


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_sun_casts_the_splats_shape_along_its_rays(backend):
    """The ball at height 2 in the light of a sun that stands 45 degrees high in the direction of x."""
    found = shadow(ball(1, 0.5, 2), Light.sun((1, 0, 1)), backend)
    assert centre(found) == pytest.approx((-1, 0.5), abs=0.03)
    assert found.min() == pytest.approx(0.1, abs=0.02) and found[:, -8:].min() == 1
    dark = 1 - found
    y, x = np.mgrid[:64, :96] / 10
    spread = [np.sqrt((dark * (axis - (dark * axis).sum() / dark.sum()) ** 2).sum() / dark.sum()) for axis in (x, y)]
    assert spread[0] / spread[1] == pytest.approx(np.sqrt(2), rel=0.05)  # longer by the light's slant


def test_a_lamp_nearby_enlarges_a_shadow_and_its_size_softens_it():
    lamp = Light(np.array([[0.0, 0, 4]]))
    near, far = shadow(ball(0.5, 0, 2), lamp), shadow(ball(0.5, 0, 2), Light.sun((0, 0, 1)))
    assert centre(near)[0] == pytest.approx(1.0, abs=0.03) and centre(far)[0] == pytest.approx(0.5, abs=0.03)
    assert (1 - near).sum() > 3 * (1 - far).sum()
    soft = shadow(ball(0.5, 0, 2), Light.disc((0, 0, 4), (1, 0, 0), (0, 1, 0), 64))
    assert soft.min() > near.min() + 0.2 and centre(soft)[0] == pytest.approx(1.0, abs=0.1)
    assert (1 - soft).sum() == pytest.approx((1 - near).sum(), rel=0.15)  # what is spread is not lost
    panel = shadow(ball(0.5, 0, 2), Light.rectangle((0, 0, 4), (2, 0, 0), (0, 0.01, 0), 64))
    dark = 1 - panel
    assert (dark.max(0) > 0.02).sum() > 1.5 * (dark.max(1) > 0.02).sum()  # wide along the panel alone


def test_what_casts_no_shadow_throws_none():
    both = [(ball(x, 0, 2), np.eye(4), 0.0, fg.ObjectSettings(casts=casts)) for x, casts in ((1, False), (-1, True))]
    found = shadow(both, Light.sun((0, 0, 1)))
    assert at(found, 1, 0) == 1 and at(found, -1, 0) < 0.2
    assert shadow(both[:1], Light.sun((0, 0, 1))).min() == 1


def test_splats_behind_and_on_a_surface_cast_none():
    assert shadow(ball(0, 0, -1), Light.sun((0, 0, 1))).min() == 1
    floor = fg.GaussianModel(position=[[x, y, 0.02] for x in range(-9, 10) for y in range(-9, 10)],
                             rotation=np.tile([1.0, 0, 0, 0], (361, 1)), scale=np.tile(np.log([0.5, 0.5, 0.01]), (361, 1)),
                             opacity=np.full(361, 4.0), features=np.ones((361, 3)))
    assert shadow(floor, Light.sun((0, 0, 1))).max() < 0.5
    assert shadow(floor, Light.sun((0, 0, 1)), bias=0.1).min() == 1


def test_a_table_catches_the_shadow_before_the_ground_does():
    table = ground(1.0, 1.0)
    found = shadow(ball(0, 0, 2, size=0.2), Light.sun((0, 0, 1)), meshes=np.concatenate([ground(), table]))
    assert at(found, 0, 0) < 0.2 and at(found, 3, 2) == 1
    assert shadow(ball(0, 0, 0.5, size=0.1), Light.sun((0, 0, 1)), meshes=np.concatenate([ground(), table])).min() == 1


def test_nothing_to_catch_and_nothing_to_cast():
    sun = Light.sun((0, 0, 1), 0.1)
    assert (shadow(ball(0, 0, 2), sun, meshes=ground()[:0]) == 1).all()
    assert (shadow([], sun) == 1).all()
    assert (fg.render(ball(0, 0, 2), CAMERA, passes=("shadow",))["shadow"] == 1).all()
    for wrong in (np.zeros((0, 3)), np.zeros(3), [[np.nan, 0, 0]]):
        with pytest.raises(fg.FastGSError, match="light.*points"):
            Light(wrong)
