# SPDX-License-Identifier: GPL-3.0-or-later
"""From where a model was filmed, as the shapes of its Gaussians tell."""
from __future__ import annotations

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.model.filmed_from import BAKED, filmed_from
from fastgs_blender.util.rotations import from_matrices

N = 4000
UP = np.array([0.0, 0.0, 1.0])
EYE, MIDDLE = np.array([-2.0, -14.0, 1.5]), np.array([1.0, 1.0, 0.5])


def needles(rng, places, axes, length=0.3):
    """A model of long, thin Gaussians with their longest axes as given [N, 3]."""
    first = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    second = np.cross(first, rng.normal(size=first.shape))
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    turns = np.stack([first, second, np.cross(first, second)], -1)
    sizes = np.log(np.array([length, 0.05, 0.04])) + rng.normal(0, 0.1, (len(first), 3))
    return fg.GaussianModel(position=places, rotation=from_matrices(turns), scale=sizes, opacity=np.full(len(first), 2.0),
                            features=np.full((len(first), 3), 0.5))


@pytest.fixture
def cloud(rng):
    return MIDDLE + rng.uniform(-3, 3, (N, 3))


def towards_cameras(rng, cloud, share=0.4, spread=1.5):
    """Axes [N, 3]: a share of them points at one of twelve cameras around EYE, the others anywhere."""
    cameras = EYE + rng.normal(0, spread, (12, 3)) * (1, 0.3, 1)
    axes = cameras[rng.integers(0, 12, N)] - cloud
    return np.where(rng.random((N, 1)) < share, axes / np.linalg.norm(axes, axis=1, keepdims=True), rng.normal(size=(N, 3)))


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_long_gaussians_tell_where_cameras_stood(rng, cloud, share):
    model = needles(rng, cloud, towards_cameras(rng, cloud, share))
    eye, middle = filmed_from(model, 0.5, UP)
    away = np.linalg.norm(EYE - MIDDLE)
    assert np.linalg.norm(middle - MIDDLE) < 0.3
    assert np.linalg.norm(eye - EYE) < 0.35 * away and (eye - middle) @ (EYE - MIDDLE) > 0.98 * away * np.linalg.norm(eye - middle)
    assert all(np.array_equal(a, b) for a, b in zip((eye, middle), filmed_from(model, 0.5, UP), strict=True))


def test_strays_and_the_backdrop_do_not_matter(rng, cloud):
    model = needles(rng, cloud, towards_cameras(rng, cloud))
    model.position[::10] = 400 * rng.normal(size=(N // 10, 3))
    assert np.linalg.norm(filmed_from(model, 0.5, UP)[0] - EYE) < 5


@pytest.mark.parametrize(("middle", "found"), [((6.0, 9.0, -2.0), True), ((0.5, 1.0, 9.0), False), ((2.0, 3.0, 0.0), False),
                                                ((30.0, 9.0, 0.0), False)], ids=["beside", "above", "around", "far"])
def test_the_origin_is_among_the_cameras_of_what_lies_beside_it(rng, cloud, middle, found):
    """Not of a model that stands upon it, is around it, or was put far away; whatever shapes the Gaussians have."""
    model = needles(rng, cloud - MIDDLE + middle, rng.normal(size=(N, 3)))
    place = filmed_from(model, 0.5, UP)
    assert (place is not None) == found
    if found:
        assert np.array_equal(place[0], np.zeros(3)) and np.linalg.norm(place[1] - middle) < 0.3


def test_nobody_has_filmed_a_bake(rng, cloud):
    model = needles(rng, cloud - MIDDLE + (6.0, 9.0, -2.0), towards_cameras(rng, cloud))
    model.provenance = {"source": BAKED}
    assert filmed_from(model, 0.5, UP) is None


@pytest.mark.parametrize("kind", ["anywhere", "parallel", "upright", "round", "few", "amid"])
def test_nothing_is_told_where_nothing_tells(rng, cloud, kind):
    axes = {"anywhere": rng.normal(size=(N, 3)), "parallel": (1.0, 0.2, 0.0) + rng.normal(0, 0.1, (N, 3)),
            "upright": UP + rng.normal(0, 0.1, (N, 3)), "amid": cloud - MIDDLE}.get(kind, EYE - cloud)
    model = needles(rng, cloud, axes, length=0.06 if kind == "round" else 0.3)
    assert filmed_from(model.take(np.arange(400)) if kind == "few" else model, 0.5, UP) is None
