# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the GPU backend against the oracle and the CPU, and what it does when a GPU fails."""
from __future__ import annotations

import os
import weakref
from dataclasses import replace

import numpy as np
import pytest
from random_cameras import hostile_scales, random_camera, random_pose
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.kernels.gpu import blend, device, picture, pipelines, scene
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.instances import AS_TRAINED, Instance, ObjectSettings
from fastgs_blender.rendering.passes import PASSES, PassSettings
from fastgs_blender.rendering.volumes import mesh_volume
from fastgs_blender.util import backends

SCENES = int(os.environ.get("FASTGS_GPU_SCENES", "24"))
RASTERS = (fg.Raster(), fg.Raster(alpha_max=0.999, near=0.01), fg.Raster(blur=0.1, antialiased=True), fg.Raster(alpha_cut=0.05, near=1.0))
CLOSE, MEAN = 2e-3, 1e-5


def name_of(gpu_adapter) -> str:
    return f"gpu:{gpu_adapter.name}"


def near_the_cut(model, camera, t) -> np.ndarray:
    """Pixels where some splat's alpha is within 1e-5 of the cut: moving the cut that much changes them."""
    def moved(by):
        raster = replace(model.raster, alpha_cut=model.raster.alpha_cut + by)
        out = fg.render(replace(model, raster=raster), camera, t, backend="reference")
        return np.concatenate([out["rgb"], out["alpha"][..., None]], -1)

    return (np.abs(moved(-1e-5) - moved(1e-5)) > 1e-7).any(-1)


def random_scene(seed):
    """(model, camera, t): every kind of basis, temporal opacity, appearance and rasteriser turns up."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 81))
    bases, kinds = sorted(BASES), sorted(TEMPORALS)
    sizes = {"scale": hostile_scales(rng, n)} if seed % 2 else {}
    model = random_model(rng, n, bases[seed % len(bases)], bases[seed // 8 % len(bases)], kinds[seed // 3 % len(kinds)],
                         APPEARANCES[seed % len(APPEARANCES)], size=10 ** rng.uniform(-2, -0.3), raster=RASTERS[seed // 2 % 4], **sizes)
    return model, random_camera(rng), rng.uniform(-0.1, 1.1)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, SCENES, 8))
def test_random_scenes_agree_with_the_oracle(gpu, adapter, first):
    for seed in range(first, first + 8):
        model, camera, t = random_scene(seed)
        got = fg.render(model, camera, t, ("rgb", "alpha", "depth", "median_depth"), name_of(adapter))
        exact = fg.render(model, camera, t, ("rgb", "alpha", "depth"), "reference")
        difference = np.maximum(np.abs(got["rgb"] - exact["rgb"]).max(-1), np.abs(got["alpha"] - exact["alpha"]))
        if difference.max() > CLOSE or difference.mean() > MEAN:
            difference[near_the_cut(model, camera, t)] = 0
        assert difference.max() <= CLOSE and difference.mean() <= MEAN, seed
        covered = (exact["alpha"] > 0) & (got["alpha"] > 0)
        assert np.count_nonzero(covered != (exact["alpha"] > 0)) <= 2, seed
        np.testing.assert_allclose(got["depth"][covered], exact["depth"][covered], rtol=1e-3, err_msg=str(seed))
        assert np.isfinite(got["median_depth"][covered]).all()
    again = fg.render(model, camera, t, ("rgb", "alpha", "depth", "median_depth"), name_of(adapter))
    assert all(np.array_equal(got[name], again[name]) for name in got)


@pytest.mark.parametrize("activation", ["sigmoid", "clamp", "none"])
def test_decoders_of_premultiplied_sums_agree_with_the_oracle(gpu, adapter, rng, activation):
    """On both films, with a look, and beside another model."""
    look = fg.Features(rng.normal(0, 0.7, (6, 12)), rng.normal(0, 0.7, (3, 6)), activation, "premultiplied")
    model = random_model(rng, 40, "cubic", "line", "radial", look, extent=0.5, size=0.2)
    camera = fg.Camera(48, 36, 26, 28, 23.3, 18.4, random_pose(rng, 3.0))
    other = random_model(rng, 20, size=0.05)
    for settings in (PassSettings(), PassSettings(film="transparent")):
        for given in ([Instance(model, np.eye(4), 0.3, ObjectSettings())], [Instance(model, np.eye(4), 0.3, ObjectSettings(exposure=0.5))],
                      [Instance(model, np.eye(4), 0.3), Instance(other, np.eye(4), 0.0)]):
            got, exact = (fg.render(given, camera, backend=backend, settings=settings) for backend in (name_of(adapter), "reference"))
            assert (exact["alpha"] == 0).any() and (exact["alpha"] > 0.9).any()
            np.testing.assert_allclose(got["rgb"], exact["rgb"], atol=CLOSE)


@pytest.fixture(scope="module")
def crowd():
    """Instances of every kind of look and crop, and their camera, whose window is part of an image."""
    rng = np.random.default_rng(5)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
                      [1, 5, 7], [1, 7, 3]])
    box = np.eye(4) * (1.2, 1.2, 1.2, 1)
    crops = (Crop(box, shape="SPHERE", soft=0.3), Crop(box, shape=mesh_volume(corners, faces, corners[0], corners[-1])),
             Crop(np.eye(4) * (3, 3, 3, 1), remove=True))
    graded = dict(exposure=0.5, contrast=1.2, saturation=0.7, hue=0.4, tint=(1, 0.9, 0.8))
    looks = (ObjectSettings(crops=crops), ObjectSettings(**graded), ObjectSettings(**graded, splat_scale=1.5, min_size=0.02),
             ObjectSettings(opacity=0.7, opacity_cut=0.2, max_size=0.1), ObjectSettings(filters=()))
    kinds = ("sh1", "sigmoid", "rgb", "clamp", "changing sh1")
    instances = [Instance(random_model(rng, 90, "fourier", "line", "radial", kind, size=0.15), random_pose(rng, 0.0), 0.3, look, name=kind,
                          index=i) for i, (kind, look) in enumerate(zip(kinds, looks))]
    return instances, fg.Camera(90, 70, 60, 60, 45, 35, random_pose(rng, 3.0), window=(11, 5, 70, 52))


@pytest.mark.parametrize("orthographic", [False, True])
def test_far_views_agree_with_the_cpu(gpu, adapter, orthographic):
    """Seen from farther than from the capture's cameras, splats are as faint as on the CPU."""
    rng = np.random.default_rng(8)
    near = fg.Camera(300, 200, 300, 300, 150, 100, random_pose(rng, 2.5))
    model = random_model(rng, 400, "fourier", "line", "radial", "sh1", size=0.02)
    model = replace(model, surroundings=Surroundings(cameras=(viewpoint_of(near),)))
    focal = 12.0 if orthographic else 30.0
    camera = replace(near, width=60, height=40, fx=focal, fy=focal, cx=30, cy=20, window=None, orthographic=orthographic)
    wanted, got, plain = (fg.render([Instance(model, np.eye(4), 0.3, ObjectSettings(antialias=antialias))], camera, backend=backend)
                          for backend, antialias in (("cpu", True), (name_of(adapter), True), (name_of(adapter), False)))
    assert np.abs(got["rgb"] - wanted["rgb"]).max() < CLOSE and np.abs(got["alpha"] - wanted["alpha"]).max() < CLOSE
    assert np.abs(plain["alpha"] - got["alpha"]).max() > 0.05


@pytest.mark.parametrize("sorting", ["centre", "pixel"])
@pytest.mark.parametrize("orthographic", [False, True])
def test_views_in_finer_pixels_agree_with_the_cpu(gpu, adapter, orthographic, sorting):
    """Splats are as soft as on the CPU, each as the capture's cameras saw it that have it in their picture; beside crops with volumes."""
    rng = np.random.default_rng(9)
    films = [fg.Camera(40, 30, focal, focal, 20, 15, random_pose(rng, distance)) for focal, distance in ((30, 2.5), (15, 4.0), (30, 1.5))]
    model = random_model(rng, 400, "fourier", "line", "radial", "sh1", size=0.01)
    model = replace(model, surroundings=Surroundings(cameras=tuple(map(viewpoint_of, films))))
    focal = 40.0 if orthographic else 120.0
    camera = replace(films[0], width=160, height=120, fx=focal, fy=focal, cx=80, cy=60, window=None, orthographic=orthographic)
    looks = (ObjectSettings(pixel_size=0.02, crops=(Crop(np.eye(4)),)), ObjectSettings(antialias=False, crops=(Crop(np.eye(4)),)))
    wanted, got, plain = (fg.render([Instance(model, np.eye(4), 0.3, look)], camera, ("rgb", "alpha", "depth"), backend=backend,
                                    settings=PassSettings(sorting=sorting))
                          for backend, look in (("cpu", looks[0]), (name_of(adapter), looks[0]), (name_of(adapter), looks[1])))
    assert np.abs(got["rgb"] - wanted["rgb"]).max() < CLOSE and np.abs(got["alpha"] - wanted["alpha"]).max() < CLOSE
    assert np.abs(plain["alpha"] - got["alpha"]).max() > 0.05


def test_what_reaches_the_cameras_plane_agrees_with_the_oracle(gpu, adapter):
    rng = np.random.default_rng(7)
    n = 150
    model = fg.GaussianModel(position=np.c_[rng.uniform(-1.5, 1.5, (n, 2)), rng.uniform(0.1, 1.5, n)], rotation=rng.normal(size=(n, 4)),
                             scale=np.log(0.02) + rng.uniform(0, np.log(50), (n, 3)), opacity=rng.normal(0, 2, n),
                             features=rng.uniform(0, 1, (n, 3)), raster=fg.Raster(near=0.0))
    camera = fg.Camera(64, 36, 53, 53, 32, 18, np.eye(4))
    cases = ((ObjectSettings(), name_of(adapter)), (ObjectSettings(), "reference"), (AS_TRAINED, "reference"))
    found, wanted, straight = (fg.render([Instance(model, np.eye(4), 0, look)], camera, backend=name)["rgb"] for look, name in cases)
    assert np.abs(found - wanted).mean() < 1e-4 and np.abs(found - wanted).max() < 0.01
    assert np.abs(straight - wanted).max() > 0.1, "some of it is beside the picture"


@pytest.mark.slow
def test_all_passes_of_several_instances_agree_with_the_cpu(gpu, adapter, crowd):
    instances, camera = crowd
    wanted, got = (fg.render(instances, camera, passes=tuple(PASSES), backend=name) for name in ("cpu", name_of(adapter)))
    assert wanted["alpha"].mean() > 0.2
    for name in PASSES:
        ours, theirs = (np.nan_to_num(found[name], posinf=-1) for found in (got, wanted))
        different = np.abs(ours - theirs) > 2e-3 * np.maximum(np.abs(theirs), 1)
        assert different.mean() < 0.003, name


def test_bands_and_packs_change_no_byte(gpu, fresh, adapter, crowd, monkeypatch):
    """With bindings of 64 KiB the model lies in several buffers and the picture in several bands, and parts are parts of the whole."""
    camera = crowd[1]
    instances = [Instance(random_model(np.random.default_rng(1), 700, "fourier", "line", "radial", "sh1"), np.eye(4), 0.3)]
    whole = fg.render(instances, camera, passes=("rgb", "depth"), backend=name_of(adapter))
    monkeypatch.setattr(blend, "ENTRIES", 1500)
    fresh.backend.device.binding = 1 << 16
    pieces = []
    monkeypatch.setattr(blend, "blend", lambda *given, one=blend.blend: pieces.append(one(*given)) or pieces[-1])
    bands = fg.render(instances, camera, passes=("rgb", "depth"), backend=fresh.name)
    assert fresh.backend.failed is None and len(pieces) > 1
    assert len(scene.packs(fresh.backend.device, instances[0].model.arrays, 700)) > 1
    assert all(np.array_equal(whole[name], bands[name]) for name in whole)
    triangle, number = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32), len(pieces)
    fresh.backend.device.binding = 1 << 17
    held = [fg.render(instances, camera, passes=("rgb", "holdout"), backend=name, holdout=triangle)
            for name in (name_of(adapter), fresh.name)]
    assert all(np.array_equal(held[0][name], held[1][name]) for name in held[0]) and held[0]["holdout"].max() > 0
    assert fresh.backend.failed is None and len(pieces) > number + 2
    part = replace(camera, window=(30, 20, 17, 23))
    cut = fg.render(instances, part, passes=("rgb",), backend=name_of(adapter))["rgb"]
    assert np.array_equal(cut, whole["rgb"][15:38, 19:36])


def test_splats_lie_in_several_buffers_and_are_gathered_for_each_band(gpu, fresh, adapter):
    """With bindings of 64 KiB the rows of all Gaussians do not fit into one; those that a band shows do.  No byte changes."""
    rng = np.random.default_rng(4)
    instances = [Instance(random_model(rng, n, "fourier", "line", "radial", "rgb", size=0.05), random_pose(rng, 0.0), 0.3, name=str(n))
                 for n in (1100, 700)]
    camera = fg.Camera(40, 30, 40, 40, 20, 15, random_pose(rng, 3.0))
    passes = ("rgb", "alpha", "depth", "normal", "object_index")
    whole = fg.render(instances, camera, passes=passes, backend=name_of(adapter))
    fresh.backend.device.binding = 1 << 16
    ran, run = [], device.Device.run
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(device.Device, "run", lambda self, stage, *rest, **more: ran.append(stage) or run(self, stage, *rest, **more))
        found = fg.render(instances, camera, passes=passes, backend=fresh.name)
    assert fresh.backend.failed is None and ran.count("gather_rows") > 1 and whole["alpha"].mean() > 0.05
    assert all(np.array_equal(whole[name], found[name], equal_nan=True) for name in whole)


def test_models_that_nothing_changes_stay_on_the_gpu(fresh, tmp_path, monkeypatch):
    """As long as something else refers to them, up to a number of bytes, and until the device's memory is full."""
    rng, camera = np.random.default_rng(2), fg.Camera(20, 16, 16, 16, 10, 8, np.eye(4))
    for number in range(2):
        fg.save(random_model(rng, 64), tmp_path / f"{number}.safetensors")
    uploaded, packs = [], picture.packs
    monkeypatch.setattr(picture, "packs", lambda device, arrays, count: uploaded.append(1) or packs(device, arrays, count))

    def uploads(*models):
        uploaded.clear()
        for model in models:
            fg.render(model, camera, backend=fresh.name)
        return len(uploaded)

    first, second = (fg.open_source(tmp_path / f"{number}.safetensors") for number in range(2))
    mine, models = fg.load(tmp_path / "0.safetensors"), fresh.backend.models
    assert uploads(mine, mine) == 2, "may be changed"
    assert uploads(first, second, first, second, first) == 2 == len(models.kept)
    buffers = weakref.ref(models.kept[first][0].buffer)
    size = buffers().size
    spare = fresh.backend.device._spare_bytes
    del first
    assert buffers() is None and len(models.kept) == 1 and fresh.backend.device._spare_bytes == spare, "its memory is free"
    first = fg.open_source(tmp_path / "0.safetensors")
    monkeypatch.setattr(picture, "KEPT", size)
    assert uploads(first, second, first) == 3 and list(models.kept) == [first], "the last one"
    fresh.backend.device._let_go()
    assert not models.kept and uploads(first) == 1


@pytest.mark.parametrize("stage", ["project", "sort_scatter", "raster", "colour", "read"])
def test_what_fails_is_drawn_by_the_cpu_and_told_in_a_line(fresh, crowd, monkeypatch, caplog, stage):
    import wgpu

    instances, camera = crowd
    done = device.Device._pipeline
    native = fresh.backend.device.native

    def broken(self, name, constants):
        if name == stage:
            raise wgpu.GPUValidationError("Validation Error\n\nCaused by:\n  In wgpuQueueSubmit\n    Parent device is lost")
        return done(self, name, constants)

    def lost(*args, **kwargs):
        raise RuntimeError("Parent device is lost")

    if stage == "read":
        monkeypatch.setattr(native.queue, "read_buffer", lost)
    else:
        monkeypatch.setattr(device.Device, "_pipeline", broken)
    passes = ("rgb", "alpha", "median_depth")
    wanted, got, again = (fg.render(instances, camera, passes=passes, backend=name) for name in ("cpu", fresh.name, fresh.name))
    assert all(np.array_equal(wanted[name], found[name]) for name in passes for found in (got, again))
    assert len(caplog.records) == 1 and caplog.messages[0].startswith("the GPU fails, so the CPU goes on: ")
    assert "lost" in caplog.messages[0]


@pytest.mark.parametrize("why", ["the memory is full", "a row of tiles has too many splats"])
def test_what_does_not_fit_concerns_its_own_picture_alone(fresh, adapter, crowd, monkeypatch, caplog, why):
    """The CPU draws it, and the GPU draws the next one."""
    import wgpu

    instances, camera = crowd
    passes = ("rgb", "alpha", "median_depth")
    wanted, whole = (fg.render(instances, camera, passes=passes, backend=name) for name in ("cpu", name_of(adapter)))

    def full(*args, **kwargs):
        raise wgpu.GPUOutOfMemoryError("Out of memory\n")

    with monkeypatch.context() as patch:
        if "memory" in why:
            patch.setattr(fresh.backend.device.native, "create_buffer", full)
        else:
            patch.setattr(blend, "ENTRIES", 9)
        for _ in range(2):
            got = fg.render(instances, camera, passes=passes, backend=fresh.name)
            assert all(np.array_equal(wanted[name], got[name]) for name in passes)
    again = fg.render(instances, camera, passes=passes, backend=fresh.name)
    assert fresh.backend.failed is None and all(np.array_equal(whole[name], again[name]) for name in passes)
    assert len(caplog.records) == 1 and caplog.messages[0].startswith("a picture does not fit on the GPU, so the CPU draws it: ")
    assert backends.take_overflow(fresh.name) and not backends.take_overflow(fresh.name)


def test_a_refused_shader_is_told(fresh, crowd, monkeypatch, caplog):
    fresh.backend.device._pipelines = {}
    monkeypatch.setattr(pipelines.shaders, "source", lambda stage, *given, **constants: "fn main( {")
    instances, camera = crowd
    assert np.array_equal(fg.render(instances, camera, backend=fresh.name)["rgb"], fg.render(instances, camera, backend="cpu")["rgb"])
    assert "expected" in caplog.messages[0]


def test_cancelling_and_two_threads(gpu, adapter, crowd):
    import threading

    instances, camera = crowd
    seen = []

    def cancel(share):
        seen.append(share)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fg.render(instances, camera, backend=name_of(adapter), progress=cancel)
    wanted = fg.render(instances, camera, backend=name_of(adapter))["rgb"]
    wrong = []

    def work():
        wrong.extend(1 for _ in range(2) if not np.array_equal(fg.render(instances, camera, backend=name_of(adapter))["rgb"], wanted))

    workers = [threading.Thread(target=work) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert seen and not wrong
