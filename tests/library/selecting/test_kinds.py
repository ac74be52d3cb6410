# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of Gaussians: what moves at any time of a clip is chosen for all of it."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import touching_scenes as scenes
from moving_meshes import grid, sphere
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering.filters import parting
from fastgs_blender.selecting.kinds import KINDS, chosen

pytestmark = pytest.mark.filterwarnings("ignore:the motion")


def rolls_and_stops(count=2000):
    """A ball rolls over a floor, slows down and lies still; half of its Gaussians show it rolling, the others lying, as training makes
    them."""
    t = np.linspace(0, 1, scenes.FRAMES)
    way = 0.8 * (1 - (1 - np.minimum(t / 0.6, 1)) ** 2)
    points, triangles = sphere(16)
    ball = scenes.turning(points * 0.2, way / 0.2, 1) + np.stack([-0.6 + way, 0 * t, 0.2 + 0 * t], 1)[:, None]
    things = {"floor": scenes.Thing(*scenes.floor(), (0.5, 0.35, 0.2)), "ball": scenes.Thing(ball, triangles, (0.6, 0.3, 0.25))}
    scene = scenes.baked(things, ("ball",), count)
    seen = np.tile([-1, 2, -4.0, -4.0], (count, 1))
    seen[np.flatnonzero(scene.truth)[::2]] = -1, 0.6, -4, -3.5
    seen[np.flatnonzero(scene.truth)[1::2]] = 0.55, 2, -3.5, -4
    return replace(scene.model, temporal_kind=fg.Window(), temporal=seen), scene.truth


def test_a_ball_that_stops_is_chosen_whole():
    model, ball = rolls_and_stops()
    moving = chosen(model, "MOVING")
    assert (moving & ball).sum() >= 0.9 * (moving | ball).sum()
    assert (chosen(model, "STATIC") == ~moving).all()


def test_slow_things_move_beside_fast_ones():
    """A box at a quarter of a ball's speed, on a floor."""
    t = np.linspace(0, 1, scenes.FRAMES)
    points, triangles = sphere(12)
    corners, faces = scenes.box((-0.8, 0.3, 0), (-0.4, 0.7, 0.4))
    scene = scenes.baked({
        "floor": scenes.Thing(scenes.still((grid(12)[0] - 0.5) * [4, 4, 0]), grid(12)[1], (0.5, 0.35, 0.2)),
        "ball": scenes.Thing(scenes.moved(points * 0.2, np.stack([-1 + 2 * t, 0 * t, 0.2 + 0 * t], 1)), triangles, (0.6, 0.3, 0.25)),
        "box": scenes.Thing(scenes.moved(corners, np.stack([0.5 * t, 0 * t, 0 * t], 1)), faces, (0.2, 0.3, 0.6))}, ("ball", "box"), 3000)
    assert np.mean(chosen(scene.model, "MOVING") == scene.truth) > 0.99
    assert np.mean(KINDS["MOVING"].filter(scene.model).holds(scene.model) == scene.truth) > 0.99


def test_walls_that_drift_stand_still():
    """As trained ones do: each Gaussian its own way, a third as fast as the ball, and hardly farther than it is large."""
    t = np.linspace(0, 1, scenes.FRAMES)
    points, triangles = sphere(12)
    wall = ((grid(16)[0] - [0.5, 0, 0]) * [6, 3, 1])[:, [0, 2, 1]] + [0, 1.5, 0]
    scene = scenes.baked({
        "wall": scenes.Thing(scenes.still(wall), grid(16)[1], (0.6, 0.55, 0.5)),
        "ball": scenes.Thing(scenes.moved(points * 0.3, np.stack([1.5 * t - 0.75, 0 * t, 0.5 + 0 * t], 1)), triangles, (0.6, 0.3, 0.25)),
    }, ("ball",), 3000)
    motion = scene.model.motion.astype(np.float32)
    motion[~scene.truth] = 0
    motion[~scene.truth, 0] = np.random.default_rng(0).normal(size=((~scene.truth).sum(), 3)) * 0.15
    model = replace(scene.model, motion=motion, scale=np.where(scene.truth[:, None], scene.model.scale, np.log(0.3)).astype(np.float32))
    moving = chosen(model, "MOVING")
    assert (moving & scene.truth).sum() >= 0.99 * (moving | scene.truth).sum()


def test_few_fast_specks_do_not_raise_the_speed():
    """Seven of a hundred numbers are large and hardly seen; what is seen parts 0 from 1."""
    value = np.concatenate([np.zeros(63), np.ones(30), np.linspace(5, 20, 7)])
    assert 0 < parting(value, np.where(value > 1, 0.01, 1.0)) < 1 < parting(value)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_where_nothing_moves_nothing_is_chosen(count):
    model = random_model(np.random.default_rng(0), count)
    assert not chosen(model, "MOVING").any() and chosen(model, "STATIC").all()


def test_a_sky_is_neither_floaters_nor_large():
    """Its Gaussians lie far apart and are the largest of all."""
    rng, sky, alone = np.random.default_rng(0), slice(3000, 3300), slice(3300, 3303)
    place, scale = rng.uniform(-1, 1, (3303, 3)), np.full((3303, 3), -3.0) + rng.uniform(0, 0.5, (3303, 1))
    place[:3000, 1:] *= 0.02  # a rod, so that there are many in every cell
    place[sky] *= 30 / np.linalg.norm(place[sky], axis=1, keepdims=True)
    place[alone], scale[sky] = 8 * np.eye(3), 1.5
    around = fg.Surroundings(backdrop=fg.Backdrop((0.0, 0, 0), 20.0))
    whole = replace(random_model(rng, 3303), position=place, scale=scale, surroundings=around)
    bits = chosen(whole, "FLOATERS")
    assert bits[alone].all() and not bits[sky].any() and bits.mean() < 0.05
    bits = chosen(whole, "LARGE")
    assert not bits[sky].any() and 20 < bits.sum() < 60
    without = replace(whole, surroundings=fg.Surroundings())
    assert chosen(without, "FLOATERS")[sky].mean() > 0.5 and chosen(without, "LARGE")[sky].any()
