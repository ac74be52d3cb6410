# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: their text, what a brush finds, and pictures without what is hidden."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats.scenes import as_seen
from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.filters import Filter
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.masks import pack_mask, unpack_mask
from fastgs_blender.selecting.shapes import Box, Lasso, Stroke, under

CAMERA = fg.Camera(48, 40, 40, 40, 24, 20, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]))


@given(st.lists(st.booleans(), max_size=300))
def test_masks_are_texts(bits):
    bits = np.array(bits, bool)
    text = pack_mask(bits)
    assert text.isascii() and text.isprintable() and bool(text) == bits.any()
    np.testing.assert_array_equal(unpack_mask(text, len(bits)), bits)
    assert not unpack_mask(text, len(bits) + 1).any()  # of another model


@pytest.mark.parametrize("text", ["8 ", "8", "x", "8 !!!", "8 " + pack_mask(np.ones(4000, bool)).split()[1], "-1 00", "8 \u20ac"])
def test_what_is_no_mask_hides_nothing(text):
    assert not unpack_mask(text, 8).any()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_brush_finds_what_lies_under_it_and_pictures_leave_it_out(backend):
    model = random_model(np.random.default_rng(2), 300, "paper", "line", "radial", motion=0.1)
    instance = Instance(model, np.eye(4), 0.4).viewed(CAMERA)
    for shape in (Box((10, 8), (24, 30)), Stroke(((12, 20), (30, 20), (30, 34)), 4.0), Stroke(((24, 20),), 6.0)):
        bits = under(instance, CAMERA, shape, backend=backend)
        s = fg.slice_model(model, 0.4)
        pixel = CAMERA.pixels(s.position + [0, 0, 4])
        if isinstance(shape, Box):
            inside = (np.abs(pixel - [17, 19]) <= [7, 11]).all(1)
        else:
            path = np.concatenate([np.linspace(a, b, 400) for a, b in zip(shape.middles, shape.middles[1:] or shape.middles)])
            inside = np.linalg.norm(pixel[:, None] - path, axis=-1).min(1) <= shape.radius
        assert 3 < bits.sum() < 200 and set(np.flatnonzero(bits)) == set(s.index[inside])
        look = ObjectSettings(mask=pack_mask(bits))
        got = fg.render([(model, np.eye(4), 0.4, look)], CAMERA, backend=backend)
        np.testing.assert_array_equal(got["rgb"], fg.render(model.take(~bits), CAMERA, 0.4, backend=backend)["rgb"])
        assert not (under(Instance(model, np.eye(4), 0.4, look).viewed(CAMERA), CAMERA, shape, backend=backend) & bits).any()


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), min_size=1, max_size=12), st.integers(0, 9))
def test_a_lasso_holds_what_its_line_goes_around_an_odd_number_of_times(points, seed):
    """By the angle through which the line is seen to turn from each pixel."""
    pixel = np.random.default_rng(seed).uniform(-1, 13, (40, 2))
    away = np.append(points, points[:1], 0) - pixel[:, None]
    before, after = away[:, :-1], away[:, 1:]
    turns = np.arctan2(before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0], (before * after).sum(-1)).sum(1) / (2 * np.pi)
    np.testing.assert_array_equal(Lasso(tuple(points)).holds(pixel), np.round(turns).astype(int) % 2 == 1)


def test_what_a_lasso_finds():
    model = random_model(np.random.default_rng(2), 300, "paper", "line", "radial", motion=0.1)
    seen = Instance(model, np.eye(4), 0.4).viewed(CAMERA)
    around = Lasso(((10, 8), (24, 8), (24, 30), (10, 30)))
    bits = under(seen, CAMERA, around)
    assert bits.sum() > 3 and np.array_equal(bits, under(seen, CAMERA, Box((10, 8), (24, 30))))


def test_exports_leave_out_what_is_hidden():
    model = random_model(np.random.default_rng(4), 200)
    bits = np.arange(200) % 3 == 0
    look = ObjectSettings(crops=[Crop(np.eye(4), shape="SPHERE", soft=0.8)], filters=[Filter("OPACITY", 0, 0.3)], mask=pack_mask(bits))
    written, _ = as_seen([Instance(model, np.eye(4), 0.0, look)])
    wanted, got = fg.render([(model, np.eye(4), 0.0, look)], CAMERA), fg.render(written, CAMERA)
    assert wanted["alpha"].max() > 0.3 and len(written) < 150
    assert np.abs(wanted["rgb"] - got["rgb"]).max() < 2e-3
