# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits of a model at one time, the models between two edits, and the rotations and stretches of deformations."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.deformation import local_maps
from fastgs_blender.model.edits import Edit, mixed, state_of
from fastgs_blender.rendering.instances import Instance, Moment
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.util import rotations

CAMERA = fg.Camera(96, 64, 90, 90, 48, 32, np.eye(4))
KINDS = (
    ("paper", "line", "radial", "sh1"), ("fourier", "static", "window", "rgb"), ("paper", "line", "radial", "sigmoid"),
    ("cubic", "static", "always", "changing sh1"))


def cloud(rng, *kinds, n=200):
    model = random_model(rng, n, *kinds, size=0.15)
    return replace(model, position=model.position * [0.7, 0.5, 0.5] + [0, 0, 4])


@pytest.mark.parametrize("kinds", KINDS)
def test_an_edit_that_changes_nothing_is_the_model_at_that_time(rng, kinds):
    model = cloud(rng, *kinds)
    still = Edit(0.4).applied(model)
    before, after = (fg.render(m, CAMERA, t) for m, t in ((model, 0.4), (still, 0.0)))
    assert before["alpha"].max() > 0.5
    for name in before:
        assert np.abs(before[name] - after[name]).max() < 1e-5
    now = state_of(model, 0.4)
    same = Edit(0.4, now.position, now.scale, now.opacity, now.colour).applied(model)
    assert np.abs(fg.render(same, CAMERA)["rgb"] - before["rgb"]).max() < 1e-4


def test_an_edit_is_what_one_would_do_to_the_model_itself(rng):
    """Places, opacity, colour and size of a plain model, changed by hand; rows of NaN stay, hidden ones go."""
    model = random_model(rng, 300, "fourier", "static", "always", "rgb", size=0.15)
    model = replace(model, position=model.position * 0.5 + [0, 0, 4])
    now = state_of(model, 0.3)
    offset = 0.3 * np.sin(5 * now.position)
    share, half, gone = rng.uniform(0, 1, 300), np.arange(300) % 2 == 0, np.arange(300) % 7 == 0
    fading = np.where(half, now.opacity * share, np.nan)
    edit = Edit(0.3, now.position + offset, 0.5 * now.scale, fading, now.colour[:, ::-1], gone)
    changed = replace(model, position=model.position + offset, scale=model.scale + np.log(0.5), features=model.features[:, ::-1])
    own = fg.freeze(changed, 0.3)
    sigma = 1 / (1 + np.exp(-model.opacity.astype(np.float64))) * np.where(half, share, 1) * ~gone
    sigma = np.clip(sigma[fg.slice_model(model, 0.3).index], 1e-7, 1 - 1e-7)
    own = replace(own, opacity=np.log(sigma / (1 - sigma)))
    a, b = fg.render(edit.applied(model), CAMERA), fg.render(own, CAMERA)
    assert np.abs(a["rgb"] - b["rgb"]).max() < 1e-4 and np.abs(a["alpha"] - b["alpha"]).max() < 1e-4
    assert np.abs(a["rgb"] - fg.render(model, CAMERA, 0.3)["rgb"]).max() > 0.1


def test_at_another_time_gaussians_move_by_as_much_and_fade_by_the_same_factor(rng):
    model = cloud(rng, "paper", "line", "radial", "rgb")
    now = state_of(model, 0.2)
    moved = Edit(0.2, now.position + [0.5, 0, 0], opacity=now.opacity * 0.5).applied(model, 0.7)
    then, found = fg.slice_model(model, 0.7, cull=False), fg.slice_model(moved, 0.0, cull=False)
    assert np.abs(found.position - then.position - [0.5, 0, 0]).max() < 1e-5
    seen = then.opacity > 1e-3
    assert seen.sum() > 10 and np.allclose(found.opacity[seen], 0.5 * then.opacity[seen], rtol=1e-4)


def test_what_differs_with_the_view_fades_with_its_colour(rng):
    model = cloud(rng, "fourier", "static", "always", "sh1")
    now = state_of(model, 0.0)
    black = Edit(0.0, colour=np.zeros_like(now.colour)).applied(model)
    assert np.abs(fg.render(black, CAMERA)["rgb"]).max() < 1e-6
    brighter = Edit(0.0, colour=2 * now.colour).applied(model)
    assert np.array_equal(brighter.features[:, 3:][(now.colour > 0).all(1)], model.features[:, 3:][(now.colour > 0).all(1)])


def test_a_deformation_that_turns_and_stretches_is_the_objects_own_transform(rng):
    model = cloud(rng, "fourier", "line", "always", "rgb")
    turn = rotations.to_matrices(rotations.unit(rng.normal(size=(1, 4))))[0] @ np.diag([1.3, 0.8, 1.0])
    centre = np.array([0, 0, 4.0])
    now = state_of(model, 0.25)
    edit = Edit(0.25, (now.position - centre) @ turn.T + centre, deform=np.tile(turn, (len(model), 1, 1)))
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn, centre - turn @ centre
    a, b = fg.render(edit.applied(model), CAMERA), fg.render([(model, place, 0.25)], CAMERA)
    assert np.abs(a["rgb"] - b["rgb"]).max() < 2e-3


def test_between_two_edits_lies_the_mean(rng):
    model = cloud(rng, "fourier", "line", "always", "rgb")
    now = state_of(model, 0.5)
    a, b = (Edit(0.5, now.position + [x, 0, 0], opacity=now.opacity * x).applied(model) for x in (0.2, 0.6))
    half = mixed(a, 0.0, b, 0.0, 0.5)
    s = fg.slice_model(half, 0.0, cull=False)
    assert np.allclose(s.position, now.position + [0.4, 0, 0], atol=1e-5) and np.allclose(s.opacity, 0.4 * now.opacity, atol=1e-5)
    assert np.allclose(np.abs((s.rotation * fg.slice_model(model, 0.5, cull=False).rotation).sum(1)), 1, atol=1e-5)


def test_vectors_follow_edits(rng):
    """Edited by a step to the right on each frame, all Gaussians move by so many pixels."""
    model = cloud(rng, "static", "static", "always", "rgb")
    now = state_of(model, 0.0)

    def at(step):
        return Instance(Edit(0.0, now.position + [step, 0, 0]).applied(model), np.eye(4), 0.0, place="one", origin=model)

    moments = [Moment({"one": at(step)}, CAMERA) for step in (-0.1, 0.1)]
    found = fg.render([at(0.0)], CAMERA, passes=("alpha", "vector", "depth"), settings=PassSettings(before=moments[0], after=moments[1]))
    seen = found["alpha"] > 0.99
    expected = 90 * 0.1 / found["depth"][seen]
    assert seen.any() and np.abs(-found["vector"][seen][:, 0] - expected).max() < 0.1 * expected.max()


def test_wrong_shapes_are_told(rng):
    model = cloud(rng, "static", "static", "always", "rgb")
    with pytest.raises(fg.FastGSError, match="position"):
        Edit(0.0, position=np.zeros((3, 3))).applied(model)


@pytest.mark.parametrize("flat", [False, True])
def test_local_maps_of_an_affine_map(rng, flat):
    """In space, and of a surface: across it, neighbours say nothing, and the map turns as the surface does."""
    points = rng.uniform(-1, 1, (4000, 3)) * [1, 1, 0 if flat else 1]
    turn = rotations.to_matrices(rotations.unit(rng.normal(size=(1, 4))))[0]
    matrix = turn if flat else turn @ np.array([[1.2, 0.3, 0], [0, 0.9, 0.1], [0, 0, 1.1]])
    found = local_maps(points, points @ matrix.T + [5, 6, 7])
    assert np.abs(found - matrix).max() < 5e-3


def test_local_maps_of_a_twist(rng):
    points = rng.uniform(-1, 1, (20_000, 3))
    c, s = np.cos(points[:, 2]), np.sin(points[:, 2])
    twisted = np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], points[:, 2]], 1)
    found = local_maps(points, twisted)
    inner = (np.abs(points) < 0.8).all(1)
    exact = np.zeros((len(points), 3, 3))
    exact[:, 0, 0], exact[:, 0, 1], exact[:, 1, 0], exact[:, 1, 1], exact[:, 2, 2] = c, -s, s, c, 1
    exact[:, 0, 2], exact[:, 1, 2] = -twisted[:, 1], twisted[:, 0]
    assert np.abs(found - exact)[inner].mean() < 0.03


def test_points_alone_and_broken_ones_are_not_turned():
    points = np.array([[0.0, 0, 0], [100, 0, 0], [np.nan, 0, 0]])
    assert np.array_equal(local_maps(points, points * 2), np.tile(np.eye(3), (3, 1, 1)))
