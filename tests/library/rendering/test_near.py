# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that reach the camera's plane: they do not cover the picture of a camera that flies through a model."""
from __future__ import annotations

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.model.slicing import slice_model
from fastgs_blender.rendering import oracle
from fastgs_blender.rendering.instances import AS_TRAINED, Instance, ObjectSettings
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.util import rotations

CAMERA = fg.Camera(48, 27, 40, 40, 24, 13.5, np.eye(4))


def beside(seed: int, n: int = 150) -> fg.GaussianModel:
    """Gaussians of all forms around the camera, from the plane of its eye to where it sees them well."""
    rng = np.random.default_rng(seed)
    return fg.GaussianModel(position=np.c_[rng.uniform(-1.5, 1.5, (n, 2)), rng.uniform(0.02, 1.5, n)], rotation=rng.normal(size=(n, 4)),
                            scale=np.log(0.02) + rng.uniform(0, np.log(50), (n, 3)), opacity=np.full(n, 2.2), features=np.ones((n, 3)),
                            raster=fg.Raster(near=0.0))


def densest(model, camera) -> np.ndarray:
    """Alpha [n, h, w] of each Gaussian by its greatest density on each pixel's ray: what a projection approximates."""
    s = slice_model(model, 0.0)
    factor = rotations.to_matrices(s.rotation) * s.scale[:, None, :]
    rays = camera.rays(np.eye(4))[1]
    inverse = np.linalg.inv(factor)
    across, centre = np.einsum("nij,hwj->nhwi", inverse, rays), np.einsum("nij,nj->ni", inverse, s.position)
    along = np.maximum(np.einsum("nhwi,ni->nhw", across, centre) / (across**2).sum(-1), 0)
    distance = along[..., None] * across - centre[:, None, None]
    alpha = s.opacity[:, None, None] * np.exp(-0.5 * (distance**2).sum(-1))
    return np.where(alpha >= 1 / 255, alpha, 0)


def drawn(model, settings) -> np.ndarray:
    """Alpha [n, h, w] of each Gaussian, drawn alone."""
    pictures = []
    for i in range(len(model)):
        viewed = Instance(model.take(np.array([i])), np.eye(4), 0.0, settings).viewed(CAMERA)
        pictures.append(oracle.rasterise(oracle.project(viewed, CAMERA, Layout([viewed], False)), CAMERA)[1])
    return np.array(pictures)


def test_what_reaches_the_cameras_plane_beside_the_picture_does_not_explode():
    """By the densest point on each ray: what covers pixels where nothing is becomes less by a third, and no more is missing."""
    model = beside(1)
    truth, bent, straight = densest(model, CAMERA), drawn(model, ObjectSettings()), drawn(model, AS_TRAINED)
    over, before = (np.maximum(found - truth, 0).sum((1, 2)) for found in (bent, straight))
    assert over.sum() < 0.67 * before.sum() and over.max() < 0.8 * before.max()
    missing, missed = (np.maximum(truth - found, 0).sum() for found in (bent, straight))
    assert missing < 1.1 * missed


def test_backends_agree_on_it():
    model = beside(2, 60)
    wanted = fg.render(model, CAMERA, passes=("rgb", "depth"), backend="reference")
    found = fg.render(model, CAMERA, passes=("rgb", "depth"))
    assert wanted["rgb"].max() > 0.5
    np.testing.assert_allclose(found["rgb"], wanted["rgb"], atol=1e-5)
    np.testing.assert_allclose(found["depth"], wanted["depth"], rtol=1e-4)


def projected(model, settings) -> oracle.Splats:
    viewed = Instance(model, np.eye(4), 0.0, settings).viewed(CAMERA)
    return oracle.project(viewed, CAMERA, Layout([viewed], False))


def test_ordinary_gaussians_are_projected_as_they_were():
    """Whatever lies more than REACH standard deviations before the camera's plane, or within the Jacobian's range."""
    rng = np.random.default_rng(3)
    n = 300
    model = fg.GaussianModel(position=np.c_[rng.uniform(-4, 4, (n, 2)), rng.uniform(1, 4, n)], rotation=rng.normal(size=(n, 4)),
                             scale=rng.uniform(-5, -1.5, (n, 3)), opacity=np.full(n, 2.2), features=np.ones((n, 3)))
    bent, straight = (vars(projected(model, settings)) for settings in (ObjectSettings(), AS_TRAINED))
    assert len(bent["mean"]) > 250
    for name, values in bent.items():
        np.testing.assert_array_equal(values, straight[name], name)
    within = beside(4, 400)
    z = within.position[:, 2]
    within = within.take(np.flatnonzero((np.abs(within.position[:, :2]) < 0.3 * z[:, None]).all(1)))
    bent, straight = (projected(within, settings).covariance for settings in (ObjectSettings(), AS_TRAINED))
    assert len(bent) > 5
    np.testing.assert_array_equal(bent, straight)


@pytest.mark.parametrize("x", [0.4, 1.0])
def test_a_gaussian_that_is_passed_changes_without_a_jump(x):
    """The camera flies by in steps of a hundredth of the Gaussian's size."""
    depth = np.arange(1.6, 0.02, -0.003)
    pictures = []
    for z in depth:
        model = fg.GaussianModel(position=[[x, 0.1, z]], rotation=[[0.9, 0.1, 0.3, 0.2]], scale=np.log([[0.3, 0.1, 0.25]]), opacity=[2.2],
                                 features=[[1.0, 1, 1]], raster=fg.Raster(near=0.0))
        pictures.append(fg.render(model, CAMERA, passes=("alpha",))["alpha"])
    pictures = np.array(pictures)
    assert pictures.max() > 0.3
    assert np.abs(np.diff(pictures, axis=0)).max() < 0.08
