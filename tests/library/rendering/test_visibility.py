# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussians that a viewport draws, and their order: with numba, without it, and against rendered pictures."""
from __future__ import annotations

import numpy as np
import pytest
from random_cameras import hostile_scales, random_camera
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import sort, visible
from fastgs_blender.rendering import importance, visibility
from fastgs_blender.rendering.instances import Instance


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("basis", "temporal"), [("paper", "radial"), ("cubic", "window"), ("smooth keys", "always"),
                                                   ("line", "radial-window")])
def test_only_what_is_seen_in_the_right_order(seed, basis, temporal):
    """A picture of the visible ones alone is the whole picture, and their depths ascend."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng)
    models = [random_model(rng, 60, basis, "line", temporal, scale=hostile_scales(rng, 60)) for _ in range(2)]
    placement = np.eye(4)
    placement[:3, :3] += rng.normal(0, 0.3, (3, 3))
    parts = [Instance(models[0], np.eye(4), 0.3).viewed(camera), Instance(models[1], placement, 0.6).viewed(camera)]
    order = visibility.order(parts, camera)
    np.testing.assert_array_equal(order, visibility.order(parts, camera, backend="reference"))
    seen = [(part.model.take(np.sort(order[(order >= 60 * k) & (order < 60 * (k + 1))] - 60 * k)), part.placement, part.t)
            for k, part in enumerate(parts)]
    everything = [(part.model, part.placement, part.t) for part in parts]
    for name, image in fg.render(everything, camera, backend="reference").items():
        np.testing.assert_array_equal(fg.render(seen, camera, backend="reference")[name], image)
    depth = []
    for part in parts:
        s = fg.slice_model(part.model, part.t, cull=False)
        depth.append(s.position @ part.model_to_camera[2, :3] + part.model_to_camera[2, 3])
    assert (np.diff(np.concatenate(depth)[order].astype(np.float32)) >= -1e-5).all()


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_camera_sees_no_farther_than_its_far_plane(orthographic):
    """In every backend, in pictures and in the order: as if what lies beyond were not there."""
    model = random_model(np.random.default_rng(4), 80, "static", "static", "always")
    pose = np.eye(4)
    pose[2, 3] = 4
    cameras = [fg.Camera(48, 40, 30, 30, 24, 20, pose, orthographic, far=far) for far in (np.inf, 4.0)]
    before = model.take(model.position[:, 2] + 4 <= 4)
    assert 10 < len(before) < 70
    for backend in ("cpu", "reference"):
        want, got = fg.render(before, cameras[0], backend=backend), fg.render(model, cameras[1], backend=backend)
        np.testing.assert_array_equal(got["rgb"], want["rgb"])
        order = visibility.order([Instance(model, np.eye(4), 0.0).viewed(cameras[1])], cameras[1], backend=backend)
        assert len(order) and (model.position[order, 2] <= 0).all()
    with pytest.raises(fg.FastGSError, match="far plane"):
        fg.Camera(4, 4, 4, 4, 2, 2, np.eye(4), near=1.0, far=1.0)


def test_most_of_what_is_not_seen_is_left_out():
    rng = np.random.default_rng(1)
    model = random_model(rng, 5000, extent=20, size=0.001)
    camera = fg.Camera(64, 64, 64, 64, 32, 32, np.eye(4), near=0.1)
    order = visibility.order([Instance(model, np.eye(4), 0.0).viewed(camera)], camera)
    x, y, z = model.position.T
    inside = (z > 0.2) & (abs(x) < 0.5 * z) & (abs(y) < 0.5 * z)
    assert inside.sum() * 0.5 < len(order) < inside.sum() * 1.2


@pytest.mark.parametrize("share", [0.8, 0.5, 0.2])
def test_a_share_is_what_counts_most_in_the_picture(share):
    """The nearest and most opaque of equal splats; and the picture is better than with those that are largest wherever one stands."""
    model = random_model(np.random.default_rng(2), 4000, size=0.05)
    pose = np.eye(4)
    pose[2, 3] = 2.5
    camera = fg.Camera(64, 64, 60, 60, 32, 32, pose)
    part = Instance(model, np.eye(4), 0.0).viewed(camera)
    whole = visibility.order([part], camera)
    orders = [visibility.order([part], camera, share, backend) for backend in ("cpu", "reference")]
    rank = importance.importance_rank(model)[whole]
    static = whole[rank <= np.quantile(rank, share)]
    exact = fg.render(model, camera)["rgb"]
    errors = [np.mean((fg.render(model.take(np.sort(order)), camera)["rgb"] - exact) ** 2) for order in (*orders, static)]
    for order, error in zip(orders, errors):
        assert abs(len(order) - share * len(whole)) < 0.03 * len(whole) and error < 0.7 * errors[2]
        depth = model.position[order, 2] + 2.5
        assert np.diff(depth).min() > -1e-3, "sorted by 16 bits"
    assert len(np.setxor1d(*orders)) < 0.02 * len(whole)


def test_of_equal_splats_a_share_is_drawn_and_always_the_same():
    n = 5000
    position = np.stack([*np.random.default_rng(0).uniform(-0.4, 0.4, (2, n)), np.full(n, 2.0)], 1)
    model = fg.GaussianModel(position=position, rotation=np.tile([1.0, 0, 0, 0], (n, 1)), scale=np.full((n, 3), -5.0), opacity=np.ones(n),
                             features=np.ones((n, 3)))
    cameras = [fg.Camera(64, 64, 40 + 20 * k, 40 + 20 * k, 32, 32, np.eye(4)) for k in range(2)]
    few, same = (visibility.order([Instance(model, np.eye(4), 0.0).viewed(camera)], camera, 0.25) for camera in cameras)
    assert 0.15 * n < len(few) < 0.3 * n and abs(position[few, 0].mean()) < 0.05
    np.testing.assert_array_equal(np.sort(few), np.sort(same))


@pytest.mark.parametrize(("basis", "temporal"), [("paper", "radial"), ("static", "always")])
def test_what_no_move_of_the_camera_changes_is_kept(basis, temporal, monkeypatch):
    """The same orders with and without it, of objects with a look, a crop and filters; a new time, or a new look, begins anew."""
    rng = np.random.default_rng(5)
    models = [random_model(rng, 3000, basis, "static", temporal, size=0.03) for _ in range(2)]
    placement = np.diag([2.0, 2, 2, 1])
    looks = [fg.ObjectSettings(splat_scale=1.5, crops=(fg.Crop(np.diag([0.5, 0.5, 0.5, 1]), soft=0.3),)), fg.ObjectSettings(density=0.5)]
    standing, made, stand = {}, [], visible._stand
    monkeypatch.setattr(visible, "_stand", lambda instance: made.append(instance) or stand(instance))

    def orders(distance, t=0.4, looks=looks):
        pose = np.eye(4)
        pose[:3, 3] = 0.2 * distance, 0, distance
        camera = fg.Camera(80, 64, 70, 70, 40, 32, pose)
        parts = [Instance(model, placement, t, look).viewed(camera) for model, look in zip(models, looks)]
        made.clear()
        kept = visibility.order(parts, camera, 0.6, standing=standing), len(made)
        exact = visibility.order(parts, camera)
        np.testing.assert_array_equal(kept[0], visibility.order(parts, camera, 0.6))
        assert np.isin(kept[0], exact).mean() > 0.95, "but for some at the borders of a small picture"
        return kept[1]

    assert [orders(3.0), orders(3.5), orders(2.5)] == [2, 0, 0]
    assert orders(2.5, t=0.6) == 2 and len(standing) == 2
    assert orders(2.5, t=0.6, looks=[looks[0], fg.ObjectSettings(density=0.4)]) == 1


@pytest.mark.parametrize("values", [[], [3.0], [2.0, 2.0, 2.0], [0.0, 1e-30, 1e30, 1.0]])
def test_sort_of_odd_lists(values):
    depth = np.array(values, np.float32)
    index = np.arange(len(depth), dtype=np.int32)[::-1].copy()
    np.testing.assert_array_equal(sort.order_by(depth, index), index[np.argsort(depth, kind="stable")])


@pytest.mark.parametrize("spread", [1e-6, 1.0, 1e6])
def test_sort_is_stable(spread):
    rng = np.random.default_rng(0)
    depth = (1 + spread * rng.integers(0, 5000, 100_000)).astype(np.float32)
    index = rng.permutation(len(depth)).astype(np.int32)
    np.testing.assert_array_equal(sort.order_by(depth, index), index[np.argsort(depth, kind="stable")])
