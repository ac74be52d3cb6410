# SPDX-License-Identifier: GPL-3.0-or-later
"""bake(): Gaussians on surfaces whose motion is known exactly."""
import numpy as np
import pytest
from moving_meshes import CUBE, CUBE_TRIANGLES, grid, normals, sphere, turn

import fastgs_blender as fg
from fastgs_blender.surfaces import trajectories
from fastgs_blender.surfaces.bake import followed

FRAMES = 24


def cube_at(t):
    return CUBE @ turn(2 * np.pi * t).T + [2 * t, 0, 0]


def wave(points, t):
    return points + np.stack([0 * points[:, 0], 0 * points[:, 0], 0.1 * np.sin(2 * np.pi * (points[:, 0] - t))], 1)


def baked(shape, triangles, frames=FRAMES, step=1.0, **options):
    """A bake of shape(t) on whole frames or every `step` of one."""
    numbers = np.arange(0, frames - 1 + step / 2, step)
    options.setdefault("count", 1500)
    return fg.bake(np.stack([shape(f / frames) for f in numbers]), triangles, frames=numbers, **options)


HALVES = [f / 2 / FRAMES for f in range(0, 2 * FRAMES - 1, 3)]


def test_a_tumbling_cube_is_followed_between_the_frames():
    model, report = baked(cube_at, CUBE_TRIANGLES)
    assert report.reached and report.mean_residual <= 0.005 * report.size
    assert model.basis.terms <= 0.4 * FRAMES
    for t in HALVES:
        s = fg.slice_model(model, t)
        local = (s.position - [2 * t, 0, 0]) @ turn(2 * np.pi * t)
        assert np.abs(np.abs(local).max(1) - 0.5).mean() < 0.01
        face = np.eye(3)[np.abs(local).argmax(1)]
        tilt = np.degrees(np.arccos(np.clip(np.abs(np.einsum("nd,nd->n", normals(s) @ turn(2 * np.pi * t), face)), 0, 1)))
        assert np.median(tilt) < 3


def test_a_waving_sheet():
    points, triangles = grid(40)
    model, report = baked(lambda t: wave(points, t), triangles, step=0.5)
    assert report.basis.terms <= 12
    for t in HALVES:
        s = fg.slice_model(model, t)
        x = s.position[:, 0]
        assert np.abs(s.position[:, 2] - 0.1 * np.sin(2 * np.pi * (x - t))).mean() < 0.005
        slope = 0.2 * np.pi * np.cos(2 * np.pi * (x - t))
        truth = np.stack([-slope, 0 * x, np.ones_like(x)], 1) / np.hypot(slope, 1)[:, None]
        tilt = np.degrees(np.arccos(np.clip(np.einsum("nd,nd->n", normals(s), truth), -1, 1)))
        assert tilt.mean() < 4


def test_a_growing_sphere_needs_one_number_per_axis():
    points, triangles = sphere(24)
    model, report = baked(lambda t: (1 + t) * points, triangles)
    assert model.basis.terms == 1 and report.mean_residual < 1e-5
    assert len(model.rotation_motion[0]) == 0  # nothing turns
    assert ", straight motion," in str(report) and "Hz" not in str(report)
    for t in (0.1, 0.73):
        s = fg.slice_model(model, t)
        radius = np.linalg.norm(s.position, axis=1)
        assert (radius > 0.97 * (1 + t)).all() and (radius < 1.001 * (1 + t)).all()
        assert np.einsum("nd,nd->n", normals(s), s.position / radius[:, None]).min() > 0.95


@pytest.mark.parametrize("basis", ["cosine", "fourier", "keyframes", "auto"])
def test_every_basis_follows(basis):
    points, triangles = grid(6)
    model, report = baked(lambda t: points + [0.3 * np.sin(2 * np.pi * t), 0.3 * t, 0], triangles, step=0.5, basis=basis, count=200,
                          tail_tolerance=0.02)
    assert report.reached
    assert basis in ("auto", model.basis.name)
    for t in (0.0, 0.31, 0.9):
        assert abs(fg.slice_model(model, t).position.mean(0) - fg.slice_model(model, 0).position.mean(0)
                   - [0.3 * np.sin(2 * np.pi * t), 0.3 * t, 0])[:2].max() < 0.03


def test_the_printed_basis_of_the_paper():
    points, triangles = grid(4)
    model, report = baked(lambda t: points + [0, 0, np.sin(4 * np.pi * t)], triangles, basis="paper", count=100)
    assert model.basis == fg.Fourier(2) and report.mean_residual < 1e-5
    assert report.band_limit == pytest.approx(2 / (FRAMES / 24))


def test_half_frames_allow_twice_the_order():
    """Motion too fast for whole frames, and the sentence that says so."""
    points, triangles = grid(2)

    def fast(t):
        return points + [0, np.sin(2 * np.pi * 3.3 * t), 0]

    with pytest.warns(UserWarning, match="more times"):
        model, report = baked(fast, triangles, frames=12, count=50)
    assert not report.reached and report.warning and model.basis.terms <= 0.4 * 12
    assert report.order == getattr(model.basis, "order", None)
    _, finer = baked(fast, triangles, frames=12, step=0.25, count=50)
    assert finer.reached and finer.warning is None
    for step, good in ((1, False), (0.25, True)):
        frames = np.arange(0, 11 + step / 2, step)
        assert followed(np.stack([fast(f / 12) for f in frames]), triangles, frames=frames, frame_count=12) is good


def test_a_hand_that_the_mean_hides(monkeypatch):
    """A hundredth of the surface waves fast: the mean is small, the 99th percentile is not, and the report says where and when."""
    monkeypatch.setattr(trajectories, "CHEAP", 1)  # no terms for the steps from frame to frame, which follow the hand too
    points, triangles = grid(10)
    hand = (points[:, 0] > 0.85) & (points[:, 1] > 0.65)

    def waving(t):
        moved = points.copy()
        moved[hand, 2] += 0.3 * max(0, 1 - 4 * abs(t - 0.5))
        return moved

    options = dict(step=0.5, count=1000, basis="cosine", start_frame=101)
    _, hidden = baked(waving, triangles, **options, tail_tolerance=1.0)
    model, report = baked(waving, triangles, **options)
    assert hidden.mean_residual <= 0.005 and hidden.tail_residual > 0.01
    assert report.reached and report.tail_residual <= 0.01 and report.order > hidden.order
    assert points[triangles[hidden.worst_triangle]][:, :2].min() > 0.7 and abs(hidden.worst_frame - 101 - FRAMES / 2) <= 6
    with pytest.warns(UserWarning, match=r"1 % .*triangle \d+.*frame 1\d\d"):
        baked(waving, triangles, **options, max_order=hidden.order)
    # the figures are those of the model itself
    distance = np.concatenate([np.abs(fg.slice_model(model, f / FRAMES).position[:, 2] - _height(waving(f / FRAMES), triangles, model))
                               for f in np.arange(0, FRAMES - 0.5, 0.5)])
    assert np.percentile(distance, 99) == pytest.approx(report.tail_residual, rel=0.05)
    assert distance.max() == pytest.approx(report.max_residual, rel=0.05)


def _height(points, triangles, model):
    """z of the surface over each Gaussian's x and y, which do not move."""
    xy = model.position[:, :2].astype(float)
    cell = np.minimum((xy * 10).astype(int), 9)
    a, b, c, d = (points[(cell[:, 1] + y) * 11 + cell[:, 0] + x, 2] for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)))
    u, v = (xy * 10 - cell).T
    return np.where(u > v, a + u * (b - a) + v * (d - b), a + u * (d - c) + v * (c - a))


def test_highest_order_is_a_limit():
    points, triangles = grid(2)
    with pytest.warns(UserWarning, match="highest order"):
        _, report = baked(lambda t: points + [np.sin(20 * t), 0, 0], triangles, basis="cosine", max_order=3, count=50)
    assert report.order == 3


def test_nothing_moves():
    points, triangles = grid(3)
    model, report = baked(lambda t: points, triangles, count=300)
    assert model.basis == fg.Static() and model.rotation_basis == fg.Static()
    assert "no motion" in str(report) and report.order == 0
    one, _ = fg.bake(points[None], triangles, count=300)
    assert one.clip.frame_count == 1 and one.basis == fg.Static()


def test_small_motion_is_not_lost_in_the_tolerance():
    points, triangles = grid(3)
    model, _ = baked(lambda t: points + [0, 0, 0.002 * np.sin(2 * np.pi * t)], triangles, count=100)
    z = [fg.slice_model(model, t).position[:, 2].mean() for t in (0.25, 0.75)]
    assert z[0] - z[1] == pytest.approx(0.004, rel=0.2)


def test_each_part_is_held_to_its_own_size():
    """A small thing that moves beside a large one that does not."""
    points, triangles = grid(2)
    big, small = 100 * points, points + [0, 0, 5]
    both = np.concatenate([triangles, triangles + len(points)])

    def shape(t):
        return np.concatenate([big, small + [0.3 * np.sin(6 * np.pi * t), 0.3 * np.cos(2 * np.pi * t), 0]])

    part = np.repeat([0, 1], len(triangles))
    _, alone = baked(shape, both, step=0.5, count=20_000)
    _, apart = baked(shape, both, step=0.5, count=20_000, part=part)
    assert apart.size == pytest.approx(1, rel=0.01) and apart.mean_residual <= 0.005
    assert alone.size == pytest.approx(100, rel=0.01)


def look_down(scale, size=96):
    """An orthographic camera above the unit square."""
    matrix = np.array([[1, 0, 0, -0.5], [0, -1, 0, 0.5], [0, 0, -1, 5], [0, 0, 0, 1]])
    return fg.Camera(size, size, scale, scale, size / 2, size / 2, matrix, orthographic=True)


@pytest.mark.parametrize("stretched", [False, True])
def test_the_surface_is_closed_and_ends_where_it_ends(stretched):
    """No holes, also where it is stretched to twice its length; and no fringe beyond its outline."""
    points, triangles = grid(5)

    def shape(t):
        return (points - 0.5) * ([1 + t, 1 / (1 + t), 1] if stretched else 1) + 0.5

    model, _ = baked(shape, triangles, frames=12, step=0.5, count=4000, colours=(0.2, 0.5, 0.9))
    for t in (0.0, 11 / 12):
        image = fg.render(model, look_down(40.0), t)
        width, height = (1 + t, 1 / (1 + t)) if stretched else (1, 1)
        x, y = np.meshgrid((np.arange(96) + 0.5 - 48) / 40 / width, (np.arange(96) + 0.5 - 48) / 40 / height)
        away = np.maximum(np.abs(x) * width - width / 2, np.abs(y) * height - height / 2) * 40  # pixels beyond the outline
        assert image["alpha"][away < -2.5].min() > 0.9
        assert image["alpha"][away > 2.5].max() < 0.05
        inside = away < -2.5
        assert np.allclose(image["rgb"][inside] / image["alpha"][inside][:, None], (0.2, 0.5, 0.9), atol=1e-3)


def test_outlines_are_not_thick():
    """A sphere covers the pixels of its disc, and not a fifth of a pixel more around; from afar it is opaque too."""
    points, triangles = sphere(64)
    model, _ = fg.bake(points[None], triangles, count=20_000)
    above = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]])
    for scale in (40.0, 10.0):
        camera = fg.Camera(96, 96, scale, scale, 48, 48, above, orthographic=True)
        alpha = fg.render(model, camera)["alpha"]
        x, y = np.meshgrid(*2 * [np.arange(96) + 0.5 - 48])
        assert alpha[np.hypot(x, y) < scale - 2].min() > 0.95
        assert abs(alpha.sum() - np.pi * scale**2) < 0.2 * 2 * np.pi * scale


def two_colours(triangle, weights, corners, wave=0.0):
    """Dark left of a slanted line, or of a wave, on the unit square, light right of it."""
    x, y, _ = np.einsum("nk,nkd->dn", weights, corners[triangle])
    return np.where((x - 0.35 - 0.3 * y - wave * np.sin(12 * y) > 0)[:, None], [0.9, 0.9, 0.1], [0.1, 0.2, 0.5])


@pytest.mark.parametrize("wave", [0.0, 0.03])
def test_edges_of_a_texture_are_crisp(wave):
    points, triangles = grid(2)
    model, _ = fg.bake(points[None], triangles, lambda t, w: two_colours(t, w, points[triangles], wave), count=4000)
    assert len(np.unique(model.features.round(5), axis=0)) == 2  # no Gaussian has a colour between the two
    image = fg.render(model, look_down(80.0), 0)
    x, y = np.meshgrid((np.arange(96) + 0.5 - 48) / 80 + 0.5, (np.arange(96) + 0.5 - 48) / 80 + 0.5)
    inside = (np.abs(x - 0.5) < 0.45) & (np.abs(y - 0.5) < 0.45)
    assert image["alpha"][inside].min() > 0.88  # no gap along the edge
    beyond = (x - 0.35 - 0.3 * (1 - y) - wave * np.sin(12 * (1 - y))) * 80
    for side, colour in ((1, (0.9, 0.9, 0.1)), (-1, (0.1, 0.2, 0.5))):
        seen = (image["rgb"] / np.maximum(image["alpha"], 1e-6)[..., None])[inside & (side * beyond > 1.5)]
        off = np.abs(seen - colour).max(-1)
        assert off.mean() < 0.005 and np.quantile(off, 0.98) < 0.15


def test_edges_between_faces_of_two_colours_are_crisp():
    points, triangles = grid(4)
    left = points[triangles].mean(1)[:, 0] < 0.5
    model, _ = fg.bake(points[None], triangles, np.where(left[:, None], [0.9, 0.1, 0.1], [0.1, 0.1, 0.9]), count=2000)
    s = fg.slice_model(model, 0)
    near = np.abs(s.position[:, 0] - 0.5) < 0.02
    covariance = np.einsum("nij,nj->nij", fg.util.rotations.to_matrices(s.rotation), s.scale)[:, 0]
    reach = np.sqrt((covariance**2).sum(1))
    assert near.sum() > 60 and (reach[near] < 1.3 * np.abs(s.position[near, 0] - 0.5) + 0.3 * 0.85 * np.sqrt(1 / 2000) + 1e-6).all()


def test_outlines_are_no_thicker_than_the_surface():
    """A ball of 30 pixels covers as many pixels as it should, to 3.5 %: with the usual blur it would be 21 % too many."""
    points, triangles = sphere(48)
    model, _ = fg.bake(points[None], triangles, count=20_000)
    camera = fg.Camera(48, 48, 120, 120, 24, 24, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 8], [0, 0, 0, 1]]))
    area = np.pi * 120**2 / (64 - 1)
    assert fg.render(model, camera, 0)["alpha"].sum() == pytest.approx(area, rel=0.035)


def test_folds_are_closed():
    """Strips that are folded up and down by 30 degrees, from above: hardly anything is seen through their edges."""
    half, strips = np.radians(15.0), np.arange(9)
    row = 0.2 * np.c_[strips * np.cos(half), 0 * strips, strips % 2 * np.sin(half)]
    points = np.concatenate([row, row + [0, 1.5, 0]]).astype(np.float32)
    triangles = np.array([each for k in range(8) for each in ((k, k + 1, 9 + k), (k + 1, 10 + k, 9 + k))])
    model, _ = fg.bake(points[None], triangles, count=6000)
    middle = points.mean(0)
    camera = fg.Camera(300, 300, 400, 400, 150, 150, fg.look_at(middle + [0, -0.3, -2.5], middle))
    alpha = fg.render(model, camera)["alpha"][70:230, 90:210]
    assert np.mean(alpha < 0.95) < 0.015


def test_a_speckled_texture_leaves_no_holes():
    points, triangles = grid(1)

    def speckled(triangle, weights):
        at = np.einsum("nk,nkd->nd", weights, points[triangles][triangle])
        return np.sin(1e4 * at[:, :1]) * np.cos(1.3e4 * at[:, 1:2]) * [0.5, 0.5, 0.5] + 0.5

    model, _ = fg.bake(points[None], triangles, speckled, count=4000)
    alpha = fg.render(model, look_down(40.0), 0)["alpha"]
    assert alpha[32:64, 32:64].min() > 0.85


def test_gaussians_keep_within_sharp_edges():
    model, _ = fg.bake(CUBE[None], CUBE_TRIANGLES, count=3000)
    s = fg.slice_model(model, 0)
    w, x, y, z = s.rotation.T
    axes = np.stack([np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1),
                     np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], 1)], 1)
    reach = np.abs(s.position) + np.sqrt(np.einsum("na,nad->nd", s.scale[:, :2] ** 2, axes**2))
    spacing = np.sqrt(6 / 3000)
    assert np.quantile(reach, 0.99) < 0.5 + 0.2 * spacing
    assert reach.max() < 0.5 + 0.45 * spacing


def test_colours_of_corners_triangles_and_functions():
    points, triangles = grid(8)
    corners = np.concatenate([points[triangles][..., :2], np.full(triangles.shape + (1,), 0.25)], -1)
    model, _ = fg.bake(points[None], triangles, corners, count=500)
    assert np.allclose(model.features[:, :2], model.position[:, :2], atol=1e-6)
    assert (model.features[:, 2] == 0.25).all()
    flat = np.linspace(0, 1, len(triangles))[:, None] * [1, 1, 1]
    model, _ = fg.bake(points[None], triangles, flat, count=500)
    assert set(np.unique(model.features)) <= set(flat[:, 0].astype(np.float32))
    model, _ = fg.bake(points[None], triangles, lambda triangle, weights: np.einsum("nkc,nk->nc", corners[triangle], weights), count=500)
    assert np.allclose(model.features[:, 0], model.position[:, 0], atol=0.02)  # the mean around each, which at the rim leans inwards


def test_what_is_transparent_gets_no_gaussians():
    points, triangles = grid(8)
    rgba = np.ones((len(triangles), 4))
    left = points[triangles].mean(1)[:, 0] < 0.5
    rgba[left, 3] = 0.0
    rgba[~left, 3] = 0.5
    model, report = fg.bake(points[None], triangles, rgba, count=1000)
    assert report.gaussians == len(model) == pytest.approx(500, abs=30)
    assert np.allclose(1 / (1 + np.exp(-model.opacity)), 0.495, atol=1e-3)
    with pytest.raises(fg.FastGSError, match="transparent"):
        fg.bake(points[None], triangles, (1, 1, 1, 0), count=100)


def test_what_the_model_records(tmp_path):
    points, triangles = grid(2)
    model, report = baked(lambda t: points + [t, 0, 0], triangles, fps=30, start_frame=101, count=64, provenance={"objects": "A"})
    assert (model.axes, model.colour_space) == ("RFU", "srgb")
    assert (model.clip.frame_count, model.clip.fps, model.clip.start_frame) == (FRAMES, 30, 101)
    assert model.provenance["objects"] == "A"
    fg.save(model, tmp_path / "x.safetensors")
    assert fg.load(tmp_path / "x.safetensors").basis == model.basis
    assert "\n" not in str(report) and "64 Gaussians" in str(report)


def test_twice_the_same():
    first, second = (baked(cube_at, CUBE_TRIANGLES, count=400)[0] for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first.arrays.values(), second.arrays.values(), strict=True))


def test_the_half_frame_after_the_last_is_tame():
    points, triangles = grid(2)
    model, _ = baked(lambda t: points + [0.3 * np.sin(11 * t), 0, 0], triangles, basis="cosine", step=0.5, count=50, tolerance=0.01,
                     tail_tolerance=0.03)
    after, last = (fg.slice_model(model, f / FRAMES).position for f in (FRAMES - 0.5, FRAMES - 1))
    assert np.abs(after - last).max() < 0.3


def test_progress_cancels():
    class Stop(Exception):
        pass

    def progress(fraction):
        assert 0 <= fraction <= 1
        if fraction > 0.3:
            raise Stop

    with pytest.raises(Stop):
        baked(cube_at, CUBE_TRIANGLES, progress=progress)


POINTS, TRIANGLES = grid(2)
MOVING = np.stack([POINTS, POINTS + 0.1])


@pytest.mark.parametrize(("arguments", "options", "sentence"), [
    ((POINTS, TRIANGLES), {}, "shape"),
    ((MOVING, TRIANGLES.astype(float)), {}, "whole numbers"),
    ((MOVING, TRIANGLES[:0]), {}, "no faces"),
    ((MOVING, TRIANGLES + 5), {}, "outside"),
    ((MOVING * np.nan, TRIANGLES), {}, "finite"),
    ((MOVING * 0, TRIANGLES), {}, "no area"),
    ((MOVING, TRIANGLES), {"frames": [1, 1]}, "increasing"),
    ((MOVING, TRIANGLES), {"count": 0}, "number of Gaussians"),
    ((MOVING, TRIANGLES), {"tolerance": 0}, "tolerance"),
    ((MOVING, TRIANGLES), {"basis": "wavelets"}, "wavelets"),
    ((MOVING, TRIANGLES), {"part": [1]}, "part"),
    ((MOVING, TRIANGLES, np.zeros((5, 3))), {}, "colours"),
])
def test_bad_input_is_named(arguments, options, sentence):
    with pytest.raises(fg.FastGSError, match=sentence):
        fg.bake(*arguments, **{"count": 100, **options})
