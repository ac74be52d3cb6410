# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks: what each does to a Gaussian, and that kernels do what the oracle does."""
from __future__ import annotations

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering import visibility
from fastgs_blender.rendering.colour import linear_to_srgb, scene_linear, srgb_to_linear
from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.filters import Filter
from fastgs_blender.rendering.instances import LOOKS, Instance, ObjectSettings
from fastgs_blender.rendering.looks import GREY, LUMINANCE, graded, look_numbers

CAMERA = fg.Camera(48, 40, 40, 40, 24, 20, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]))
COLOURS = np.random.default_rng(3).uniform(0.02, 1.0, (50, 3))
EVERYTHING = ObjectSettings(exposure=0.7, gamma=1.3, contrast=1.2, saturation=0.6, hue=1.1, tint=(1.0, 0.8, 0.5), opacity=0.7,
                            opacity_cut=0.3, splat_scale=1.4, min_size=0.08, max_size=0.3)


def changed(linear=COLOURS, **look):
    """Scene-linear colours under a look."""
    return graded(linear, look_numbers(ObjectSettings(**look), "linear"))


def luminance(colour):
    return colour @ LUMINANCE


def test_what_each_look_of_colour_does():
    assert np.allclose(changed(exposure=2.0), 4 * COLOURS)
    assert np.allclose(changed(tint=(1, 0.5, 0)), COLOURS * [1, 0.5, 0])
    assert np.allclose(changed(gamma=2.0), np.sqrt(COLOURS))
    assert np.allclose(changed(contrast=2.0), GREY * (COLOURS / GREY) ** 2)
    assert np.allclose(changed(saturation=0.0), luminance(COLOURS)[:, None])
    assert np.allclose(luminance(changed(saturation=0.4)), luminance(COLOURS))
    third = changed(np.array([[0.6, 0.4, 0.4]]), hue=2 * np.pi / 3)[0]
    assert third.argmax() == 1 and luminance(third) == pytest.approx(luminance(np.array([0.6, 0.4, 0.4])))
    grey = np.full((1, 3), 0.4)
    assert np.allclose(changed(grey, hue=1.0, saturation=3.0), grey)
    muted = 0.5 + 0.1 * COLOURS  # no colour leaves the positive numbers on its way
    assert np.allclose(changed(changed(muted, hue=0.4), hue=0.5), changed(muted, hue=0.9))
    assert np.allclose(changed(muted, hue=2 * np.pi), muted)


def test_models_in_srgb_are_changed_in_scene_linear():
    row = look_numbers(ObjectSettings(exposure=1.0, saturation=0.5), "srgb")
    wanted = linear_to_srgb(graded(srgb_to_linear(COLOURS), look_numbers(ObjectSettings(exposure=1.0, saturation=0.5), "linear")))
    assert np.allclose(graded(COLOURS, row), wanted)


@pytest.mark.parametrize("appearance", ["rgb", "sh2", "sigmoid", "changing rgb"])
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_every_backend_shows_looks_alike(appearance, space):
    model = random_model(np.random.default_rng(1), 60, "paper", "line", "radial", appearance, colour_space=space)
    passes = "rgb", "alpha", "depth", "median_depth"
    pictures = [fg.render([(model, np.eye(4), 0.4, look)], CAMERA, passes=passes, backend=backend)
                for look in (EVERYTHING, ObjectSettings()) for backend in ("reference", "cpu")]
    pictures = [{name: np.where(np.isfinite(image), image, 0) for name, image in each.items()} for each in pictures]
    for name in passes:
        assert np.abs(pictures[0][name] - pictures[1][name]).max() < (1e-4 if "depth" in name else 2e-5)
        assert np.abs(pictures[0][name] - pictures[2][name]).max() > 0.05
    for look in (EVERYTHING, ObjectSettings(opacity=3.0), ObjectSettings(min_size=0.4)):
        instance = Instance(model, np.eye(4), 0.4, look).viewed(CAMERA)
        np.testing.assert_array_equal(visibility.order([instance], CAMERA), visibility.order([instance], CAMERA, backend="reference"))


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_opacity_and_size_are_those_of_a_model_made_so(backend):
    model = random_model(np.random.default_rng(2), 80)
    sigma, largest = 1 / (1 + np.exp(-model.opacity.astype(float))), np.exp(model.scale.astype(float)).max(1)
    kept = sigma >= 0.4
    half = 0.5 * sigma
    size = np.clip(1.5 * largest, 0.1, 0.2) / largest
    made = fg.GaussianModel(position=model.position, rotation=model.rotation, features=model.features, raster=model.raster,
                            opacity=np.log(half / (1 - half)), scale=model.scale + np.log(size)[:, None]).take(kept)
    look = ObjectSettings(opacity=0.5, opacity_cut=0.4, splat_scale=1.5, min_size=0.1, max_size=0.2)
    assert 10 < kept.sum() < 70 and (size > 1).any() and (size < 1).any()
    got = fg.render([(model, np.eye(4), 0.0, look)], CAMERA, backend=backend)
    for name, image in fg.render(made, CAMERA, backend=backend).items():
        assert np.abs(got[name] - image).max() < 1e-5


def test_numbers_that_are_no_look_are_named():
    for name, value in (("exposure", float("nan")), ("opacity", -1), ("tint", (1, 2, -1)), ("opacity_cut", 1.5)):
        with pytest.raises(fg.FastGSError, match=f"{name} .*between"):
            ObjectSettings(**{name: value})
    with pytest.raises(fg.FastGSError, match="three numbers"):
        ObjectSettings(tint=(1, 1))
    assert hash(EVERYTHING) != hash(ObjectSettings()) and ObjectSettings(tint=[1, 1, 1]) == ObjectSettings()


def held(number):
    """As Blender holds it: in single precision."""
    return float(np.float32(number))


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_the_ends_of_each_range_are_within_it_and_give_a_picture(name, space):
    """0.01 as single precision is less than 0.01.  Beyond the ends, and what is no number, is refused."""
    model = random_model(np.random.default_rng(4), 40, "paper", "line", "radial", "rgb", colour_space=space)
    low, high = held(LOOKS[name].low), held(LOOKS[name].high)

    def settings(value):
        return ObjectSettings(**{name: (value,) * 3 if name == "tint" else value})

    for value in (low, high, (low + high) / 2):
        images = fg.render([(model, np.eye(4), 0.4, settings(value).under(settings(value)))], CAMERA, backend="cpu")
        assert all(np.isfinite(image).all() for image in images.values()), value
        assert np.isfinite(scene_linear(images["rgb"], images["alpha"], space)).all(), value
    below, above = (float(np.nextafter(np.float32(end), np.float32(side))) for end, side in ((low, -np.inf), (high, np.inf)))
    for value in (below, above, np.nan, np.inf, -np.inf, 1e300):
        with pytest.raises(fg.FastGSError, match=f"{name} .*between"):
            settings(value)


@pytest.mark.parametrize("value", [np.nan, -0.5, 1.5, np.inf])
def test_densities_edges_and_limits_that_are_none_are_refused(value):
    with pytest.raises(fg.FastGSError, match="density"):
        ObjectSettings(density=value)
    if not 0 <= value < np.inf:
        with pytest.raises(fg.FastGSError, match="soft edge"):
            Crop(np.eye(4), soft=value)
    if np.isnan(value):
        for wrong in (dict(low=value), dict(high=value), dict(colour=(0, value, 0))):
            with pytest.raises(fg.FastGSError, match="filter"):
                Filter("SIZE", **wrong)
