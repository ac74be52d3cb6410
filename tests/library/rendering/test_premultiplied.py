# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of Spacetime Gaussians (STG) are drawn as STG draws them: the decoder is given the sum that blending leaves.

Transcribed from github.com/oppo-us-research/SpacetimeGaussians, commit 427abfc:

* submodules/gaussian_rasterization_ch9/cuda_rasterizer/forward.cu, renderCUDA, lines 349-390: alpha = min(0.99, opacity exp(power)), left
  out under 1/255; the end where T (1 - alpha) < 0.0001; C[ch] += feature * alpha * T; out_color = C + T bg.  train.py, line 91: bg is 0;
* thirdparty/gaussian_splatting/renderer/__init__.py, train_ours_full, lines 93-105: the decoder's result is the picture, as it is;
* helper_model.py, Sandwich, Sandwichnoact and Sandwichnoactss, forward(), lines 44-53, 66-75, 89-97; no layer has a bias (line 33);
* scene/cameras.py, lines 108-112: the rays are the camera's centre, then the unit direction;
* scene/oursfull.py, get_features, line 139: the time features are multiplied by the time since trbf_center.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering.exposure import Exposure
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.passes import PassSettings

T = 0.37
TRANSPARENT = PassSettings(film="transparent")
ACTIVATIONS = {"sigmoid": lambda x: 1 / (1 + np.exp(-x)), "clamp": lambda x: np.clip(x, 0, 1), "none": lambda x: x}


def features(rng, activation="sigmoid", decode="premultiplied") -> fg.Features:
    return fg.Features(rng.normal(0, 0.7, (6, 12)), rng.normal(0, 0.7, (3, 6)), activation, decode)


def scene(rng, activation="sigmoid", n=30, **fields) -> tuple[fg.GaussianModel, fg.Camera]:
    """Gaussians with gaps between them, and a camera that sees nothing at its border."""
    model = random_model(rng, n, "cubic", "line", "radial", features(rng, activation), extent=0.5, size=0.2, **fields)
    return model, fg.Camera(40, 32, 22, 24, 19.3, 16.4, random_pose(rng, 3.0))


def sandwich(sums, camera, look):
    """Sandwich.forward(sums, rays), and of the other two."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    to_world = np.linalg.inv(camera.world_to_camera)
    direction = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1) @ to_world[:3, :3].T
    rays_d = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    rays_o = np.broadcast_to(to_world[:3, 3], rays_d.shape)
    albedo, spec, timefeature = np.split(sums.astype(np.float64), 3, -1)
    specular = np.concatenate([spec, timefeature, rays_o, rays_d], -1)
    specular = np.maximum(specular @ look.w1.astype(np.float64).T, 0) @ look.w2.astype(np.float64).T
    return ACTIVATIONS[look.activation](albedo + specular)


def blended(model, camera, t=T) -> np.ndarray:
    """The sums of the features [h, w, 9]: pictures of the same Gaussians in plain colours, which blending alone makes."""
    deltat = t - model.mu_tau[:, None]
    every = np.concatenate([model.features[:, :6], deltat * model.features[:, 6:]], 1)
    return np.concatenate([fg.render(replace(model, appearance=fg.RGB(), features=every[:, k:k + 3]), camera, t, backend="reference")["rgb"]
                           for k in (0, 3, 6)], -1)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_a_picture_is_the_decoders_of_the_sum(rng, backend, activation):
    """Where alpha is 0, between 0 and 1, and near 1."""
    model, camera = scene(rng, activation)
    out = fg.render(model, camera, T, backend=backend)
    alpha = out["alpha"]
    assert (alpha == 0).sum() > 50 and ((alpha > 0.1) & (alpha < 0.9)).sum() > 50 and (alpha > 0.9).any()
    np.testing.assert_allclose(out["rgb"], sandwich(blended(model, camera), camera, model.appearance), atol=2e-5)


def test_one_gaussian_by_hand():
    """At the middle of a Gaussian of opacity 0.6: C = 0.6 f, T = 0.4, and nothing is multiplied afterwards."""
    look = fg.Features(np.zeros((6, 12)), np.zeros((3, 6)), "sigmoid", "premultiplied")
    model = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1.0, 0, 0, 0]], scale=np.full((1, 3), -1.0), opacity=[np.log(0.6 / 0.4)],
                             features=[[2.0, -1.0, 0.5, 0, 0, 0, 0, 0, 0]], appearance=look)
    camera = fg.Camera(33, 33, 30, 30, 16.5, 16.5, np.eye(4))
    for backend in ("reference", "cpu"):
        out = fg.render(model, camera, backend=backend)
        np.testing.assert_allclose(out["alpha"][16, 16], 0.6, atol=1e-6)
        np.testing.assert_allclose(out["rgb"][16, 16], 1 / (1 + np.exp(-0.6 * np.array([2.0, -1.0, 0.5]))), atol=1e-6)
    other = fg.render(replace(model, appearance=replace(look, decode="normalised")), camera)["rgb"][16, 16]
    np.testing.assert_allclose(other, 0.6 / (1 + np.exp(-np.array([2.0, -1.0, 0.5]))), atol=1e-6)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_on_a_transparent_film_the_empty_colour_is_taken_out(rng, backend, activation):
    """Over the decoder's colour of no features it is STG's picture again, but where straight colours would leave the activation's range."""
    model, camera = scene(rng, activation)
    out = fg.render(model, camera, T, backend=backend, settings=TRANSPARENT)
    rgb, alpha = out["rgb"], out["alpha"][..., None]
    whole, empty = (sandwich(sums, camera, model.appearance) for sums in (blended(model, camera), np.zeros((32, 40, 9))))
    wanted = whole - (1 - alpha) * empty
    inside = (wanted >= 0) & (wanted <= alpha) if activation != "none" else np.ones(wanted.shape, bool)
    assert inside.mean() > 0.4
    np.testing.assert_allclose(rgb[inside], wanted[inside], atol=2e-5)
    assert not rgb[alpha[..., 0] == 0].any()
    if activation != "none":
        assert (rgb >= 0).all() and (rgb <= alpha + 1e-6).all()
        np.testing.assert_allclose(rgb[~inside], np.clip(wanted, 0, alpha)[~inside], atol=2e-5)


def test_a_clear_surface_keeps_its_colour_on_a_transparent_film(rng):
    """For a decoder without a bend, to take the empty colour out is to blend straight colours: both ways of decoding are one."""
    model, camera = scene(rng, "none")
    look = replace(model.appearance, w2=np.zeros((3, 6)))
    one, other = (fg.render(replace(model, appearance=replace(look, decode=way)), camera, T, settings=TRANSPARENT)["rgb"]
                  for way in ("premultiplied", "normalised"))
    np.testing.assert_allclose(one, other, atol=2e-6)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_beside_other_models(rng, backend):
    """Each has its own picture where it is alone; what lies behind shows as much as alpha says, and no veil covers the rest."""
    model, camera = scene(rng)
    right = random_model(rng, 20, size=0.05)
    right = replace(right, position=right.position * 0.1, features=np.full((20, 3), 0.5))
    place = np.linalg.inv(camera.world_to_camera) @ np.array([[1, 0, 0, 3.5], [0, 1, 0, 2.5], [0, 0, 1, 5.0], [0, 0, 0, 1]])
    both = fg.render([(model, np.eye(4), T), (right, place, 0.0)], camera, backend=backend)
    alone = fg.render(model, camera, T, backend=backend, settings=TRANSPARENT)
    other = fg.render([(right, place, 0.0)], camera, backend=backend)
    assert other["alpha"].max() > 0.5 and alone["alpha"].max() > 0.5
    apart = (alone["alpha"] == 0) | (other["alpha"] == 0)
    np.testing.assert_allclose(both["rgb"][apart], (alone["rgb"] + other["rgb"])[apart], atol=2e-6)


@pytest.mark.parametrize("settings", [PassSettings(), TRANSPARENT])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_backends_agree(rng, activation, settings):
    """With a look of colour too."""
    model, camera = scene(rng, activation)
    for look in (ObjectSettings(), ObjectSettings(exposure=0.5, saturation=0.6, gamma=1.2)):
        given = [Instance(model, np.eye(4), T, look)]
        exact, found = (fg.render(given, camera, backend=backend, settings=settings)["rgb"] for backend in ("reference", "cpu"))
        np.testing.assert_allclose(found, exact, atol=2e-4 if activation == "none" else 5e-5)


def test_a_look_changes_what_is_shown(rng):
    """On an opaque film half the exposure is half the light of the whole picture, the empty colour's too."""
    model, camera = scene(rng)
    model = replace(model, colour_space="linear")
    one, half = (fg.render([Instance(model, np.eye(4), T, ObjectSettings(exposure=stops))], camera)["rgb"] for stops in (0.0, -1.0))
    np.testing.assert_allclose(half, one / 2, atol=1e-6)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_meshes_and_moving_pictures_get_no_veil(rng, backend):
    """With a holdout, and with a shutter, the picture goes over something: where nothing is, there is no light."""
    model, camera = scene(rng)
    wall = np.array([[[-50, -50, 1.0], [50, -50, 1], [0, 80, 1]]]) @ np.linalg.inv(camera.world_to_camera)[:3, :3].T
    wall = (wall + np.linalg.inv(camera.world_to_camera)[:3, 3]).astype(np.float32)
    held = fg.render(model, camera, T, backend=backend, holdout=wall)
    assert not held["rgb"].any() and not held["alpha"].any()
    blurred = fg.render(model, camera, T, backend=backend, exposure=Exposure(-1, 1, steps=4))
    assert (blurred["alpha"] == 0).any() and not blurred["rgb"][blurred["alpha"] == 0].any() and blurred["rgb"].any()


def test_pictures_of_normalised_decoders_know_no_film(rng):
    model, camera = scene(rng)
    model = replace(model, appearance=replace(model.appearance, decode="normalised"))
    one, other = (fg.render(model, camera, T, settings=settings)["rgb"] for settings in (PassSettings(), TRANSPARENT))
    assert one.tobytes() == other.tobytes()


def test_another_way_is_refused():
    with pytest.raises(fg.FastGSError, match="decoder.*normalised, premultiplied"):
        fg.Features(decode="straight")
    with pytest.raises(fg.FastGSError, match="film"):
        PassSettings(film="black")
