# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussians that a viewport draws, and their order: with numba, without it, and against rendered pictures."""
from __future__ import annotations

import numpy as np
import pytest
from random_cameras import hostile_scales, random_camera
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import sort
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


def test_ranks_leave_out_the_least_important():
    model = random_model(np.random.default_rng(2), 400, size=0.05)
    model.opacity[:] = 2
    pose = np.eye(4)
    pose[2, 3] = 5
    camera = fg.Camera(64, 64, 40, 40, 32, 32, pose)
    part = Instance(model, np.eye(4), 0.0).viewed(camera)
    whole, half = visibility.order([part], camera), visibility.order([part], camera, 0.5, importance.importance_rank)
    assert len(half) == 200 and len(whole) == 400
    area = np.sort(model.scale, 1)[:, 1:].sum(1)
    assert area[half].min() >= np.delete(area, half).max()
    np.testing.assert_array_equal(half, whole[np.isin(whole, half)])


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
