# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes that crop what is shown: in every backend, in a viewport's order, and for good."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering import visibility
from fastgs_blender.rendering.crops import Crop, cropped, kept_by
from fastgs_blender.rendering.instances import Instance, ObjectSettings

CAMERA = fg.Camera(48, 40, 40, 40, 24, 20, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]))


def box(rng, remove=False):
    """A crop with a random box of medium size."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] / rng.uniform(0.6, 1.5, 3)[:, None]
    matrix[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    return Crop(matrix, remove)


def inside(crop, point) -> bool:
    x, y, z, _ = crop.matrix @ [*point, 1.0]
    return -1 <= x <= 1 and -1 <= y <= 1 and -1 <= z <= 1


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), max_size=4))
def test_boxes_to_keep_add_up_and_boxes_to_remove_win(seed, removes):
    rng = np.random.default_rng(seed)
    crops, points = [box(rng, remove) for remove in removes], rng.uniform(-1.5, 1.5, (50, 3))
    keeps = [crop for crop in crops if not crop.remove]
    for point, left in zip(points, kept_by(crops, points)):
        kept = not keeps or any(inside(crop, point) for crop in keeps)
        assert left == (kept and not any(inside(crop, point) for crop in crops if crop.remove))


def test_a_box_without_an_inside():
    nothing, points = np.full((4, 4), np.nan), np.zeros((2, 3))
    assert not kept_by([Crop(nothing)], points).any()
    assert kept_by([Crop(nothing, remove=True)], points).all()


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize("removes", [(False,), (True,), (False, False, True)])
@pytest.mark.parametrize(("basis", "temporal"), [("paper", "radial"), ("cubic", "always")])
def test_a_cropped_picture_is_that_of_what_is_left(backend, removes, basis, temporal):
    rng = np.random.default_rng(len(removes))
    model, crops = random_model(rng, 200, basis, "line", temporal, motion=0.1), [box(rng, remove) for remove in removes]
    for t in (0.2, 0.9):
        left = kept_by(crops, fg.slice_model(model, t, cull=False).position)
        assert 10 < left.sum() < 190
        wanted = fg.render(model.take(left), CAMERA, t, passes=("rgb", "alpha", "depth"), backend=backend)
        got = fg.render([(model, np.eye(4), t, crops)], CAMERA, passes=("rgb", "alpha", "depth"), backend=backend)
        for name, image in got.items():
            np.testing.assert_array_equal(image, wanted[name])


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_viewport_sorts_what_is_left(backend):
    rng = np.random.default_rng(5)
    model, crops = random_model(rng, 300, "fourier", size=0.02), (box(rng), box(rng, True))
    everything = visibility.order([Instance(model, np.eye(4), 0.4).viewed(CAMERA)], CAMERA, backend=backend)
    left = kept_by(crops, fg.slice_model(model, 0.4, cull=False).position)
    wanted = everything[left[everything]]
    assert 10 < len(wanted) < len(everything)
    cut = Instance(model, np.eye(4), 0.4, ObjectSettings(crops)).viewed(CAMERA)
    np.testing.assert_array_equal(visibility.order([cut], CAMERA, backend=backend), wanted)


def test_cropped_for_good_are_those_that_are_left_on_some_frame():
    """A row of Gaussians that move to the right, one of them seen in the first half alone; the box is at the right end."""
    x = np.array([0.0, 1.0, 2.0, 3.0, 1.0])
    model = fg.GaussianModel(
        position=np.stack([x, 0 * x, 0 * x], 1), rotation=np.tile([1.0, 0, 0, 0], (5, 1)), scale=np.full((5, 3), -3.0),
        opacity=np.full(5, 3.0), features=np.full((5, 3), 0.5), motion=np.tile([1.0, 0, 0], (5, 1, 1)), basis=fg.Polynomial(1),
        temporal_kind=fg.Window(), temporal=np.array([[-1, 2, -3, -3]] * 4 + [[-1, 0.4, -6, -6]]), clip=fg.Clip(10, 24.0))
    matrix = np.eye(4)
    matrix[0, 3] = -2.6  # from 1.6 to 3.6
    left = cropped(model, [Crop(matrix)])
    np.testing.assert_array_equal(left.position[:, 0], [1, 2, 3])
    assert left.clip == model.clip
    np.testing.assert_array_equal(cropped(model, [Crop(matrix, True)]).position[:, 0], [0, 1, 3, 1])
