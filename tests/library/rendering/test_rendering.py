# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU kernels against the float64 oracle, and what render() promises."""
from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_cameras import hostile_scales, random_camera, random_pose
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import rasterise
from fastgs_blender.util import threads

TOLERANCE = 2e-4
PASSES = ("rgb", "alpha", "depth", "median_depth")
RASTERS = (fg.Raster(), fg.Raster(alpha_max=0.999, near=0.01), fg.Raster(blur=0.1, antialiased=True), fg.Raster(alpha_cut=0.05, near=1.0))


def near_the_cut(model, camera, t) -> np.ndarray:
    """Pixels where some splat's alpha is within 1e-5 of the cut: moving the cut that much changes them."""
    def render(cut):
        out = fg.render(replace(model, raster=replace(model.raster, alpha_cut=cut)), camera, t, backend="reference")
        return np.concatenate([out["rgb"], out["alpha"][..., None]], -1)

    cut = model.raster.alpha_cut
    return (np.abs(render(cut - 1e-5) - render(cut + 1e-5)) > 1e-7).any(-1)


@settings(max_examples=250)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 80), basis=st.sampled_from(sorted(BASES)), turning=st.sampled_from(sorted(BASES)),
       temporal=st.sampled_from(sorted(TEMPORALS)), appearance=st.sampled_from(APPEARANCES), raster=st.sampled_from(RASTERS),
       hostile=st.booleans(), size=st.floats(-2, -0.3), t=st.floats(-0.1, 1.1))
def test_kernels_agree_with_the_oracle(seed, n, basis, turning, temporal, appearance, raster, hostile, size, t):
    rng = np.random.default_rng(seed)
    sizes = {"scale": hostile_scales(rng, n)} if hostile else {}
    model = random_model(rng, n, basis, turning, temporal, appearance, size=10**size, raster=raster, **sizes)
    camera = random_camera(rng)
    fast, exact = (fg.render(model, camera, t, PASSES, backend) for backend in ("cpu", "reference"))
    difference = np.maximum(np.abs(fast["rgb"] - exact["rgb"]).max(-1), np.abs(fast["alpha"] - exact["alpha"]))
    if difference.max() > TOLERANCE:
        difference[near_the_cut(model, camera, t)] = 0
    assert difference.max() <= TOLERANCE
    covered = exact["alpha"] > 0
    assert np.array_equal(covered, fast["alpha"] > 0)
    for name in ("depth", "median_depth"):
        assert np.isinf(fast[name][~covered]).all() and np.isfinite(fast[name][covered]).all()
    np.testing.assert_allclose(fast["depth"][covered], exact["depth"][covered], rtol=1e-4)
    flips = np.abs(fast["median_depth"][covered] / exact["median_depth"][covered] - 1) > 1e-5
    assert np.count_nonzero(flips) <= 0.01 * flips.size


def cloud(rng, n=400, appearance="sh3", **fields):
    return random_model(rng, n, "paper", "line", "radial", appearance, size=0.08, **fields)


def test_one_gaussian_is_the_formula(rng):
    """alpha = sigma exp(-d^2 / 2 s^2) with s^2 = (f scale / z)^2 + blur, at pixel centres (rasterisers.md 3.1, 3.2)."""
    model = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.1] * 3]), opacity=[0.4],
                             features=[[0.2, 0.6, 0.9]])
    camera = fg.Camera(33, 21, 50, 50, 16.25, 10.5, np.eye(4))
    x, y = np.meshgrid(np.arange(33) + 0.5 - 16.25, np.arange(21) + 0.5 - 10.5)
    alpha = 1 / (1 + np.exp(-0.4)) * np.exp(-(x**2 + y**2) / (2 * (2.5**2 + 0.3)))
    alpha[alpha < 1 / 255] = 0
    for backend in ("cpu", "reference"):
        out = fg.render(model, camera, 0, PASSES, backend)
        np.testing.assert_allclose(out["alpha"], alpha, atol=2e-6)
        np.testing.assert_allclose(out["rgb"], alpha[..., None] * [0.2, 0.6, 0.9], atol=2e-6)
        np.testing.assert_allclose(out["depth"][alpha > 0], 2, rtol=2e-5)


def test_a_row_of_walls_stops_where_trainers_stop():
    """Before a splat that would leave 1e-4 or less; alpha_max bounds each; the median is where transmittance passes a half."""
    n = 4
    model = fg.GaussianModel(position=np.array([[0, 0, 2.0 + i] for i in range(n)]), rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                             scale=np.full((n, 3), 3.0), opacity=[np.log(0.4 / 0.6), 30.0, 30.0, 30.0], features=np.eye(4)[:, :3])
    camera = fg.Camera(8, 8, 10, 10, 4, 4, np.eye(4))
    for backend in ("cpu", "reference"):
        out = fg.render(model, camera, 0, PASSES, backend)
        # 1 -> 0.6 -> 0.006 -> 0.00006: the third splat is not blended
        np.testing.assert_allclose(out["rgb"][4, 4], [0.4, 0.594, 0], atol=3e-3)
        np.testing.assert_allclose(1 - out["alpha"], 0.006, atol=1e-4)
        assert (out["median_depth"] == 3).all()


@pytest.mark.parametrize("appearance", ["sh3", "clamp"])
def test_same_bytes_for_any_number_of_threads(rng, appearance):
    model, camera = cloud(rng, 5000, appearance), random_camera(rng, 300, 200, 3.0)

    def picture(count):
        threads.set_threads(count)
        return {k: v.tobytes() for k, v in fg.render(model, camera, 0.3, PASSES, "cpu").items()}

    try:
        once = picture(1)
        assert once == picture(2) == picture(7) == picture(1)
    finally:
        threads.set_threads(0)


def test_two_python_threads_render_at_once(rng):
    models = [cloud(rng), cloud(rng, appearance="sigmoid")]
    camera = random_camera(rng, 160, 120, 3.0)
    wanted = [fg.render(m, camera, 0.3, backend="cpu")["rgb"].tobytes() for m in models]
    wrong = []

    def work(i):
        pictures = [fg.render(models[i % 2], camera, 0.3, backend="cpu")["rgb"].tobytes() for _ in range(5)]
        wrong.extend(i for picture in pictures if picture != wanted[i % 2])

    workers = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not wrong


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_window_has_the_pixels_of_the_whole(rng, backend):
    model, camera = cloud(rng, appearance="sigmoid"), random_camera(rng, 90, 70, 3.0)
    whole = fg.render(model, camera, 0.3, PASSES, backend)
    part = fg.render(model, replace(camera, window=(37, 21, 40, 33)), 0.3, PASSES, backend)
    for name in PASSES:
        assert np.array_equal(part[name], whole[name][21:54, 37:77])


def test_bands_do_not_show(rng, monkeypatch):
    model, camera = cloud(rng), random_camera(rng, 200, 150, 3.0)
    whole = fg.render(model, camera, 0.3, PASSES, "cpu")
    monkeypatch.setattr(rasterise, "ENTRIES", 100)
    banded = fg.render(model, camera, 0.3, PASSES, "cpu")
    assert all(np.array_equal(whole[name], banded[name]) for name in PASSES)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("appearance", ["rgb", "sh3", "sigmoid"])
def test_turning_object_and_camera_together_changes_nothing(rng, backend, appearance):
    """Spherical harmonics and decoder rays turn with the object."""
    model, camera = cloud(rng, appearance=appearance), random_camera(rng, 64, 48, 3.0)
    placement = random_pose(rng, 0.5)
    moved = replace(camera, world_to_camera=camera.world_to_camera @ np.linalg.inv(placement))
    a = fg.render(model, camera, 0.3, backend=backend)["rgb"]
    b = fg.render([(model, placement, 0.3)], moved, backend=backend)["rgb"]
    np.testing.assert_allclose(a, b, atol=5e-5)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_objects_are_sorted_as_one_cloud(rng, backend):
    """Two halves of a model with two times and an unevenly scaled placement, against one model stretched by hand."""
    model = random_model(rng, 300, "paper", appearance="rgb", size=0.08, rotation=np.tile([1.0, 0, 0, 0], (300, 1)))
    camera = random_camera(rng, 64, 48, 4.0)
    stretch, shift = np.array([1.5, 0.5, 0.8]), np.array([0.2, -0.1, 0.3])
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = np.diag(stretch), shift
    later = fg.freeze(model, 0.7)
    by_hand = replace(later, position=later.position * stretch + shift, scale=later.scale + np.log(stretch).astype(np.float32))
    near = replace(model.raster, near=0.0)
    model.raster = by_hand.raster = near
    halves = [(model.take(np.s_[::2]), placement, 0.7), (model.take(np.s_[1::2]), placement, 0.7)]
    together = fg.render(halves, camera, passes=PASSES, backend=backend)
    alone = fg.render(by_hand, camera, passes=PASSES, backend=backend)
    np.testing.assert_allclose(together["rgb"], alone["rgb"], atol=TOLERANCE)
    np.testing.assert_allclose(together["alpha"], alone["alpha"], atol=TOLERANCE)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_decoders_and_colours_mix(rng, backend):
    """Where objects do not overlap, each looks as it does alone."""
    parts = []
    for i, appearance in enumerate(("sigmoid", "rgb", "clamp")):
        placement = np.eye(4)
        placement[0, 3] = 3 * (i - 1)
        parts.append((random_model(rng, 60, appearance=appearance, extent=0.4, size=0.1), placement, 0.2))
    pose = np.eye(4)
    pose[2, 3] = 6
    camera = fg.Camera(120, 40, 60, 60, 60, 20, pose)
    together = fg.render(parts, camera, passes=("rgb", "alpha"), backend=backend)
    alone = [fg.render([part], camera, passes=("rgb", "alpha"), backend=backend) for part in parts]
    assert all(np.count_nonzero(a["alpha"]) for a in alone)
    np.testing.assert_allclose(together["rgb"], sum(a["rgb"] for a in alone), atol=1e-5)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_gaussians_that_are_no_numbers_are_not_drawn(rng, backend):
    model = cloud(rng, 60)
    clean, camera = model.take(np.s_[9:]), random_camera(rng, 48, 40, 3.0)
    for i, name in enumerate(("position", "rotation", "scale", "opacity", "features", "motion", "rotation_motion", "mu_tau", "temporal")):
        getattr(model, name)[i] = np.nan
    out = fg.render(model, camera, 0.3, PASSES, backend)
    wanted = fg.render(clean, camera, 0.3, PASSES, backend)
    assert all(np.array_equal(out[name], wanted[name]) for name in PASSES)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_nothing_to_see(rng, backend):
    camera = random_camera(rng, 20, 10)
    model = random_model(rng, 0)
    for scene in ([], model, [(model, np.eye(4), 0.0)], random_model(rng, 5, opacity=np.full(5, -20.0))):
        out = fg.render(scene, camera, 0.0, PASSES, backend)
        assert not out["rgb"].any() and not out["alpha"].any() and np.isinf(out["depth"]).all() and np.isinf(out["median_depth"]).all()
        assert out["rgb"].shape == (10, 20, 3) and out["depth"].shape == (10, 20) and out["depth"].dtype == np.float32


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_progress_rises_and_can_cancel(rng, backend):
    model, camera = cloud(rng), random_camera(rng, 64, 48, 3.0)
    seen = []
    fg.render(model, camera, 0.3, backend=backend, progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0

    class StopNowError(Exception):
        pass

    def stop(fraction):
        raise StopNowError

    with pytest.raises(StopNowError):
        fg.render(model, camera, 0.3, backend=backend, progress=stop)


def test_read_only_models_render(rng):
    model, camera = cloud(rng), random_camera(rng, 64, 48, 3.0)
    wanted = fg.render(model, camera, 0.3, backend="cpu")["rgb"]
    for array in model.arrays.values():
        array.flags.writeable = False
    assert np.array_equal(fg.render(model, camera, 0.3, backend="cpu")["rgb"], wanted)


@pytest.mark.parametrize(("call", "words"), [
    (lambda m, c: fg.render(m, c, passes=("colour",)), "pass 'colour'"),
    (lambda m, c: fg.render(m, c, backend="cuda9"), "backend 'cuda9'"),
    (lambda m, c: fg.render([(m, np.eye(3), 0)], c), "4 x 4"),
    (lambda m, c: fg.render(m, c, float("nan")), "finite"),
    (lambda m, c: replace(c, window=(0, 0, 999, 1)), "window"),
    (lambda m, c: replace(c, width=0), "1 x 1"),
    (lambda m, c: replace(c, fx=0.0), "focal"),
    (lambda m, c: replace(m, features=m.features[:, :2]), "features"),
])
def test_bad_input_gets_a_sentence(rng, call, words):
    with pytest.raises(fg.FastGSError, match=words) as error:
        call(random_model(rng, 3), random_camera(rng))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_numbers_beyond_float32_leave_no_hole_in_a_picture(rng, backend):
    """An object 1e300 times as large is left out with a warning; the others are drawn as they are without it."""
    model, camera = random_model(rng, 40, "static"), fg.Camera(32, 24, 30, 30, 16, 12, random_pose(rng, 2.5))
    wanted = fg.render(model, camera, 0.3, PASSES, backend)
    for scale in (1e300, 1e40):
        with pytest.warns(fg.LossWarning, match="not drawn"):
            got = fg.render([(model, np.eye(4), 0.3), (model, np.diag([scale] * 3 + [1]), 0.3)], camera, passes=PASSES, backend=backend)
        assert all(np.array_equal(got[name], wanted[name]) for name in PASSES)
    far = replace(model, position=model.position * np.float32(1e36))  # its own numbers are as large
    for name, image in fg.render([(model, np.eye(4), 0.3), (far, np.diag([100, 100, 100, 1]), 0.3)], camera, passes=PASSES,
                                 backend=backend).items():
        assert not np.isnan(image).any() and np.isfinite(image[wanted["alpha"] > 0]).all(), name
    bright = replace(model, features=np.full_like(model.features, 3e38))
    assert np.isfinite(fg.render(bright, camera, 0.3, backend=backend)["rgb"]).all()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("activation", ["sigmoid", "clamp", "none"])
def test_a_decoder_of_huge_weights_gives_finite_colours(rng, backend, activation):
    decoder = fg.Features(rng.normal(0, 3e38, (6, 12)).clip(-3e38, 3e38), rng.normal(0, 3e38, (3, 6)).clip(-3e38, 3e38), activation)
    model = replace(random_model(rng, 40, "static", appearance="none"), appearance=decoder)
    with pytest.warns(fg.LossWarning, match="decoder"):
        out = fg.render(model, fg.Camera(32, 24, 30, 30, 16, 12, random_pose(rng, 2.5)), 0.3, backend=backend)
    assert np.isfinite(out["rgb"]).all() and out["alpha"].max() > 0.1


def test_an_instance_that_cannot_be_computed_with_says_so(rng):
    from fastgs_blender.rendering.instances import Instance

    model = random_model(rng, 3, "static")
    for placement, t in ((np.full((4, 4), np.nan), 0.0), (np.eye(3), 0.0), (np.eye(4), np.inf)):
        with pytest.raises(fg.FastGSError):
            Instance(model, placement, t)
