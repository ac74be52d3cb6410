# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences of a plane sweep: means over windows that a picture's borders cut off, and over the better half of the pictures."""
import numpy as np
import pytest

from fastgs_blender.kernels.cpu.initial import averaged, better_half


@pytest.mark.parametrize(("height", "width", "reach"), [(7, 9, 2), (12, 33, 5), (5, 3, 5), (1, 8, 2), (4, 4, 0)])
def test_each_pixel_has_the_mean_of_its_window(height, width, reach):
    cost = np.random.default_rng(height).uniform(0, 1, (2, height, width)).astype(np.float32)
    expected = [[[plane[max(i - reach, 0):i + reach + 1, max(j - reach, 0):j + reach + 1].mean(dtype=np.float64) for j in range(width)]
                 for i in range(height)] for plane in cost]
    averaged(cost, reach, np.empty((height, width), np.float32))
    np.testing.assert_allclose(cost, expected, rtol=1e-6)


@pytest.mark.parametrize("number", [1, 2, 3, 4, 8])
def test_the_better_half_of_the_pictures_counts(number):
    costs = np.random.default_rng(number).uniform(0, 1, (number, 700)).astype(np.float32)
    expected = []
    for column in costs.T:
        half = max((np.count_nonzero(column < 0.5) + 1) // 2, min((number + 1) // 2, 2))
        expected.append(np.sort(column)[:half].mean(dtype=np.float64))
    np.testing.assert_allclose(better_half(costs, np.float32(0.5), np.empty(700, np.float32)), expected, rtol=1e-6)
