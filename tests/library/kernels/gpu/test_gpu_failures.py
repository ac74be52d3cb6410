# SPDX-License-Identifier: GPL-3.0-or-later
"""A GPU that fails at any stage, allocation or read-back breaks no frame and no run (what a run does then: test_gpu_devices.py)."""
from __future__ import annotations

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import selftest, shaders
from fastgs_blender.kernels.gpu.backend import GPU
from fastgs_blender.kernels.gpu.device import Device
from fastgs_blender.kernels.protocol import DeviceError
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.util import backends
from fastgs_blender.util.backends import load_backend

LOST = "Parent device is lost"


@pytest.fixture
def another(gpu, monkeypatch):
    """Makes a device of its own the backend "gpu:fresh", and returns this one; it has the shaders of the others."""
    def make() -> GPU:
        device = Device(gpu.device.adapter, _pipelines=gpu.device._pipelines)
        device.__dict__ |= {name: getattr(gpu.device, name) for name in ("native", "subgroups")}
        monkeypatch.setitem(backends.loaded, "gpu:fresh", GPU(lambda: device))
        return backends.loaded["gpu:fresh"]

    return make


@pytest.fixture
def breaking(monkeypatch):
    """Counts what a device does, by kind, and lets it fail: breaking.at = (kind, number or stage) and all that follows of that kind."""
    class Breaking:
        at, seen = (None, 0), {}

    pipeline, create, read = Device._pipeline, Device._create, Device.read

    def check(kind, name, error):
        which = Breaking.seen.setdefault(kind, [])
        which.append(name)
        if Breaking.at[0] == kind and (name == Breaking.at[1] or (kind != "stage" and len(which) > Breaking.at[1])):
            raise error

    def out_of_memory(self, size):
        import wgpu

        self._try(lambda: check("memory", size, wgpu.GPUOutOfMemoryError("Out of memory")))
        return create(self, size)

    def lost(self, *given):
        self._try(lambda: check("read", given[2], RuntimeError(LOST)))
        return read(self, *given)

    def staged(self, stage, constants):
        check("stage", stage, RuntimeError(LOST))
        return pipeline(self, stage, constants)

    monkeypatch.setattr(Device, "_pipeline", staged)
    monkeypatch.setattr(Device, "_create", out_of_memory)
    monkeypatch.setattr(Device, "read", lost)
    return Breaking


def pictures(name: str) -> list[np.ndarray]:
    """Small pictures that take every stage: plain and with a decoder, behind triangles; then sorted by pixel and blurred, too."""
    rng = np.random.default_rng(6)
    instances = [Instance(random_model(rng, 30, "line", "line", "radial", look, size=0.3), np.eye(4), 0.3, name=look)
                 for look in ("sh1", "sigmoid")]
    camera, triangle = fg.Camera(22, 18, 18, 18, 11, 9, random_pose(rng, 3.0)), np.eye(3, dtype=np.float32)[None]
    sharp = fg.render(instances, camera, 0.0, ("rgb", "depth", "normal", "median_depth", "holdout"), name, holdout=triangle)
    blurred = fg.render(instances, camera, 0.0, ("rgb", "cryptomatte_00", "holdout"), name, holdout=triangle,
                        exposure=Exposure(-2, 2, steps=2, aperture=Aperture(0.1, 2.0, samples=2)), settings=PassSettings(sorting="pixel"))
    return [*sharp.values(), *blurred.values()]


@pytest.mark.slow
def test_no_picture_breaks_wherever_the_gpu_fails(gpu, adapter, another, breaking):
    """Lost at each stage and at each read-back, and out of memory at each allocation: the pictures are the GPU's or the CPU's."""
    cpu = pictures("cpu")
    another()
    ours, counts = pictures("gpu:fresh"), {kind: list(each) for kind, each in breaking.seen.items()}
    stages = sorted(set(counts["stage"]) - {"subgroups"})  # without these a GPU can do: test_gpu_lists.py
    assert {"project", "sort_scatter", "tiles_emit", "raster", "raster_by_pixel", "cover", "colour", "film", "film_sums",
            "draw_out"} <= set(stages)
    assert not all(np.array_equal(*both) for both in zip(ours, cpu, strict=True))
    cases = [("stage", stage) for stage in stages]
    cases += [(kind, number) for kind in ("memory", "read") for number in range(0, len(counts[kind]), 1 + len(counts[kind]) // 8)]
    for case in cases:
        breaking.seen.clear()
        breaking.at, backend = case, another()
        found = pictures("gpu:fresh")
        assert "memory" in backend.too_large and backend.failed is None if case[0] == "memory" else LOST in backend.failed, case
        for number, (one, theirs) in enumerate(zip(found, cpu, strict=True)):
            if number < 5:  # of the first picture the GPU may have given some before it failed
                np.testing.assert_allclose(one, theirs, 1e-4, 1e-4, err_msg=str((case, number)))
            else:
                assert np.array_equal(one, theirs), (case, number)


def test_a_step_without_memory_is_a_device_error(gpu, another, breaking):
    """At any allocation: then the run goes on from its last checkpoint."""
    capture, store, points = toy_capture(frames=2, views=3)
    chosen = settings.settings(iterations=100, density="mcmc", densify_from=0.0, preview_every=0, motion_weight=0.1)
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)

    def steps():
        another()
        Trainer(capture, store, chosen, Start(model), backend="gpu:fresh").step()

    steps()
    number = len(breaking.seen["memory"])
    assert number > 40
    for first in range(0, number, 1 + number // 5):
        breaking.seen.clear()
        breaking.at = "memory", first
        with pytest.raises(DeviceError, match="memory is full"):
            steps()


@pytest.mark.slow
def test_the_self_test_finds_every_stage_that_does_nothing(another, monkeypatch):
    """There is no stage that it does not run, so results that are wrong are not used, wherever they come from."""
    run, found = Device.run, set()
    for kind, works in selftest.WORKS.items():
        for work in works:
            wanted, used = work(load_backend("cpu")), set()
            monkeypatch.setattr(Device, "run", lambda self, stage, *rest, used=used, **more: used.add(stage) or run(
                self, stage, *rest, **more))
            assert selftest.fault_of(another(), kind, work, wanted) == ""
            for stage in sorted(used - found):
                monkeypatch.setattr(Device, "run", lambda self, name, *rest, stage=stage, **more: name == stage or run(
                    self, name, *rest, **more))
                if selftest.fault_of(another(), kind, work, wanted):
                    found.add(stage)
    texts = {file.stem: file.read_text("utf-8") for file in shaders.FOLDER.glob("*.wgsl") if file.stem != "threads"}
    every = {name for name, stage in texts.items() if "@compute" in stage or "\n//threads " in stage}
    assert every - found == {"subgroups"}, "without these a GPU can do (test_gpu_lists.py)"
