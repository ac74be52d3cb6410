# SPDX-License-Identifier: GPL-3.0-or-later
"""bake(): Gaussians on surfaces whose motion is known exactly."""
import numpy as np
import pytest
from moving_meshes import CUBE, CUBE_TRIANGLES, grid, normals, sphere, turn

import fastgs_blender as fg

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
    model, report = baked(lambda t: points + [0.3 * np.sin(2 * np.pi * t), 0.3 * t, 0], triangles, step=0.5, basis=basis, count=200)
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

    with pytest.warns(UserWarning, match="sample more times per frame"):
        model, report = baked(fast, triangles, frames=12, count=50)
    assert not report.reached and report.warning and model.basis.terms <= 0.4 * 12
    assert report.order == getattr(model.basis, "order", None)
    _, finer = baked(fast, triangles, frames=12, step=0.25, count=50)
    assert finer.reached and finer.warning is None


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
    model, _ = baked(lambda t: points + [0.3 * np.sin(11 * t), 0, 0], triangles, basis="cosine", step=0.5, count=50, tolerance=0.01)
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
