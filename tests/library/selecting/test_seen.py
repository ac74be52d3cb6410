# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a scene is seen in a shape: by the light that each Gaussian gives to the picture."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.slicing import positions_at
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.visibility import order
from fastgs_blender.selecting.light import Light
from fastgs_blender.selecting.shapes import Ball, Box, Lasso, Stroke, seen_under, touched, under
from fastgs_blender.util.rotations import transformed

CAMERA = fg.Camera(96, 80, 80, 80, 48, 40, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]))
EVERYWHERE = Box((-1e4, -1e4), (1e4, 1e4))


def wall(n: int, z: float, seed: int, opacity: float = 6.0) -> fg.GaussianModel:
    """About n Gaussians on a sheet without holes that fills the picture, all as large."""
    side = int(n**0.5)
    grid = np.stack(np.meshgrid(*[np.linspace(-4, 4, side)] * 2), -1).reshape(-1, 2)
    n = len(grid)
    jitter = np.random.default_rng(seed).uniform(-1, 1, (n, 2)) / side
    return fg.GaussianModel(position=np.c_[grid + jitter, np.full(n, z)], rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                            scale=np.full((n, 3), np.log(0.12)), opacity=np.full(n, opacity), features=np.full((n, 3), 0.5))


@given(st.integers(0, 10**6))
def test_light_is_the_gradient_of_the_picture(seed):
    """By differences: a Gaussian's light within a mask is what the picture there changes by as its colour does."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, 40, appearance="rgb", motion=0.1)
    two = [Instance(model, np.eye(4), 0.4), Instance(random_model(rng, 30, "paper"), np.diag([1.2, 0.8, 1, 1.0]), 0.1,
                                                     ObjectSettings(opacity=0.7))]
    mask = rng.random((80, 96)) < 0.5
    k = int(rng.integers(40))
    change = np.zeros((40, 3))
    change[k] = 0.5
    pictures = [fg.render([replace(two[0], model=replace(model, features=model.features + side * change)), two[1]], CAMERA)["rgb"][..., 0]
                for side in (-1, 1)]
    light = Light(two, CAMERA)
    within, whole, alone = (found[0][k] for found in (light.within(mask), light.whole, light.alone))
    difference = (pictures[1] - pictures[0]).astype(np.float64)
    for value, wanted in ((within, difference[mask].sum()), (whole, difference.sum())):
        assert value == pytest.approx(wanted, rel=1e-3, abs=2e-3)
    assert within <= whole + 1e-5 and whole <= 1.02 * alone + 0.02


def test_what_lies_behind_is_not_seen_whichever_object_it_is_of():
    """Two walls of two objects: the near one is seen and the far one is not, until the near one is hidden; it is one picture of both."""
    near, far = wall(3000, 0.0, 1), wall(3000, 1.5, 2)
    both = [Instance(model, np.eye(4), 0.0).viewed(CAMERA) for model in (far, near)]
    shape = Box((20, 20), (70, 60))
    behind, before = seen_under(both, CAMERA, shape)
    inside = under(both[1], CAMERA, shape)
    assert not behind.any() and under(both[0], CAMERA, shape).any()
    assert before.sum() > 0.5 * inside.sum() and not (before & ~inside).any()
    alone = seen_under(both[:1], CAMERA, shape)[0]
    assert alone.sum() > 100
    ball = Ball((0.0, 0.0, 0.0), 0.6)
    assert seen_under(both, CAMERA, ball)[1].sum() > 10 and not seen_under(both, CAMERA, ball)[0].any()


def test_faint_haze_is_seen_and_what_lies_behind_it_too():
    both = [Instance(model, np.eye(4), 0.0).viewed(CAMERA) for model in (wall(200, -1.0, 3, opacity=-2.5), wall(3000, 1.0, 4))]
    found = seen_under(both, CAMERA, EVERYWHERE)
    for instance, bits in zip(both, found):
        shown = under(instance, CAMERA, EVERYWHERE)
        assert bits.sum() > 0.8 * shown[np.abs(instance.model.position[:, :2]).max(1) < 1.5].sum() > 10


@given(st.integers(0, 10**6), st.lists(st.tuples(st.integers(-30, 130), st.integers(-30, 110)), min_size=3, max_size=5),
       st.sampled_from(("box", "stroke", "lasso")))
def test_a_shape_takes_the_centres_in_it_of_what_the_camera_shows(seed, points, kind):
    """However small it is and wherever it lies, beside the picture, too."""
    low, high = np.min(points, 0), np.max(points, 0)
    shape = {"box": Box(tuple(low), tuple(high)), "stroke": Stroke(tuple(points), 5.0), "lasso": Lasso(tuple(points))}[kind]
    seen = Instance(random_model(np.random.default_rng(seed), 60, motion=0.3), np.eye(4), 0.4).viewed(CAMERA)
    shown = np.isin(np.arange(60), order([seen], CAMERA))
    centre = CAMERA.pixels(transformed(positions_at(seen.model, 0.4), seen.model_to_camera))
    assert np.array_equal(under(seen, CAMERA, shape), shown & shape.holds(centre))


def test_touched_is_what_gives_its_light_in_the_stroke():
    """Of a large Gaussian that reaches far beyond the stroke nothing is meant, though its centre lies under it."""
    model = wall(3000, 0.0, 5)
    first = np.arange(len(model)) == 0
    large = replace(model, scale=np.where(first[:, None], 0.0, model.scale), opacity=np.where(first, -1, 6.0),
                    position=np.where(first[:, None], (0, 0, -0.5), model.position))
    seen = Instance(large, np.eye(4), 0.0).viewed(CAMERA)
    stroke = Stroke(((40, 40), (56, 40)), 4.0)
    found = touched([seen], CAMERA, replace(stroke, radius=8.0))[0]
    assert found.sum() > 10 and not found[0] and seen_under([seen], CAMERA, stroke)[0][0]


def test_the_rim_of_a_brush_is_not_meant():
    """What only the outer half of a brush goes over is selected, but does not say what belongs together, unless nothing else is there."""
    model = wall(3000, 0.0, 6)
    seen = Instance(model, np.eye(4), 0.0).viewed(CAMERA)
    stroke = Stroke(((40, 40), (56, 40)), 8.0)
    height = CAMERA.pixels(model.position + [0, 0, 4])[:, 1]
    meant = touched([seen], CAMERA, stroke)[0]
    assert meant.any() and np.abs(height[meant] - 40).max() < 6 < np.abs(height[seen_under([seen], CAMERA, stroke)[0]] - 40).max()
    rim = np.abs(height - 40) > 6
    edge = Instance(model.take(rim), np.eye(4), 0.0).viewed(CAMERA)
    assert touched([edge], CAMERA, stroke)[0].any()


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=9), st.integers(0, 99), st.floats(0.5, 9))
def test_a_stroke_holds_what_is_near_its_path(points, seed, radius):
    pixel = np.random.default_rng(seed).uniform(-5, 35, (60, 2))
    path = np.concatenate([np.linspace(a, b, 500) for a, b in zip(points, points[1:] or points)])
    away = np.linalg.norm(pixel[:, None] - path, axis=-1).min(1)
    held = Stroke(tuple(points), radius).holds(pixel)
    assert held[away < radius - 0.05].all() and not held[away > radius + 1e-9].any()
