# SPDX-License-Identifier: GPL-3.0-or-later
"""How thick Gaussians are towards a lamp, places on them, and what of the world a lamp looks at."""
import numpy as np
import pytest

from fastgs_blender.rendering.spots import FAINT, MANY, SLIGHT, Spots, evenly
from fastgs_blender.util.backends import load_backend

BACKENDS = [load_backend(name) for name in ("cpu", "reference")]


def gaussians(count=500):
    rng = np.random.default_rng(5)
    turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    axes = (turns * np.exp(rng.uniform(-6, 1, (count, 1, 3)))).transpose(1, 2, 0)
    return rng.uniform(-2, 2, (3, count)), np.ascontiguousarray(axes)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_gaussian_is_as_thick_as_its_axis_and_places_lie_on_its_two_longest(backend):
    axes = np.diag([3.0, 0.5, 2.0])[:, :, None]
    for direction, thickness in (([1, 0, 0], 3), ([0, -2, 0], 0.5), ([0, 0, 1], 2)):
        found, places = backend.spread(np.ones((3, 1)), axes, np.array(direction, float), True, np.array([[1.0, 0], [0, 0.5]]))
        assert np.allclose(found, thickness)
    assert np.allclose(places[..., 0].T, [[1, 1, 3], [2.5, 1, 1]])
    near, _ = backend.spread(np.ones((3, 1)), axes, np.array([1.0, 9, 1]), False, np.zeros((1, 2)))
    assert np.allclose(near, 0.5)


@pytest.mark.parametrize("parallel", [False, True])
def test_kernels_agree_with_numpy(parallel):
    position, axes = gaussians()
    view = np.concatenate([np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0], [[0.1], [0.2], [0.5]]], 1)
    found = [(*backend.spread(position, axes, np.array([0.3, 1.0, -2.0]), parallel, evenly(np.arange(4))),
              backend.view_box(position, view, parallel)) for backend in BACKENDS]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_lies_behind_a_lamp_is_not_looked_at(backend):
    points, view = np.array([[0.0, 9, 4], [1, 9, 2], [2, -1, 4]]), np.eye(4)[:3]
    assert np.allclose(backend.view_box(points, view, False), [[0, 0.5, 2], [1, 0.5, 4]])
    assert not np.isfinite(backend.view_box(-np.abs(points), view, False)).all()
    assert np.allclose(backend.view_box(points, view, True), [[0, 1, -1], [9, 9, 4]])


def test_gaussians_ask_as_many_points_of_a_lamp_as_they_show():
    """Those that make much of a pixel ask all, others a half or a quarter; each point is asked by as many of these, and none twice."""
    shares = np.repeat([1.0, (FAINT + SLIGHT) / 2, FAINT / 2], 8).astype(np.float32)
    spots = Spots(np.zeros((3, 24)), np.zeros((3, 24)), np.zeros((3, 3, 24)), np.arange(24), np.zeros(24, int), shares, ())
    for count in (MANY, MANY + 5, 2 * MANY):
        asked = np.zeros((24, count), int)
        for points, rows in spots.asking(count):
            asked[np.ix_(rows, points)] += 1
        assert (asked.max() == 1) and (asked[:8] == 1).all()
        assert np.allclose(asked[8:16].mean(1), 0.5, atol=1 / count) and np.allclose(asked[16:].mean(1), 0.25, atol=1 / count)
        assert (asked[8:16].sum(0) == 4).all() and (asked[16:].sum(0) == 2).all()
    (points, rows), = spots.asking(MANY - 1)
    assert len(points) == MANY - 1 and len(rows) == 24
