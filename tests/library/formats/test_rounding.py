# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding where bits are worth more than the error: the best whole numbers, alone and as differences."""
from __future__ import annotations

import numpy as np

from fastgs_blender.formats import rounding


def best(x: float, pull: float) -> float:
    """The least cost of any whole number."""
    codes = np.arange(-60, 61)
    return float(np.min((x - codes) ** 2 + pull * np.log1p(np.abs(codes))))


def test_the_cheapest_whole_number_is_found():
    rng = np.random.default_rng(0)
    x, pull = rng.laplace(0, 8, 4000).clip(-50, 50), np.exp2(rng.uniform(-3, 10, 4000))
    codes = rounding.rounded(x, pull)
    cost = (x - codes) ** 2 + pull * np.log1p(np.abs(codes))
    least = np.array([best(*pair) for pair in zip(x, pull, strict=True)])
    assert np.all(cost <= 1.02 * least + 1e-9), np.max(cost / least)
    assert np.mean(codes == 0) > np.mean(np.rint(x) == 0) + 0.3


def test_without_pull_it_is_plain_rounding():
    x = np.random.default_rng(1).normal(0, 20, 1000)
    np.testing.assert_array_equal(rounding.rounded(x, np.zeros(1000)), np.rint(x))


def test_differences_do_not_add_their_errors_up():
    rng = np.random.default_rng(2)
    values, step = np.cumsum(rng.normal(0, 3, (500, 2)), axis=0), np.exp2(rng.integers(-2, 2, (500, 1)))
    near = np.cumsum(rounding.chained(values, step, np.zeros((500, 2))) * step, axis=0)
    assert np.all(np.abs(near - values) <= step / 2 + 1e-9)
    coarse = rounding.chained(values, step, np.full((500, 2), 3.0))
    assert np.all(np.abs(np.cumsum(coarse * step, axis=0) - values) < 4 * step) and np.mean(coarse == 0) > 0.2


def test_pulls_grow_with_what_a_number_may_be_off():
    own, step = np.array([1.0, 2.0, 1e6]), np.ones(3)
    np.testing.assert_allclose(rounding.pulls(own, step), np.array([1, 4, rounding.EASIEST**2]) * rounding.TAIL / 6)
