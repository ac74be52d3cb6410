# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on a GPU whose buffers are too small for all of an array, of the splats or of a picture: the bytes are the same."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model
from toy_captures import toy_capture
from two_passes import HEIGHT, WIDTH, two_passes

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import blend, guesses
from fastgs_blender.kernels.gpu.device import Device
from fastgs_blender.kernels.gpu.rows import Split
from fastgs_blender.kernels.protocol import MotionNorm
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points


def test_arrays_of_several_buffers_change_no_byte(fresh, gpu, rng):
    """With bindings of 128 KiB, features and coefficients of motion lie in several buffers: the same pictures, gradients, statistics,
    penalties and steps."""
    n, names = 1500, ("motion", "features", "scale")
    model = random_model(rng, n, "paper", "line", "radial", "sh2", size=0.05)
    camera, given = fg.Camera(WIDTH, HEIGHT, 50, 55, 22, 21, random_pose(rng, 3.0)), (None, None, None, False)
    goal, seen = rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32), (rng.uniform(size=n) < 0.5).astype(np.float32)
    held = np.where(np.arange(n)[:, None] % 3 == 0, np.nan, model.features).astype(np.float32)
    weights = rng.uniform(0, 2, 3 * model.basis.terms)
    results, before = [], fresh.backend.device.binding
    for binding in (before, 1 << 17):
        backend = fresh.backend
        backend.device.binding = binding
        found = two_passes(backend, model, camera, 0.4, goal, *given)
        arrays = {name: backend.array(array.copy()) for name, array in model.arrays.items()}
        slopes = {name: backend.array(array * 0.1) for name, array in model.arrays.items()}
        split = [name for name in arrays if isinstance(arrays[name], Split)]
        rows, moved = backend.rows(backend.array(seen)), backend.zeros((n,), np.int64)
        for reading in ("mean", "group"):
            norm = MotionNorm(None, weights, 2.0, 1e-2, reading)
            found[f"penalty {reading}"] = backend.numpy(
                backend.motion_penalty(norm, arrays["motion"], slopes["motion"], 0.3, backend.steps_since(rows, moved, 3)))
        backend.anchor(arrays["features"], backend.array(held), slopes["features"], rows, 0.2)
        backend.mcmc_penalty(arrays, slopes, 0.1, 0.2, 2.0)
        backend.mcmc_noise(arrays, 100.0, (1, 2))
        tensors = [(arrays[name], slopes[name], backend.zeros(arrays[name].shape), backend.zeros(arrays[name].shape),
                    backend.zeros((n,), np.int32), 1e-2, 0.0, False) for name in names]
        for step in (1, 2):
            backend.adam(rows, tensors, (0.9, 0.999), moved, step)
        found |= {f"{name} {i}": np.array(backend.numpy(each)) for name, tensor in zip(names, tensors) for i, each in enumerate(tensor[:5])}
        results.append((found, split))
    backend.device.binding = before
    assert results[0][1] == [] and {"features", "motion"} <= set(results[1][1])
    for name, wanted in results[0][0].items():
        if name == "penalty group" or name.startswith("motion"):  # sums over pieces are rounded in another order
            np.testing.assert_allclose(results[1][0][name], wanted, rtol=1e-5, atol=1e-9, err_msg=name)
        else:
            assert np.array_equal(results[1][0][name], wanted), name


@pytest.mark.parametrize("look", ["sh1", "sigmoid"])
def test_pictures_that_are_too_large_for_a_buffer_are_compared_in_strips(fresh, rng, monkeypatch, look):
    """With bindings of 160 KiB a picture of 48 x 120 is drawn in bands and compared in strips: the same gradients."""
    model = random_model(rng, 60, "cubic", "line", "radial", look, size=0.2)
    camera = fg.Camera(48, 120, 55, 50, 22, 61, random_pose(rng, 3.0))
    goal, weight = (rng.uniform(0, 1, (120, 48, *rest)).astype(np.float32) for rest in ((3,), ()))
    found, stages, run, before = [], [], Device.run, fresh.backend.device.binding
    monkeypatch.setattr(Device, "run", lambda self, stage, *rest, **more: stages.append(stage) or run(self, stage, *rest, **more))
    for binding in (before, 160 << 10):
        stages.clear()
        fresh.backend.device.binding = binding
        found.append(two_passes(fresh.backend, model, camera, 0.4, goal, weight, None, None, False))
    assert stages.count("loss_similarity") == 4 and stages.count("raster") > 1
    for name, wanted in found[0].items():
        np.testing.assert_allclose(found[1][name], wanted, rtol=2e-4, atol=2e-6 * np.abs(wanted).max(initial=0), err_msg=name)
        assert name != "by rgb" or np.array_equal(found[1][name], wanted), "no pixel's own gradient changes"


def test_splats_of_several_buffers_change_no_byte(fresh, rng, monkeypatch):
    """With bindings of 64 KiB the splats of 4500 Gaussians lie in two; those that the view shows are gathered in one."""
    model = random_model(rng, 4500, "line", "line", "radial", "rgb", size=0.005)
    camera, goal = fg.Camera(24, 16, 150, 150, 12, 8, random_pose(rng, 3.0)), rng.uniform(0, 1, (16, 24, 3)).astype(np.float32)
    found, stages, run, before = [], [], Device.run, fresh.backend.device.binding
    monkeypatch.setattr(Device, "run", lambda self, stage, *rest, **more: stages.append(stage) or run(self, stage, *rest, **more))
    for binding in (before, 1 << 16):
        stages.clear()
        fresh.backend.device.binding = binding
        found.append(two_passes(fresh.backend, model, camera, 0.4, goal, None, None, None, False))
    assert stages.count("touch") == 6 and stages.count("raster") == 3, "one band for each picture, of two buffers"
    assert 50 < np.count_nonzero(found[0]["drawn"]) < 4000
    for name, wanted in found[0].items():
        assert np.array_equal(found[1][name], wanted), name


@pytest.mark.parametrize("look", ["sh1", "sigmoid"])
def test_bands_change_no_byte_of_gradients(fresh, rng, monkeypatch, look):
    """Which bands a picture is drawn in depends on what earlier steps have found, and a resumed run is still the same run."""
    model = random_model(rng, 150, "cubic", "line", "radial", look, size=0.2)
    camera = fg.Camera(140, 60, 80, 75, 70, 31, random_pose(rng, 3.0))
    goal, found, stages, run = rng.uniform(0, 1, (60, 140, 3)).astype(np.float32), [], [], Device.run
    monkeypatch.setattr(Device, "run", lambda self, stage, *rest, **more: stages.append(stage) or run(self, stage, *rest, **more))
    for entries in (blend.ENTRIES, 500):
        stages.clear()
        monkeypatch.setattr(blend, "ENTRIES", entries)
        found.append(two_passes(fresh.backend, model, camera, 0.4, goal, None, None, None, False))
    assert stages.count("raster") > 1
    for name, wanted in found[0].items():
        assert np.array_equal(found[1][name], wanted), name


def test_steps_in_small_buffers_read_nothing_back(fresh, rng, monkeypatch):
    """With bindings of 60 KiB splats lie in several buffers and pictures are drawn in bands: after the first step nothing is read, and
    guesses that are too small, in every step, change no byte."""
    capture, store, points = toy_capture(frames=2, views=2)
    chosen = settings.settings(iterations=8, preview_every=0, exposures="off", clocks="off", warm_up=(0.0, 0.0), densify_from=1.0)
    xyz = rng.uniform((-3.0, -2.0, 1.1), (3.0, 2.0, 1.3), (1350, 3)).astype(np.float32)
    model = model_from_points(type(points)(xyz, rng.uniform(0, 1, xyz.shape)), chosen, capture.clip, capture.axes, capture.extent)
    model = replace(model, scale=model.scale - 1)
    monkeypatch.setattr(guesses, "LEAST", 16)
    states, reads, read, stages, run = [], [], Device.read, [], Device.run
    monkeypatch.setattr(Device, "read", lambda self, *given: reads.append(given) or read(self, *given))
    monkeypatch.setattr(Device, "run", lambda self, stage, *rest, **more: stages.append(stage) or run(self, stage, *rest, **more))
    device = fresh.backend.device
    for spoil in (False, True):
        trainer = Trainer(capture, store, chosen, Start(model), backend=fresh.name)
        trainer.step()  # this needs a large table, once
        with device.narrow(60 << 10):
            for number in range(2):
                for guess in device.guesses.values() if spoil else ():
                    guess.largest = min(guess.largest, 20)
                reads.clear()
                stages.clear()
                trainer.step()
                assert stages.count("raster") > 2 and stages.count("touch") > 6 and (stages.count("moved") > 1) == spoil
                assert bool(reads) == (number == 0 and not spoil)
        states.append(trainer.state()[0])
    for name, wanted in states[0].items():
        assert np.array_equal(states[1][name], wanted, equal_nan=True), name
