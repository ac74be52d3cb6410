# SPDX-License-Identifier: GPL-3.0-or-later
"""The curve that gives highlights the brightness of light."""
import numpy as np
import pytest

from fastgs_blender.rendering.colour import LIFTED_FROM, lifted


def test_white_becomes_light_and_dark_colours_stay():
    dark = np.random.default_rng(0).uniform(0, LIFTED_FROM, (50, 3))
    np.testing.assert_array_equal(lifted(dark, 4.0), dark)
    np.testing.assert_allclose(lifted(np.array([[1, 0.5, 0.25], [2, 1, 1]]), 4.0), [[4, 2, 1], [8, 4, 4]])
    assert lifted(np.array([0.75, 0.0, 0.0]), 4.0) == pytest.approx([0.75 * 2.5, 0, 0])
    np.testing.assert_array_equal(lifted(np.ones((2, 2, 3)), 1.0), np.ones((2, 2, 3)))


def test_it_rises_and_keeps_hues():
    grey = np.linspace(0, 1.5, 301)[:, None] * [1, 0.6, 0.2]
    found = lifted(grey, 8.0)
    assert (np.diff(found, axis=0) > 0).all()
    np.testing.assert_allclose(found[1:, 1] / found[1:, 0], 0.6)
