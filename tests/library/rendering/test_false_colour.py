# SPDX-License-Identifier: GPL-3.0-or-later
"""What passes look like in viewports: what the numbers say can be seen, and what is not there is black."""
from __future__ import annotations

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering import cryptomatte, false_colour
from fastgs_blender.rendering.passes import PASSES

CAMERA = fg.Camera(32, 24, 40, 40, 16, 12, np.eye(4))


def test_every_pass_has_a_look_within_the_screens_range():
    found = fg.render(random_model(np.random.default_rng(0), 50), CAMERA, 0.3, passes=PASSES)
    assert found["alpha"].max() > 0.1
    for name, entry in PASSES.items():
        if entry.colour:
            continue
        shown = entry.display(found[name])
        assert shown.shape == (*found["alpha"].shape, 3), name
        assert np.isfinite(shown).all() and shown.min() >= 0 and shown.max() <= 1 and entry.shows, name
        empty = entry.display(np.full(found[name].shape, entry.empty, np.float32))
        assert (empty == (1 if entry.empty == 1 else 0)).all(), name


def test_near_is_bright_and_far_is_not_black():
    shown = false_colour.near_to_far(np.array([[1.0, 2.0, 3.0, np.inf]], np.float32))
    assert (np.diff(shown[0, :, 0]) < 0).all() and shown[0, 0, 0] == pytest.approx(1, abs=0.05) and shown[0, 2, 0] > 0.1
    assert (shown[0, 3] == 0).all()
    assert false_colour.near_to_far(np.full((2, 2), 5.0)).min() > 0.9, "one depth is all near"


def test_motion_is_a_hue_by_its_direction_and_brighter_the_faster():
    """Blender's third and fourth number point from the next frame back."""
    way = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (0.5, 0), (0, 0)]) * 10
    shown = false_colour.motion(np.concatenate([np.zeros((6, 2)), -way], 1)[None])[0]
    assert shown[0] == pytest.approx((1, 0, 0), abs=0.03), "to the right is red"
    assert len({tuple(np.round(row, 3)) for row in shown[:4]}) == 4
    assert shown[4] == pytest.approx(shown[0] / 2, abs=0.03) and not shown[5].any()
    slow = false_colour.motion(np.full((2, 2, 4), 0.05))
    assert slow.max() < 0.2, "what hardly moves stays dark"


def test_numbers_and_objects_have_colours_that_differ():
    shown = false_colour.numbered(np.arange(6, dtype=np.float32)[None])[0]
    assert not shown[0].any()
    apart = np.linalg.norm(shown[1:, None] - shown[None, 1:], axis=-1) + 10 * np.eye(5)
    assert apart.min() > 0.3
    shares = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]]], np.float32)
    mattes = false_colour.mattes(cryptomatte.level(shares, ["Robot", "Kitchen", "Dog"], 0))[0]
    assert np.linalg.norm(mattes[0] - mattes[1]) > 0.3
    assert mattes[2] == pytest.approx(mattes[1] / 2) and not mattes[3].any()


def test_heat_grows_with_the_count():
    shown = false_colour.heat(np.arange(200, dtype=np.float32)[None])[0].sum(-1)
    assert shown[0] == 0 and (np.diff(shown)[:190] > 0).all() and shown[-1] > 2.5
