# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on the GPU backend against the CPU's kernels: gradients, penalties, Adam, and whole runs."""
from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from random_cameras import random_pose
from random_models import APPEARANCES, BASES, TEMPORALS, random_model
from toy_captures import toy_capture
from two_passes import HEIGHT, WIDTH, two_passes

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import guesses
from fastgs_blender.kernels.gpu.backend import GPU
from fastgs_blender.kernels.gpu.device import Device
from fastgs_blender.kernels.protocol import DeviceError, MotionNorm, TrainingBackend
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.util import backends
from fastgs_blender.util.backends import load_backend

STEPS = int(os.environ.get("FASTGS_GPU_STEPS", "40"))


def relative(found: np.ndarray, wanted: np.ndarray) -> float:
    """The relative L2 error of an array."""
    return float(np.linalg.norm(found.astype(np.float64) - wanted) / max(np.linalg.norm(wanted), 1e-12)) if wanted.size else 0.0


@pytest.mark.parametrize("seed", range(8))
def test_gradients_are_the_cpus(gpu, seed):
    rng = np.random.default_rng(seed)
    bases = sorted(BASES)
    model = random_model(rng, int(rng.integers(5, 81)), bases[seed % 8], bases[(3 * seed + 2) % 8], sorted(TEMPORALS)[seed % 4],
                         APPEARANCES[(3 * seed + 1) % len(APPEARANCES)], size=10 ** rng.uniform(-2, -0.3),
                         raster=fg.Raster(antialiased=seed % 2 == 1))
    flat = seed % 4 == 3
    focal = (14, 16) if flat else (50, 55)
    camera, t = fg.Camera(WIDTH, HEIGHT, *focal, 22, 21, random_pose(rng, 3.0), orthographic=flat), rng.uniform(0, 1)
    given = (rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32),
             None if seed % 2 else rng.uniform(0, 2, (HEIGHT, WIDTH)).astype(np.float32),
             None if seed % 3 else rng.uniform(0, 1, 3).astype(np.float32),
             None if seed % 4 > 1 else 1e-4 * rng.normal(size=(HEIGHT, WIDTH)).astype(np.float32), seed % 5 == 0, 0.02 * (seed == 6),
             rng.uniform(size=(HEIGHT, WIDTH, 3)) < 0.3 if seed % 8 == 5 else None)
    wanted, found = (two_passes(backend, model, camera, t, *given) for backend in (load_backend("cpu"), gpu))
    assert np.count_nonzero(wanted["drawn"]) > 4
    for name, array in wanted.items():
        assert found[name].shape == array.shape and relative(found[name], array) <= 1e-3, name
    if seed == 0:
        again = two_passes(gpu, model, camera, t, *given)
        assert all(np.array_equal(again[name], array) for name, array in found.items())


def test_gradients_of_premultiplied_sums_are_the_cpus(gpu, rng):
    """Pixels without any splat have one too: of the decoder's matrices.  The background's goes through alpha alone."""
    model = random_model(rng, 30, "cubic", "line", "radial", "stg", size=0.1)
    camera = fg.Camera(WIDTH, HEIGHT, 30, 32, 22, 21, random_pose(rng, 3.0))
    target = rng.uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)
    wanted, found = (two_passes(backend, model, camera, 0.4, target, None, np.float32([0.2, 0.5, 0.1]), None, False, 0.0, None)
                     for backend in (load_backend("cpu"), gpu))
    for name, array in wanted.items():
        assert relative(found[name], array) <= 1e-3, name


@pytest.mark.parametrize("reading", ["mean", "group"])
def test_steps_are_the_cpus(gpu, rng, reading):
    """Penalty, hold, MCMC's weights, since, count and Adam, on random numbers."""
    n, terms = 300, 5
    cpu = load_backend("cpu")
    matrix = rng.normal(size=(4, terms)) if reading == "mean" else None
    norm = MotionNorm(matrix, rng.uniform(0, 2, 3 * (terms if matrix is None else 4)), 2.0, 1e-2, reading)
    seen = (rng.uniform(size=n) < 0.5).astype(np.float32)
    held = rng.normal(size=(n, 9)).astype(np.float32)
    held[::3] = np.nan
    draw = {"motion": (n, terms, 3), "features": (n, 9), "opacity": (n,), "scale": (n, 3), "by motion": (n, terms, 3),
            "by features": (n, 9), "by opacity": (n,), "by scale": (n, 3), "w2": (3, 6), "by w2": (3, 6)}
    draw = {name: rng.normal(0, 0.1, shape).astype(np.float32) for name, shape in draw.items()}
    draw["by features"][4, 2] = np.inf
    results = []
    for backend in (cpu, gpu):
        a = {name: backend.array(array.copy()) for name, array in draw.items()}
        moved, rows = backend.array(np.arange(n) % 7), backend.rows(backend.array(seen.copy()))
        since = backend.steps_since(rows, moved, 9)
        out = {"since": since, "count": backend.count(rows)}
        out["penalty"] = backend.motion_penalty(norm, a["motion"], a["by motion"], 0.3, since)
        backend.anchor(a["features"], backend.array(held.copy()), a["by features"], rows, 0.2)
        backend.mcmc_penalty(a, {"opacity": a["by opacity"], "scale": a["by scale"]}, 0.1, 0.2, 2.0)
        tensors = []
        for name, rate in (("motion", 1e-3), ("features", np.linspace(1e-3, 1e-2, 9)), ("w2", 1e-2)):
            parts = [backend.zeros(draw[name].shape) for _ in range(2)]
            steps, floor = backend.zeros((len(draw[name]),), np.int32), 0.1 if name == "motion" else 0.0
            tensors.append((a[name], a[f"by {name}"], *parts, steps, rate, floor, name == "w2"))
        for step in (9, 10):
            backend.adam(rows, tensors, (0.9, 0.999), moved, step, since if step == 9 else None)
        out |= {**a, "moved": moved} | {f"{i} {j}": each for i, tensor in enumerate(tensors) for j, each in enumerate(tensor[2:5])}
        out["by features"] = a["by features"]
        results.append({name: np.array(backend.numpy(array)) for name, array in out.items()})
    for name, wanted in results[0].items():
        found = results[1][name]
        assert found.dtype == wanted.dtype and found.shape == wanted.shape, name
        np.testing.assert_allclose(found, wanted, rtol=2e-4, atol=1e-7, err_msg=name)


def test_shaking_moves_the_nearly_transparent_in_their_own_shape(gpu, rng):
    n = 4000
    model = random_model(rng, n, size=0.1)
    arrays = {name: np.array(array) for name, array in model.arrays.items()}
    arrays["opacity"][:2000], arrays["opacity"][2000:] = -8.0, 2.0
    arrays["rotation"][:], arrays["scale"][:] = (1, 0, 0, 0), np.log([0.1, 0.2, 0.4])
    moved = []
    for key in ((1, 2), (1, 2), (1, 3)):
        parameters = {name: gpu.array(array.copy()) for name, array in arrays.items()}
        gpu.mcmc_noise(parameters, 10.0, key)
        moved.append(gpu.numpy(parameters["position"]) - arrays["position"])
    assert np.array_equal(moved[0], moved[1]) and not np.array_equal(moved[0], moved[2])
    assert not moved[0][2000:].any()
    gate = 1 / (1 + np.exp(-100 * (1 - 1 / (1 + np.exp(8.0)) - 0.995)))
    np.testing.assert_allclose(moved[0][:2000].std(0) / (10 * gate * np.array([0.01, 0.04, 0.16])), 1, atol=0.06)
    assert np.abs(moved[0][:2000].mean(0)).max() < 0.06


def test_a_run_ends_where_the_cpus_does(gpu, adapter):
    """Held-out views, after $FASTGS_GPU_STEPS steps (the campaign takes 300)."""
    capture, store, points = toy_capture(frames=4, views=5)
    chosen = settings.settings(iterations=STEPS, preview_every=0, max_gaussians=600)
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    found = []
    for name in ("cpu", f"gpu:{adapter.name}"):
        trainer = Trainer(capture, store, chosen, Start(model), backend=name)
        while trainer.iteration < STEPS:
            trainer.step()
        found.append(trainer.measure(capture.held_out)[0])
    assert abs(found[0] - found[1]) < 0.1


@pytest.mark.parametrize("density", ["default", "mcmc"])
def test_what_is_held_stays(gpu, adapter, density):
    """Segments of a long capture hold what stands still, number for number; the rest is trained."""
    capture, store, points = toy_capture(frames=4, views=3)
    chosen = settings.settings(iterations=8, preview_every=0, max_gaussians=200, density=density, densify_from=0.0, densify_every=4,
                               densify_threshold=0.0, exposures="off", clocks="off", poses="off")
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    first.opacity[:40:2] = -7.0
    trainer = Trainer(capture, store, chosen, Start(first, frozen=33), backend=f"gpu:{adapter.name}")
    for _ in range(6):
        trainer.step()
    after = trainer.model()
    assert len(after) > len(first) and (after.position[33:60] != first.position[33:60]).any()
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(after.arrays[name][:33], array[:33], err_msg=name)


def test_whatever_stage_of_a_step_fails_is_a_device_error(gpu, monkeypatch):
    """Then the run goes on on the CPU from its last checkpoint (test_gpu_devices.py)."""
    capture, store, points = toy_capture(frames=2, views=3)
    chosen = settings.settings(iterations=100, density="mcmc", densify_from=0.0, preview_every=0, motion_weight=0.1,
                               regulariser="group")
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    native, subgroups, pipelines, pipeline = gpu.device.native, gpu.device.subgroups, gpu.device._pipelines, Device._pipeline
    broken, used = [], set()

    def steps():
        device = Device(gpu.device.adapter, _pipelines=pipelines)
        device.__dict__ |= {"native": native, "subgroups": subgroups}
        monkeypatch.setitem(backends.loaded, "gpu:fresh", GPU(lambda: device))
        trainer = Trainer(capture, store, chosen, Start(model, np.full(len(points), 0.3)), backend="gpu:fresh")
        for _ in range(2):
            trainer.step()

    def failing(self, stage, constants):
        used.add(stage)
        if stage in broken:
            raise RuntimeError("Parent device is lost")
        return pipeline(self, stage, constants)

    monkeypatch.setattr(Device, "_pipeline", failing)
    steps()
    assert {"project", "tiles_pad", "raster", "loss_slope", "raster_backward", "project_backward", "penalty", "anchor", "mcmc_penalty",
            "mcmc_noise",
            "adam", "moved", "observe"} <= used
    for stage in sorted(used):
        broken[:] = [stage]
        with pytest.raises(DeviceError, match="device is lost"):
            steps()


def test_torch_differentiates_by_pose_on_the_gpu(gpu, adapter, rng):
    """The same gradients as on the CPU, and those of the pose are the picture's differences on the GPU (gradcheck)."""
    from fastgs_blender import torch as ours

    model = random_model(rng, 40, "cubic", "line", "radial", "sigmoid", extent=0.6, size=0.2)
    camera = fg.Camera(WIDTH, HEIGHT, 50, 55, 22, 21, random_pose(rng, 3.0))
    found = []
    for name in ("cpu", f"gpu:{adapter.name}"):
        parameters, pose = ours.tensors(model), torch.zeros(6, dtype=torch.float64, requires_grad=True)
        picture = ours.render(parameters, model, camera, 0.4, pose=pose, backend=name)
        (picture.rgb.square().sum() + picture.alpha.sum()).backward()
        found.append({"pose": pose.grad.numpy(), **{name: tensor.grad.numpy() for name, tensor in parameters.items()}})
    for name, wanted in found[0].items():
        assert relative(found[1][name], wanted) <= 1e-4, name
    constant, weights = {name: tensor.detach() for name, tensor in parameters.items()}, torch.from_numpy(rng.normal(size=(18, 22, 3)))
    eye = fg.Camera(22, 18, 24, 22, 10.3, 9.6, random_pose(rng, 2.5))

    def value(pose):
        return (ours.render(constant, model, eye, 0.4, pose=pose, band=0.02, backend=f"gpu:{adapter.name}").rgb.double() * weights).sum()

    at = torch.tensor([0.02, -0.01, 0.03, 0.1, 0.05, -0.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(value, (at,), eps=1e-3, atol=5e-2, rtol=1e-2)


def test_the_backend_offers_what_the_protocol_says(gpu):
    import inspect

    for method in (each for each in dir(TrainingBackend) if not each.startswith("_")):
        wanted = list(inspect.signature(getattr(TrainingBackend, method)).parameters)[1:]
        assert list(inspect.signature(getattr(gpu, method)).parameters)[:len(wanted)] == wanted, method


def test_a_run_follows_the_cpus_and_goes_on_to_the_byte(gpu, adapter, monkeypatch):
    """A run on the GPU is near the CPU's, and nothing is read back within a step.  Continued from its state in the middle, several steps
    ahead of their values and with tile lists that are guessed too short in every step, it gives the same bytes."""
    capture, store, points = toy_capture(frames=3, views=3)
    chosen = settings.settings(iterations=8, densify_every=4, densify_from=0.0, densify_until=1.0, densify_threshold=1e-6, preview_every=0,
                               motion_weight=0.1, batch=2)
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    sizes = np.where(np.arange(len(points)) < 10, 0.3, np.nan)
    name = f"gpu:{adapter.name}"
    ours, theirs = (Trainer(capture, store, chosen, Start(model, sizes), backend=each) for each in (name, "cpu"))
    reads, read, sizes = [], Device.read, set()
    monkeypatch.setattr(Device, "read", lambda self, *given: reads.append(given) or read(self, *given))
    for number in range(8):
        reads.clear()
        mine, other = ours.step(), theirs.step()
        assert not reads or mine["reduction"] not in sizes or ours.strategy.acts(number + 1)
        sizes.add(mine["reduction"])
        if number < 4:  # until density control may choose others
            assert mine["seen"] == other["seen"]
            np.testing.assert_allclose([mine[key] for key in ("loss", "psnr", "motion_penalty")],
                                       [other[key] for key in ("loss", "psnr", "motion_penalty")], rtol=2e-3)
        if number == 4:
            middle = {key: array.copy() for key, array in ours.state()[0].items()}, ours.state()[1]
    resumed = Trainer(capture, store, chosen, backend=name)
    resumed.restore(*middle)
    backward, begun, finished = resumed._backward, [], []
    monkeypatch.setattr(guesses, "LEAST", 16)
    monkeypatch.setattr(resumed, "_backward", lambda *given: begun.append(resumed.iteration) or backward(*given))
    while resumed.iteration < 8:
        for guess in gpu.device.guesses.values():
            guess.largest = guess.largest if resumed.iteration in begun else 20
        finished += [values["iteration"] for values in resumed.advance()]
    assert begun == [5, 6, 7, 5, 6, 7] and finished == [6, 7, 8], "what did not fit was taken again"
    mine, other = ours.state()[0], resumed.state()[0]
    assert mine.keys() == other.keys()
    assert all(np.array_equal(mine[key], other[key], equal_nan=True) for key in mine)


@pytest.mark.slow
def test_values_come_steps_later_and_nothing_waits_for_them(gpu, adapter, monkeypatch):
    """The same values and the same model as from steps that are waited for one by one, and from a run that is continued; cameras'
    exposures, clocks and poses are estimated meanwhile."""
    capture, store, points = toy_capture(frames=2, views=3)
    chosen = settings.settings(iterations=14, preview_every=0, exposures="on", clocks="on", poses="on", density="mcmc", densify_from=0.9)
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    model = replace(model, opacity=np.full(len(model), 4.0), scale=model.scale + 1)  # solid, so that exposures are compared
    slow, fast = (Trainer(capture, store, chosen, Start(model), backend=f"gpu:{adapter.name}") for _ in range(2))
    wanted = [slow.step() for _ in range(7)]
    middle = slow.state()
    wanted += [slow.step() for _ in range(5)]
    monkeypatch.setattr(Device, "read", lambda *given: pytest.fail("the GPU is waited for"))
    found = []
    for number in range(12):
        found += fast.advance()
        assert len(found) == max(number + 1 - 8, 0)
    assert found + fast.finish() == wanted and fast.finish() == []
    monkeypatch.undo()
    resumed = Trainer(capture, store, chosen, backend=f"gpu:{adapter.name}")
    resumed.restore(*middle)
    assert [resumed.step() for _ in range(5)] == wanted[7:]
    assert middle[0]["cameras.delayed.colour_sums"].any() and slow.cameras.response.colour_sums.any(), "exposures were compared"
    assert middle[0]["cameras.delayed.turn_sums"].any(), "poses were compared"
    for name, array in slow.state()[0].items():
        for other in (fast, resumed):
            assert np.array_equal(array, other.state()[0][name], equal_nan=True), name


def test_pictures_are_uploaded_as_bytes(gpu, rng, monkeypatch):
    stored = rng.integers(0, 256, (7, 5, 3), np.uint8)
    written, write = [], Device.write
    monkeypatch.setattr(Device, "write", lambda self, buffer, data, at=0: written.append(data.nbytes) or write(self, buffer, data, at))
    found = gpu.numpy(gpu.picture(None, stored))
    assert written == [-(-stored.size // 4) * 4], "four numbers to a word"
    np.testing.assert_allclose(found, stored / 255, rtol=1e-6)
    assert load_backend("cpu").picture(written, stored) is written
