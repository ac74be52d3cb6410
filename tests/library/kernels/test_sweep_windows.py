# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences of a plane sweep are averaged over windows, which the borders of a picture cut off."""
import numpy as np
import pytest

from fastgs_blender.kernels.cpu.initial import averaged


@pytest.mark.parametrize(("height", "width", "reach"), [(7, 9, 2), (12, 33, 5), (5, 3, 5), (1, 8, 2), (4, 4, 0)])
def test_each_pixel_has_the_mean_of_its_window(height, width, reach):
    cost = np.random.default_rng(height).uniform(0, 1, (2, height, width)).astype(np.float32)
    expected = [[[plane[max(i - reach, 0):i + reach + 1, max(j - reach, 0):j + reach + 1].mean(dtype=np.float64) for j in range(width)]
                 for i in range(height)] for plane in cost]
    averaged(cost, reach, np.empty((height, width), np.float32))
    np.testing.assert_allclose(cost, expected, rtol=1e-6)
