# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of a surface's points: which is nearest to a place, as all of them tell, and how the surface lies there."""
import numpy as np
import pytest

from fastgs_blender.stitching.skins import Cells


def some(seed=0, count=900):
    """Points and colours [P, 6] of a wavy floor, on both sides of the origin."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-2, 2, (2, count))
    return np.stack([x, y, 0.2 * np.sin(2 * x), *rng.normal(size=(3, count))], 1)


def test_the_nearest_cell_is_found_up_to_an_edge_away():
    cells, places = Cells.of(some(), 0.25), np.random.default_rng(1).uniform(-2.6, 2.6, (400, 3)) * [1, 1, 0.3]
    found, away = cells.nearest(places)
    every = np.linalg.norm(cells.place[None] - places[:, None], axis=2)
    assert (np.abs(away - every.min(1)) < 1e-12)[every.min(1) < cells.edge].all() and np.isinf(away).any()
    assert (found == every.argmin(1))[every.min(1) < cells.edge].all()


def test_cells_know_how_the_surface_lies():
    points = some()
    cells = Cells.of(points, 0.25)
    slope = 0.4 * np.cos(2 * cells.place[:, 0])
    true = np.stack([-slope, 0 * slope, 1 + 0 * slope], 1) / np.sqrt(1 + slope**2)[:, None]
    inside = np.abs(cells.place[:, :2]).max(1) < 1.7
    assert np.median(np.abs((cells.normal * true).sum(1))[inside]) > 0.98 and np.median(cells.flat[inside]) > 0.7


@pytest.mark.parametrize("far", [1e-9, 1e9])
def test_points_far_beyond_all_cells_have_none_near(far):
    cells = Cells.of(some() * [far] * 6, 0.25)
    assert np.isfinite(cells.place).all() and np.isinf(cells.nearest(np.full((1, 3), 3e3))[1]).all()
