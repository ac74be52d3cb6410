# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences of a plane sweep: of single pixels, means over windows that borders cut off, and over the better half of the pictures; and
which pictures agree with a point."""
import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.kernels.cpu.initial import averaged, better_half, project_points, sweep, vote


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


def test_a_pixel_is_compared_with_what_lies_between_four_of_the_other_picture():
    rng = np.random.default_rng(3)
    image, other = rng.uniform(0, 1, (6, 9, 3)).astype(np.float32), rng.uniform(0, 1, (7, 8, 3)).astype(np.float32)
    turn, shift = np.array([[0.9, 0.02, 0.3], [-0.03, 1.1, 0.2], [0.001, 0.0, 1.0]]), np.array([1.5, -0.7, 0.1])
    planes = np.array([[0.0, 0.0, 0.2], [0.01, -0.02, 0.8], [0.0, 0.0, -1.0]])  # the last one lies behind the camera
    expected = np.ones((3, 6, 9))
    for d, row, column in np.ndindex(expected.shape):
        pixel = np.array([column + 0.5, row + 0.5, 1.0])
        near = planes[d] @ pixel
        x, y, w = turn @ pixel + shift * near
        x, y = x / w - 0.5, y / w - 0.5
        if near > 0 and 0 <= x < 7 and 0 <= y < 6:
            i, j = int(y), int(x)
            upper, lower = (other[k, j] * (1 - x % 1) + other[k, j + 1] * (x % 1) for k in (i, i + 1))
            expected[d, row, column] = np.abs(upper * (1 - y % 1) + lower * (y % 1) - image[row, column]).mean()
    assert 60 < (expected < 1).sum() < 108 and (expected[2] == 1).all()
    np.testing.assert_allclose(sweep(image, [(other, turn, shift)], planes, 1.0, 0), expected, atol=2e-6)


@pytest.mark.parametrize("sure", [np.inf, 0.5])
def test_a_picture_agrees_with_points_or_is_against_them(sure):
    rng, count = np.random.default_rng(5), 700
    pose = np.eye(4)
    pose[:3, 3] = 0.1, -0.2, 0.3
    camera = fg.Camera(12, 9, 10.0, 11.0, 6.0, 4.5, pose)
    image, cost = rng.uniform(0, 1, (9, 12, 3)).astype(np.float32), rng.uniform(0, 1, (9, 12)).astype(np.float32)
    depth, xyz, rgb = rng.uniform(1.5, 3, (9, 12)), rng.uniform((-2, -2, -1), (2, 2, 4), (count, 3)), rng.uniform(0, 1, (count, 3))
    places, z = project_points(xyz, camera)
    seen = (z > 0) & ((places > 0) & (places < (12, 9))).all(1)
    column, row = np.where(seen[:, None], places, 0).astype(int).T
    ratio, alike = depth[row, column] / z, np.abs(image[row, column] - rgb).mean(1) < 0.3
    there = seen & (np.abs(ratio - 1) < 0.2)
    against = (there & ~alike) | (seen & (ratio > 1.4) & (cost[row, column] < sure))
    found = np.ones((2, count), int)
    vote(xyz, rgb, camera, image, depth, cost, 0.2, 0.3, sure, *found)
    assert 10 < (there & alike).sum() < against.sum() and np.array_equal(found - 1, [there & alike, against])
