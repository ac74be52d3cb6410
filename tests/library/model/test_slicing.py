# SPDX-License-Identifier: GPL-3.0-or-later
"""Bases of time, temporal opacity and slicing."""
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.model.appearance import sh_basis
from fastgs_blender.model.motion import basis_from_dict, basis_to_dict

NAMES = sorted(BASES)


def test_fourier_is_the_papers_equation(rng):
    """mu(t) = mu_base + sum_k A_k sin(2 pi k t) + B_k cos(2 pi k t) (eq. 3-4), coefficients interleaved."""
    model = random_model(rng, 7, fg.Fourier(5))
    t = 0.37
    wanted = model.position.astype(float)
    for k in range(1, 6):
        sine, cosine = model.motion[:, 2 * k - 2].astype(float), model.motion[:, 2 * k - 1].astype(float)
        wanted = wanted + sine * np.sin(2 * np.pi * k * t) + cosine * np.cos(2 * np.pi * k * t)
    np.testing.assert_allclose(fg.slice_model(model, t, cull=False).position, wanted, rtol=1e-12)


def test_rotation_and_opacity_are_the_papers(rng):
    """Eq. 7 with n_q = 1 and eq. 6."""
    model = random_model(rng, 9, "paper", fg.Polynomial(1), "radial")
    s = fg.slice_model(model, 0.8, cull=False)
    delta = 0.8 - model.mu_tau.astype(float)
    q = model.rotation + model.rotation_motion[:, 0] * delta[:, None]
    np.testing.assert_allclose(s.rotation, q / np.linalg.norm(q, axis=1, keepdims=True), rtol=1e-12)
    wanted = 1 / (1 + np.exp(-model.opacity.astype(float))) * np.exp(-np.exp(model.temporal[:, 0].astype(float)) * delta**2)
    np.testing.assert_allclose(s.opacity, wanted, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_velocity_is_the_derivative(rng, name):
    model = random_model(rng, 20, name)
    h = 1e-6
    for t in (0.111, 0.43, 0.77):
        before, now, after = (fg.slice_model(model, t + d, cull=False) for d in (-h, 0, h))
        np.testing.assert_allclose(now.velocity, (after.position - before.position) / (2 * h), rtol=1e-5, atol=1e-6)


@given(t=st.floats(-3, 3), name=st.sampled_from(NAMES))
def test_any_time_gives_finite_gaussians(t, name):
    model = random_model(np.random.default_rng(1), 10, name, name, "window")
    s = fg.slice_model(model, t, cull=False)
    assert all(np.isfinite(v).all() for v in vars(s).values())
    np.testing.assert_allclose(np.linalg.norm(s.rotation, axis=1), 1)


@pytest.mark.parametrize("name", NAMES)
def test_bases_survive_json(name):
    assert basis_from_dict(basis_to_dict(BASES[name])) == BASES[name]


@pytest.mark.parametrize("values", [
    {}, {"name": "wavelet"}, {"name": "fourier", "order": -1}, {"name": "fourier", "order": "many"}, {"name": "fourier", "orders": 5},
    {"name": "fourier", "scale": float("nan")},
    {"name": "fourier", "order": 2.5}, {"name": "fourier", "linear": 1}, {"name": "cosine", "order": 10**12},
    {"name": "keyframes", "times": [0, 0]},
    {"name": "keyframes", "times": [0, 1], "interpolation": "magic"},
])
def test_bad_bases_are_refused(values):
    with pytest.raises(fg.FastGSError):
        basis_from_dict(values)


@pytest.mark.parametrize("interpolation", ["linear", "catmull-rom"])
def test_keyframes_hit_their_keys_and_keep_lines(interpolation):
    times = (0.0, 0.1, 0.5, 0.75, 1.0)
    basis = fg.Keyframes(times, interpolation)
    np.testing.assert_allclose(basis.weights(np.array(times)), np.eye(5), atol=1e-12)
    t = np.linspace(0, 1, 101)
    np.testing.assert_allclose(basis.weights(t) @ np.array(times), t, atol=1e-12)
    np.testing.assert_allclose(basis.weights(np.array([-1.0, 2.0])), np.eye(5)[[0, 4]], atol=1e-12)


def test_culling_drops_only_what_cannot_be_seen(rng):
    model = random_model(rng, 500, "paper", temporal="radial")
    s, everything = fg.slice_model(model, 0.3), fg.slice_model(model, 0.3, cull=False)
    seen = everything.opacity >= model.raster.alpha_cut
    assert 0 < len(s.index) < 500
    assert np.array_equal(s.index, np.flatnonzero(seen)) and np.array_equal(s.position, everything.position[seen])


@pytest.mark.parametrize("temporal", sorted(TEMPORALS))
def test_temporal_opacity_is_between_0_and_1_and_window_is_flat(rng, temporal):
    model = random_model(rng, 50, temporal=temporal)
    for t in np.linspace(-0.5, 1.5, 9):
        factor = model.temporal_kind.factor(t, model.mu_tau, model.temporal)
        assert ((factor >= 0) & (factor <= 1)).all()
        if temporal == "window":
            inside = (model.temporal[:, 0] <= t) & (t <= model.temporal[:, 1])
            assert (factor[inside] == 1).all() and (factor[~inside] < 1).all()


@pytest.mark.parametrize("temporal", ["radial", "window", "radial-window"])
def test_outside_its_span_a_gaussian_is_fainter(rng, temporal):
    model = random_model(rng, 200, temporal=temporal)
    visible = rng.uniform(0.1, 5, 200)
    low, high = model.temporal_kind.span(visible, model.mu_tau, model.temporal)
    for t in (low - 1e-4, high + 1e-4):
        assert (model.temporal_kind.factor(t, model.mu_tau, model.temporal) < np.exp(-visible) * (1 + 1e-6)).all()
    if temporal != "radial-window":
        inside = model.temporal_kind.factor(0.5 * (low + high), model.mu_tau, model.temporal)
        assert (inside >= np.exp(-visible)).all()


def test_spherical_harmonics_are_orthonormal():
    """Gauss-Legendre in height, even steps around: exact for products of degree 4."""
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * np.pi / 8
    r = np.sqrt(1 - z**2)[:, None]
    d = np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z[:, None], (8, 16))], -1).reshape(-1, 3)
    y = sh_basis(d, 4)
    gram = y.T @ (y * np.repeat(weight * np.pi / 8, 16)[:, None])
    np.testing.assert_allclose(gram, np.eye(25), atol=1e-12)


@pytest.mark.parametrize("appearance", ["rgb", "sh2", "sigmoid"])
def test_a_frozen_model_looks_the_same(rng, appearance):
    model = random_model(rng, 200, "paper", "line", "radial", appearance)
    pose = np.eye(4)
    pose[2, 3] = 3
    camera = fg.Camera(64, 48, 60, 60, 32, 24, pose)
    moving = fg.render(model, camera, 0.42, backend="reference")["rgb"]
    still = fg.render(fg.freeze(model, 0.42), camera, 0.0, backend="reference")["rgb"]
    np.testing.assert_allclose(still, moving, atol=2e-5)
