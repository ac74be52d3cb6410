# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes that crop what is shown: in every backend, in a viewport's order, and for good."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.model.surroundings import Surroundings
from fastgs_blender.rendering import visibility
from fastgs_blender.rendering.crops import Crop, crop_share, cropped, kept_by
from fastgs_blender.rendering.filters import Filter, parting, values
from fastgs_blender.rendering.importance import importance_rank
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.volumes import mesh_volume

CAMERA = fg.Camera(48, 40, 40, 40, 24, 20, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]))


def box(rng, remove=False):
    """A crop with a random box of medium size."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] / rng.uniform(0.6, 1.5, 3)[:, None]
    matrix[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    return Crop(matrix, remove)


def inside(crop, point) -> bool:
    x, y, z, _ = crop.matrix @ [*point, 1.0]
    return -1 <= x <= 1 and -1 <= y <= 1 and -1 <= z <= 1


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), max_size=4))
def test_boxes_to_keep_add_up_and_boxes_to_remove_win(seed, removes):
    rng = np.random.default_rng(seed)
    crops, points = [box(rng, remove) for remove in removes], rng.uniform(-1.5, 1.5, (50, 3))
    keeps = [crop for crop in crops if not crop.remove]
    for point, left in zip(points, kept_by(crops, points)):
        kept = not keeps or any(inside(crop, point) for crop in keeps)
        assert left == (kept and not any(inside(crop, point) for crop in crops if crop.remove))


def test_a_box_without_an_inside():
    nothing, points = np.full((4, 4), np.nan), np.zeros((2, 3))
    assert not kept_by([Crop(nothing)], points).any()
    assert kept_by([Crop(nothing, remove=True)], points).all()


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize("removes", [(False,), (True,), (False, False, True)])
@pytest.mark.parametrize(("basis", "temporal"), [("paper", "radial"), ("cubic", "always")])
def test_a_cropped_picture_is_that_of_what_is_left(backend, removes, basis, temporal):
    rng = np.random.default_rng(len(removes))
    model, crops = random_model(rng, 200, basis, "line", temporal, motion=0.1), [box(rng, remove) for remove in removes]
    for t in (0.2, 0.9):
        left = kept_by(crops, fg.slice_model(model, t, cull=False).position)
        assert 10 < left.sum() < 190
        wanted = fg.render(model.take(left), CAMERA, t, passes=("rgb", "alpha", "depth"), backend=backend)
        got = fg.render([(model, np.eye(4), t, crops)], CAMERA, passes=("rgb", "alpha", "depth"), backend=backend)
        for name, image in got.items():
            np.testing.assert_array_equal(image, wanted[name])


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_viewport_sorts_what_is_left(backend):
    rng = np.random.default_rng(5)
    model, crops = random_model(rng, 300, "fourier", size=0.02), (box(rng), box(rng, True))
    everything = visibility.order([Instance(model, np.eye(4), 0.4).viewed(CAMERA)], CAMERA, backend=backend)
    left = kept_by(crops, fg.slice_model(model, 0.4, cull=False).position)
    wanted = everything[left[everything]]
    assert 10 < len(wanted) < len(everything)
    cut = Instance(model, np.eye(4), 0.4, ObjectSettings(crops)).viewed(CAMERA)
    np.testing.assert_array_equal(visibility.order([cut], CAMERA, backend=backend), wanted)


def test_cropped_for_good_are_those_that_are_left_on_some_frame():
    """A row of Gaussians that move to the right, one of them seen in the first half alone; the box is at the right end."""
    x = np.array([0.0, 1.0, 2.0, 3.0, 1.0])
    model = fg.GaussianModel(
        position=np.stack([x, 0 * x, 0 * x], 1), rotation=np.tile([1.0, 0, 0, 0], (5, 1)), scale=np.full((5, 3), -3.0),
        opacity=np.full(5, 3.0), features=np.full((5, 3), 0.5), motion=np.tile([1.0, 0, 0], (5, 1, 1)), basis=fg.Polynomial(1),
        temporal_kind=fg.Window(), temporal=np.array([[-1, 2, -3, -3]] * 4 + [[-1, 0.4, -6, -6]]), clip=fg.Clip(10, 24.0))
    matrix = np.eye(4)
    matrix[0, 3] = -2.6  # from 1.6 to 3.6
    left = cropped(model, [Crop(matrix)])
    np.testing.assert_array_equal(left.position[:, 0], [1, 2, 3])
    assert left.clip == model.clip
    np.testing.assert_array_equal(cropped(model, [Crop(matrix, True)]).position[:, 0], [0, 1, 3, 1])


def ellipsoid(rng, remove=False, soft=0.0):
    return Crop(box(rng).matrix, remove, "SPHERE", soft)


def torus(n=48, m=24, large=0.7, small=0.3):
    """A closed mesh around z that a ray may cross four times: points, triangles."""
    a, b = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    r = large + small * np.cos(b)
    points = np.stack([r * np.cos(a), r * np.sin(a), small * np.sin(b)], -1).reshape(-1, 3)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    corner = [((i + x) % n) * m + (j + y) % m for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return points, np.concatenate([np.stack([corner[0], corner[1], corner[2]], 1), np.stack([corner[0], corner[2], corner[3]], 1)])


@pytest.mark.slow
def test_the_volume_of_a_mesh_knows_inside_and_depth():
    points, triangles = torus()
    high = np.abs(points).max(0)
    volume = mesh_volume(points, triangles, -high, high)
    at = np.random.default_rng(0).uniform(-high, high, (4000, 3))
    truth = (0.3 - np.hypot(np.hypot(at[:, 0], at[:, 1]) - 0.7, at[:, 2])) / high.min()
    got = volume.depth_at(at / high)
    clear = np.abs(truth) > 0.05
    assert (np.sign(got) == np.sign(truth))[clear].all() and (truth > 0.05).sum() > 500 and (truth < -0.05).sum() > 500
    assert np.abs(got - truth)[truth > 0].max() < 0.06
    assert (volume.depth_at(np.array([[1.5, 0, 0], [np.nan, 0, 0]])) == -1).all()
    assert mesh_volume(points, triangles, -high, high).digest == volume.digest
    # a mesh of round numbers, whose edges lie on the grid's lines
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sides = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
                      [1, 5, 7], [1, 7, 3]])
    cube = mesh_volume(corners, sides, corners.min(0), corners.max(0))
    inner = np.random.default_rng(1).uniform(-0.97, 0.97, (500, 3))
    assert np.abs(cube.depth_at(inner) - (1 - np.abs(inner).max(1))).max() < 0.05


def test_soft_edges_and_shapes_by_hand():
    x = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.75, 0, 0], [1.0, 0, 0], [1.01, 0, 0], [0.8, 0.8, 0]])
    assert np.allclose(Crop(np.eye(4), soft=0.5).share(x), [1, 1, 0.5, 0, 0, 0.352])
    assert np.allclose(Crop(np.eye(4), shape="SPHERE").share(x), [1, 1, 1, 1, 0, 0])
    assert np.allclose(Crop(np.eye(4), shape="SPHERE", soft=1.0).share(x), [1, 0.5, 0.15625, 0, 0, 0])
    both = [Crop(np.eye(4), soft=0.5), Crop(np.eye(4), True, "SPHERE", 0.5)]
    assert np.allclose(crop_share(both, x), [0, 0, 0.25, 0, 0, 0.352])
    nothing = np.full((4, 4), np.nan)
    assert not Crop(nothing, soft=0.5).share(x).any() and not Crop(nothing, shape="SPHERE", soft=0.5).share(x).any()


def test_every_backend_shows_shapes_alike():
    rng = np.random.default_rng(8)
    points, triangles = torus(24, 12)
    high = np.abs(points).max(0)
    ring = Crop(np.diag([*1 / high, 1]), shape=mesh_volume(points, triangles, -high, high), soft=0.3)
    model = random_model(rng, 300, "paper", "line", "radial", motion=0.1)
    plain = fg.render([(model, np.eye(4), 0.4)], CAMERA)["alpha"]
    for crops in ([ring], [ring, ellipsoid(rng, True, 0.4)], [ellipsoid(rng, soft=0.7), box(rng, True)]):
        pictures = [fg.render([(model, np.eye(4), 0.4, crops)], CAMERA, backend=backend) for backend in ("cpu", "reference")]
        assert np.abs(pictures[0]["rgb"] - pictures[1]["rgb"]).max() < 2e-5
        assert np.abs(pictures[0]["alpha"] - plain).max() > 0.05 and pictures[0]["alpha"].max() > 0.1
        cut = Instance(model, np.eye(4), 0.4, ObjectSettings(crops)).viewed(CAMERA)
        order = visibility.order([cut], CAMERA)
        np.testing.assert_array_equal(order, visibility.order([cut], CAMERA, backend="reference"))
        # a viewport multiplies by these shares what it draws
        share = visibility.crop_shares([cut], order)
        assert np.allclose(share, crop_share(crops, fg.slice_model(model, 0.4, cull=False).position[order]), atol=1e-6)
    assert visibility.crop_shares([Instance(model, np.eye(4), 0.4).viewed(CAMERA)], order) is None


@pytest.mark.parametrize(("kind", "low", "high"), [("SIZE", 0.1, 9), ("OPACITY", 0, 0.5), ("LIFETIME", 0.4, 9), ("SPEED", 0, 0.7),
                                                   ("COLOUR", 0, 0.4), ("NEIGHBOURS", 1, 900)])
@pytest.mark.parametrize("keep", [False, True])
def test_a_filtered_picture_is_that_of_what_is_left(kind, low, high, keep):
    model = random_model(np.random.default_rng(3), 200, "paper", "line", "radial", motion=0.05, clip=fg.Clip(24, 24.0))
    model = replace(model, position=np.r_[model.position[:140], np.repeat(model.position[:60], 1, 0)])  # neighbours for some
    each = Filter(kind, low, high, keep, (0.5, 0.5, 0.5))
    value = values(model, kind, each.colour)
    left = ((value >= low) & (value <= high)) == keep
    assert 10 < left.sum() < 190
    look = ObjectSettings(filters=[each])
    wanted = fg.render(model.take(left), CAMERA, 0.4)
    for backend in ("cpu", "reference"):
        got = fg.render([(model, np.eye(4), 0.4, look)], CAMERA, backend=backend)
        assert np.abs(got["rgb"] - wanted["rgb"]).max() < 2e-5
    cut = Instance(model, np.eye(4), 0.4, look).viewed(CAMERA)
    orders = [visibility.order([cut], CAMERA, backend=backend) for backend in ("cpu", "reference")]
    np.testing.assert_array_equal(*orders)
    assert left[orders[0]].all() and len(orders[0])


def test_what_filters_look_at():
    """Three Gaussians: large and still; small, moving by 2 in a second; small, seen half of the time, far from the others."""
    model = fg.GaussianModel(
        position=np.array([[0, 0, 0], [0.001, 0, 0], [5, 5, 5.0]]), rotation=np.tile([1.0, 0, 0, 0], (3, 1)),
        scale=np.log([[0.5, 0.1, 0.1], [0.01] * 3, [0.01] * 3]), opacity=np.zeros(3), features=np.eye(3),
        motion=np.array([[[0, 0, 0]], [[4.0, 0, 0]], [[0, 0, 0]]]), basis=fg.Polynomial(1), mu_tau=np.array([0, 0.5, 0]),
        temporal_kind=fg.Window(), temporal=np.array([[-1, 2, -4, -4], [-1, 2, -4, -4], [-1, 0.5, -8, -8]]), clip=fg.Clip(48, 24.0))
    assert np.allclose(values(model, "SIZE"), [0.5, 0.01, 0.01]) and np.allclose(values(model, "OPACITY"), 0.5)
    assert np.allclose(values(model, "SPEED"), [0, 2, 0]) and np.allclose(values(model, "LIFETIME"), [2, 2, 1], atol=0.1)
    assert np.allclose(values(model, "COLOUR", (1, 0, 0)), [0, 1, 1]) and np.allclose(values(model, "NEIGHBOURS"), [1, 1, 0])
    assert 0.01 < parting(np.array([0.0, 0.001, 0.01, 3, 4, 5])) < 3 and parting(np.zeros(3)) == 1
    assert 0 < parting(np.full(5, 2.0)) < 2  # where everything moves alike, everything is the moving part
    assert np.allclose(values(model, "CAMERAS"), 0)
    with pytest.raises(fg.FastGSError, match="'WEIGHT'"):
        Filter("WEIGHT")


def test_how_many_cameras_see_a_gaussian():
    """Two cameras side by side: one Gaussian before both, one before the right one, one behind, one that comes into view when it shows."""
    views = [viewpoint_of(fg.Camera(64, 48, 60, 60, 32, 24, np.array([[1, 0, 0, -x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])))
             for x in (0.0, 1.0)]
    model = fg.GaussianModel(
        position=np.array([[0.5, 0, 4], [2.5, 0, 4], [0.5, 0, -4], [-99, 0, 4.0]]), rotation=np.tile([1.0, 0, 0, 0], (4, 1)),
        scale=np.full((4, 3), -3.0), opacity=np.zeros(4), features=np.zeros((4, 3)), basis=fg.Polynomial(1),
        motion=np.array([[[0, 0, 0]], [[0, 0, 0]], [[0, 0, 0]], [[90.0, 0, 0]]]), temporal_kind=fg.Window(),
        temporal=np.array([[-1, 2, -4, -4]] * 3 + [[0.97, 2, -4, -4]]), surroundings=Surroundings(cameras=views))
    assert values(model, "CAMERAS").tolist() == [2, 1, 0, 0]
    late = replace(model, motion=model.motion * 99.5 / 90 / 0.970588)
    assert values(late, "CAMERAS")[3] == 2


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_density_leaves_the_most_important_gaussians(backend):
    model = random_model(np.random.default_rng(3), 200, "paper", "line", "radial", motion=0.05)
    left = importance_rank(model) < 0.25
    assert left.sum() == 50
    wanted = fg.render(model.take(left), CAMERA, 0.4, backend=backend)
    got = fg.render([(model, np.eye(4), 0.4, ObjectSettings(density=0.25))], CAMERA, backend=backend)
    assert np.abs(got["rgb"] - wanted["rgb"]).max() < 1e-6 and wanted["alpha"].max() > 0.1
    with pytest.raises(fg.FastGSError, match="density"):
        ObjectSettings(density=1.5)


def test_looks_of_what_instances_an_object_come_on_top():
    below, above = ObjectSettings(exposure=1, tint=(1, 0.5, 1), opacity=0.5, max_size=2, density=0.5, mask="m"), ObjectSettings(
        exposure=-0.5, tint=(0.5, 0.5, 1), opacity=0.5, splat_scale=2, max_size=1, density=0.5)
    assert below.under(above) == ObjectSettings(exposure=0.5, tint=(0.5, 0.25, 1), opacity=0.25, splat_scale=2, max_size=1, density=0.25,
                                                mask="m")
    assert below.under(ObjectSettings()) == below
