# SPDX-License-Identifier: GPL-3.0-or-later
"""Gradients of pictures against central differences of the oracle in float64."""
from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from random_cameras import random_pose
from random_models import BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import rasterise
from fastgs_blender.model.slicing import slice_model
from fastgs_blender.rendering.instances import AS_TRAINED, Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.rendering.oracle import BACKEND as ORACLE
from fastgs_blender.training.core.statistics import Statistics
from fastgs_blender.util import threads
from fastgs_blender.util.backends import load_backend

CPU = load_backend("cpu")
T = 0.37
BAND = 0.01
STEP = 1e-6
TOLERANCE = 1e-4
NAMES = ("position", "rotation", "scale", "opacity", "features", "motion", "rotation_motion", "mu_tau", "temporal", "w1", "w2")


def small_model(rng, basis="static", rotation_basis="static", temporal="always", appearance="rgb", n=5, **raster) -> fg.GaussianModel:
    """A few large, overlapping Gaussians, so transparent that no pixel is finished; every flank of time is met at T."""
    model = random_model(rng, n, basis, rotation_basis, temporal, appearance, extent=0.6, size=0.5,
                         opacity=rng.uniform(-0.5, 1.0, n), mu_tau=T + rng.uniform(-0.5, 0.5, n), raster=fg.Raster(**raster))
    begin = T + np.resize([0.15, -0.4, -0.2, 0.1, -0.5], n)
    columns = {"radial": [rng.normal(0, 0.5, n)],
               "window": [begin, begin + np.resize([0.3, 0.25, 0.6, 0.2, 0.4], n), *rng.normal(-1.2, 0.2, (2, n))],
               "radial-window": [rng.normal(0, 0.5, n), begin, begin + np.resize([0.3, 0.25, 0.6, 0.2, 0.4], n), rng.normal(-1.2, 0.2, n)]}
    if model.temporal_kind.name in columns:
        model = replace(model, temporal=np.stack(columns[model.temporal_kind.name], -1))
    return model


def small_camera(rng, orthographic=False, focal=20.0) -> fg.Camera:
    """A picture of 22 x 18 pixels with unequal focal lengths and the principal point off the middle."""
    return fg.Camera(22, 18, 8.0 if orthographic else focal, 7.0 if orthographic else 1.1 * focal, 10.3, 9.6, random_pose(rng, 2.5),
                     orthographic=orthographic)


def parameters_of(model) -> dict[str, np.ndarray]:
    """What training differentiates by."""
    arrays = dict(model.arrays)
    if isinstance(model.appearance, fg.Features):
        arrays |= {"w1": model.appearance.w1, "w2": model.appearance.w2}
    return {name: array.copy() for name, array in arrays.items()}


def in_float64(model, arrays) -> fg.GaussianModel:
    """The model with arrays that were not rounded to float32."""
    model = copy.copy(model)
    model.appearance = copy.copy(model.appearance)
    for name, array in arrays.items():
        object.__setattr__(model.appearance if name in ("w1", "w2") else model, name, array)
    return model


class Functional:
    """A random linear function of a picture: rgb, alpha and, if wanted, depth times weights."""

    def __init__(self, rng, camera, depth=False):
        self.camera, self.depth = camera, depth
        _, _, width, height = camera.window
        self.rgb, self.alpha, self.deep = (rng.normal(size=shape).astype(np.float32) for shape in
                                           ((height, width, 3), (height, width), (height, width)))

    def gradients(self, parameters, model, t=T, band=BAND, **options) -> dict[str, np.ndarray]:
        """Its gradients by the kernels."""
        picture = CPU.forward(parameters, model, self.camera, t, self.depth, band)
        return CPU.backward(picture, self.rgb, self.alpha, self.deep if self.depth else None, **options)

    def of_reference(self, model, t=T) -> float:
        """Its value by the oracle."""
        instance = Instance(model, np.eye(4), t, AS_TRAINED).viewed(self.camera)
        layout = Layout([instance], self.depth, opaque=True)
        out = ORACLE.draw([instance], self.camera, layout, (), lambda fraction: None, band=BAND)
        value = (ORACLE.colour(out, layout, self.camera) * self.rgb).sum() + (out.alpha * self.alpha).sum()
        return value + (out.sums["depth"][..., 0] * self.deep).sum() if self.depth else value

    def slopes(self, model, names) -> dict[str, np.ndarray]:
        """Central differences of the oracle by every element of the arrays named."""
        arrays = {name: array.astype(np.float64) for name, array in parameters_of(model).items()}
        out = {name: np.zeros_like(arrays[name]) for name in names}
        model = in_float64(model, arrays)
        for name in names:
            array = arrays[name]
            for i in np.ndindex(array.shape):
                middle = array[i]
                step = STEP * max(1.0, abs(middle))
                array[i] = middle + step
                above = self.of_reference(model)
                array[i] = middle - step
                below = self.of_reference(model)
                array[i] = middle
                out[name][i] = (above - below) / (2 * step)
        return out


def gradients_of(model, functional, **options) -> dict[str, np.ndarray]:
    """By the kernels."""
    return functional.gradients(parameters_of(model), model, **options)


def compare(model, functional, names=NAMES):
    """Kernels and oracle give the same gradients, array by array and element by element; returns them."""
    got = gradients_of(model, functional)
    names = [name for name in names if name in got and got[name].size]
    wanted = functional.slopes(model, names)
    for name in names:
        size = np.linalg.norm(wanted[name])
        assert size > 0 or not got[name].any(), name
        assert np.linalg.norm(got[name] - wanted[name]) <= TOLERANCE * size, name
        floor = 0.01 * np.abs(wanted[name]).max()
        np.testing.assert_array_less(np.abs(got[name] - wanted[name]), TOLERANCE * np.maximum(np.abs(wanted[name]), floor) + 1e-12, name)
    return got


@pytest.mark.parametrize("basis", BASES)
def test_every_basis(rng, basis):
    """Of the motion and of the rotation."""
    model = small_model(rng, basis, basis, "radial")
    compare(model, Functional(rng, small_camera(rng)), ("position", "rotation", "motion", "rotation_motion", "mu_tau"))


@pytest.mark.parametrize("temporal", TEMPORALS)
def test_every_temporal_opacity(rng, temporal):
    got = compare(small_model(rng, "paper", "line", temporal), Functional(rng, small_camera(rng)), ("opacity", "mu_tau", "temporal"))
    assert got["temporal"].any(0).all()


@pytest.mark.parametrize("appearance", ["rgb", "sh0", "sh1", "sh2", "sh3", "sh4", "sigmoid", "clamp", "none", "stg",
                                        "changing rgb", "changing sh1"])
def test_every_appearance(rng, appearance):
    names = ("position", "opacity", "features", "mu_tau", "w1", "w2")
    compare(small_model(rng, "static", "static", "always", appearance), Functional(rng, small_camera(rng), depth=True), names)


@pytest.mark.parametrize("options", [{}, {"antialiased": True}, {"antialiased": True, "blur": 0.1}, {"blur": 0.0}])
@pytest.mark.parametrize("orthographic", [False, True])
def test_every_projection(rng, options, orthographic):
    appearance = "sh2" if orthographic else "sigmoid"
    model = small_model(rng, "fourier", "line", "radial", appearance, **options)
    compare(model, Functional(rng, small_camera(rng, orthographic), depth=True), ("position", "rotation", "scale", "opacity", "mu_tau"))


@pytest.mark.parametrize("antialiased", [False, True])
def test_gaussians_beyond_the_limits_of_the_jacobian(rng, antialiased):
    """Their centres lie so far off the picture, on every side, that the Jacobian is that of a point nearer to it."""
    model = small_model(rng, n=4, antialiased=antialiased)
    tangents = np.array([[0.95, 0.1], [-0.9, 0.05], [0.1, 0.8], [-0.8, -0.85]])
    model.position[:] = np.array([[2.2], [2.4], [2.6], [2.8]]) * np.c_[tangents, np.ones(4)]
    model.scale[:] = np.log(0.8) + rng.normal(0, 0.1, (4, 3))
    camera = replace(small_camera(rng), world_to_camera=np.eye(4))
    low_x, high_x, low_y, high_y = camera.tangent_limits()
    assert ((tangents < (low_x, low_y)) | (tangents > (high_x, high_y))).any(1).all()
    got = compare(model, Functional(rng, camera, depth=True))
    assert got["position"].any(1).all()


def test_part_of_a_picture(rng):
    camera = replace(small_camera(rng), window=(5, 3, 9, 11))
    compare(small_model(rng, "line", "static", "radial", "none"), Functional(rng, camera), ("position", "mu_tau", "w1", "w2"))


def test_the_temporal_centre_can_be_left_out_of_the_motion(rng):
    """Then its gradient is that of a model whose motion and rotation are stopped."""
    model, functional = small_model(rng, "cubic", "line", "radial"), Functional(rng, small_camera(rng))
    s = slice_model(model, T, cull=False)
    stopped = replace(model, position=s.position, rotation=s.rotation, motion=None, rotation_motion=None, basis=fg.Static(),
                      rotation_basis=fg.Static())
    got, whole = (gradients_of(model, functional, detach_time=detach)["mu_tau"] for detach in (True, False))
    wanted = functional.slopes(stopped, ["mu_tau"])["mu_tau"]
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4 * np.abs(wanted).max())
    assert np.abs(whole - got).max() > 0.1 * np.abs(got).max()


@pytest.mark.parametrize("appearance", ["rgb", "sh3", "sigmoid", "clamp", "none", "stg"])
def test_pictures_are_the_renderers(rng, appearance):
    """Bit for bit, of the whole and of a part, with and without depth."""
    model = random_model(rng, 300, "paper", "line", "radial", appearance)
    whole = fg.Camera(70, 50, 60, 60, 35, 25, random_pose(rng, 2.5))
    for camera in (whole, replace(whole, window=(13, 7, 40, 33))):
        wanted = fg.render([Instance(model, np.eye(4), T, AS_TRAINED)], camera)
        instance = Instance(model, np.eye(4), T, AS_TRAINED).viewed(camera)
        drawn = CPU.draw([instance], camera, Layout([instance], True), (), lambda fraction: None)
        for depth in (False, True):
            got = CPU.forward(parameters_of(model), model, camera, T, depth)
            np.testing.assert_array_equal(got.rgb, wanted["rgb"])
            np.testing.assert_array_equal(got.alpha, wanted["alpha"])
        assert wanted["alpha"].any()
        np.testing.assert_array_equal(got.depth, drawn.sums["depth"][..., 0])


@pytest.mark.parametrize("appearance", ["sh2", "sigmoid"])
def test_gradients_have_the_same_bytes_for_any_number_of_threads(rng, appearance, monkeypatch):
    model = random_model(rng, 1500, "paper", "line", "radial", appearance)
    camera = fg.Camera(130, 100, 100, 100, 65, 50, random_pose(rng, 2.5))
    functional = Functional(rng, camera, depth=True)
    for module, name, size in ((threads, "MOST", 200), (threads, "LEAST", 150), (rasterise, "TILES", 5)):
        monkeypatch.setattr(module, name, size)
    results = []
    try:
        for count in (1, 2, 3, 3):
            threads.set_threads(count)
            statistics = Statistics.empty(CPU, len(model))
            results.append(gradients_of(model, functional, statistics=statistics, band=0.0) | statistics.state(CPU))
    finally:
        threads.set_threads(0)
    for result in results[1:]:
        assert all(np.array_equal(result[name], results[0][name]) for name in results[0])
    assert all(array.any() for array in results[0].values() if array.size)


@pytest.mark.parametrize("appearance", ["sh1", "sigmoid"])
def test_nothing_to_learn_from(rng, appearance):
    """No Gaussians, or none in sight: zeros of the right shapes."""
    model, functional = small_model(rng, "paper", "line", "window", appearance), Functional(rng, small_camera(rng), depth=True)
    hidden = replace(model, opacity=np.full(len(model), -20))
    for unseen in (model.take(np.s_[:0]), hidden):
        statistics = Statistics.empty(CPU, len(unseen))
        got = gradients_of(unseen, functional, statistics=statistics)
        assert all(got[name].shape == array.shape for name, array in unseen.arrays.items())
        assert not any(array.any() for array in (*got.values(), *statistics.state(CPU).values()))


def test_what_is_behind_a_wall_does_not_move(rng):
    """It is drawn, so its gradients are written: zeros, whatever stood in that memory."""
    camera = small_camera(rng)
    functional = Functional(rng, camera, depth=True)
    model = small_model(rng, "cubic", "line", "radial", "sigmoid", n=20)
    wall = slice(10, 20)
    places = np.linalg.inv(camera.world_to_camera) @ np.stack([*np.zeros((2, 10)), np.linspace(0.6, 0.8, 10), np.ones(10)])
    model.position[wall], model.scale[wall], model.opacity[wall], model.mu_tau[wall] = places[:3].T, np.log(1.5), 9.0, T
    model.motion[wall] *= 0.01
    got, alone = gradients_of(model, functional), gradients_of(model.take(np.s_[wall]), functional)
    for name in alone:
        np.testing.assert_array_equal(got[name] if name in ("w1", "w2") else got[name][wall], alone[name])
        if name not in ("w1", "w2"):
            assert alone[name].any() and not got[name][:10].any(), name


def test_gaussians_that_are_no_numbers_harm_no_others(rng):
    model, functional = small_model(rng, "cubic", "line", "radial", "sigmoid", n=16), Functional(rng, small_camera(rng), depth=True)
    broken = tuple(model.arrays)
    for i, name in enumerate(broken):
        getattr(model, name)[i] = np.nan
    got, wanted = gradients_of(model, functional), gradients_of(model.take(np.s_[len(broken):]), functional)
    for name in got:
        rows = slice(None) if name in ("w1", "w2") else slice(len(broken), None)
        assert np.isfinite(got[name]).all(), name
        assert wanted[name].any(), name
        np.testing.assert_array_equal(got[name][rows], wanted[name])
        if name not in ("w1", "w2"):
            assert not got[name][:len(broken)].any(), name


def test_screen_statistics(rng):
    """Moving one splat by a pixel is moving the principal point; its radius is half the size of what it covers."""
    model, camera = small_model(rng, n=1), small_camera(rng)
    model.position[:], model.scale[:] = 0, np.log(0.12)
    functional, statistics = Functional(rng, camera), Statistics.empty(CPU, 1)

    def shifted(**change):
        functional.camera = replace(camera, **change)
        return functional.of_reference(model)

    across = (shifted(cx=camera.cx + STEP) - shifted(cx=camera.cx - STEP)) / (2 * STEP)
    down = (shifted(cy=camera.cy + STEP) - shifted(cy=camera.cy - STEP)) / (2 * STEP)
    functional.camera = camera
    gradients_of(model, functional, statistics=statistics)
    plain = np.hypot(across * camera.width / 2, down * camera.height / 2)
    np.testing.assert_allclose(statistics.gradient, plain, rtol=1e-3)
    assert statistics.absolute >= statistics.gradient
    assert statistics.seen == 1
    columns = fg.render(model, camera, T)["alpha"].any(0).sum()
    assert abs(2 * statistics.radius * camera.width - columns) < 2.5

    twice = Statistics.restored(CPU, {name: array.copy() for name, array in statistics.state(CPU).items()})
    gradients_of(model, functional, statistics=twice)
    both = Statistics.empty(CPU, 1)
    both.add(statistics)
    both.add(statistics)
    for name, array in twice.state(CPU).items():
        np.testing.assert_array_equal(array, both.state(CPU)[name])
    both.take([])
    assert len(both.seen) == 0


def test_torch_gets_the_same_pictures_and_gradients(rng):
    from fastgs_blender import torch as differentiable

    for appearance, depth in (("sh1", False), ("sigmoid", True)):
        model, functional = small_model(rng, "cubic", "line", "radial", appearance), Functional(rng, small_camera(rng), depth)
        wanted = gradients_of(model, functional)
        tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in parameters_of(model).items()}
        picture = differentiable.render(tensors, model, functional.camera, T, depth=depth, band=BAND)
        np.testing.assert_array_equal(picture.rgb.detach(), CPU.forward(parameters_of(model), model, functional.camera, T, depth, BAND).rgb)
        value = (picture.rgb * torch.from_numpy(functional.rgb)).sum() + (picture.alpha * torch.from_numpy(functional.alpha)).sum()
        if depth:
            value = value + (picture.depth * torch.from_numpy(functional.deep)).sum()
        value.backward()
        for name, tensor in tensors.items():
            np.testing.assert_array_equal(tensor.grad, wanted[name], name)


def test_tensors_that_changed_since_are_refused(rng):
    from fastgs_blender import torch as differentiable

    model, camera = small_model(rng), small_camera(rng)
    tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in parameters_of(model).items()}
    value = differentiable.render(tensors, model, camera, T).rgb.sum()
    with torch.no_grad():
        tensors["position"] += 1
    with pytest.raises(RuntimeError):
        value.backward()


@pytest.mark.parametrize("appearance", ["changing sh1", "changing rgb", "sigmoid"])
def test_a_model_without_gaussians_takes_a_step(rng, appearance):
    """All of them may have been pruned."""
    model = random_model(rng, 0, "cubic", "line", "window", appearance)
    look, camera = model.appearance, fg.Camera(20, 16, 16, 16, 10, 8, np.eye(4))
    parameters = dict(model.arrays) | ({"w1": look.w1.copy(), "w2": look.w2.copy()} if appearance == "sigmoid" else {})
    gradients = CPU.backward(CPU.forward(parameters, model, camera, T), np.ones((16, 20, 3), np.float32))
    assert {name: array.shape for name, array in gradients.items()} == {name: array.shape for name, array in parameters.items()}
    tensors = [(value, gradients[name], np.zeros_like(value), np.zeros_like(value), np.zeros(len(value), np.int32), 1e-2, 0.0, False)
               for name, value in parameters.items() if len(value) == 0]
    CPU.adam(np.zeros(0, np.int64), tensors, (0.9, 0.999), np.zeros(0, np.int64), 1)
