# SPDX-License-Identifier: GPL-3.0-or-later
"""Lenses: COLMAP agrees about the models, and undistorted pictures show known points where a pinhole projects them."""
from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from spots import draw_spots, find_spots, project

from fastgs_blender.cameras.lens import Intrinsics, Lens, inside, pinhole_for, undistortion_map
from fastgs_blender.captures.pixels.undistortion import resample
from fastgs_blender.util.errors import FastGSError
from fastgs_blender.util.threads import set_threads

BARREL = Lens("opencv", (-0.25, 0.07, -0.01), (0.003, -0.002))
PINCUSHION = Lens("opencv", (0.12, 0.03), (-0.001, 0.002))
RATIONAL = Lens("opencv", (0.4, 0.05, 0.01, 0.7, 0.12, 0.01), (0.0005, 0.0004))
QUALISYS = Lens("opencv", (-0.046183, 0.139983), (0.000608, 0.00069))
FISHEYE = Lens("fisheye", (0.02, -0.01, 0.003, -0.001))
SKEWED = Lens("opencv", (-0.1,), skew=0.02)
LENSES = {"barrel": BARREL, "pincushion": PINCUSHION, "rational": RATIONAL, "qualisys": QUALISYS, "fisheye": FISHEYE, "skewed": SKEWED}
SOURCE = Intrinsics(330, 328, 321.5, 236.25, 640, 480)


@pytest.fixture(params=LENSES)
def lens(request):
    return LENSES[request.param]


@pytest.mark.parametrize(("name", "model", "parameters"), [
    ("rational", "FULL_OPENCV", lambda lens: [*lens.k[:2], *lens.p, *lens.k[2:]]),
    ("barrel", "FULL_OPENCV", lambda lens: [*lens.k[:2], *lens.p, *lens.k[2:]]),
    ("qualisys", "OPENCV", lambda lens: [*lens.k[:2], *lens.p]),
    ("fisheye", "OPENCV_FISHEYE", lambda lens: lens.k[:4]),
])
def test_colmap_puts_points_at_the_same_pixels(rng, name, model, parameters):
    lens = LENSES[name]
    points = rng.uniform([-0.8, -0.6, 1], [0.8, 0.6, 1], (50, 3))
    theirs = pycolmap.Camera(model=model, width=SOURCE.width, height=SOURCE.height, params=[*SOURCE[:4], *parameters(lens)])
    ours = lens.distort(points[:, :2]) * SOURCE[:2] + SOURCE[2:4]
    np.testing.assert_allclose(ours, [np.ravel(theirs.img_from_cam(point)) for point in points], atol=1e-6)


def test_undistort_is_the_inverse_of_distort(lens, rng):
    xy = rng.uniform([-0.9, -0.7], [0.9, 0.7], (200, 2))
    np.testing.assert_allclose(lens.undistort(lens.distort(xy)), xy, atol=1e-8)
    np.testing.assert_array_equal(lens.distort([0, 0]), [0, 0])
    np.testing.assert_array_equal(lens.undistort([0, 0]), [0, 0])


def test_where_the_model_folds_over_there_is_no_image():
    lens = Lens("opencv", (-0.3,))  # r (1 - 0.3 r^2) grows up to r = 1.054, to 0.703
    assert np.isfinite(lens.distort([1.0, 0])).all() and np.isnan(lens.distort([1.1, 0])).all()
    assert np.isfinite(lens.undistort([0.69, 0])).all() and np.isnan(lens.undistort([0.72, 0])).all()


def test_undistorted_picture_shows_points_where_the_pinhole_projects_them(lens):
    pose = np.eye(4)
    pose[:3, 3] = 0.1, -0.2, 0.5
    near = image_plane_grid()
    camera = pinhole_for(lens, SOURCE, pose)
    image = draw_spots(SOURCE.width, SOURCE.height, lens.distort(near) * SOURCE[:2] + SOURCE[2:4])
    world = np.c_[near, np.ones(len(near))] * 3 - pose[:3, 3]
    for scale in (1, 0.5):
        camera = pinhole_for(lens, SOURCE, pose, scale)
        expected = project(camera, world)
        assert (expected > 10).all() and (expected < [camera.width - 10, camera.height - 10]).all() and len(expected) >= 9
        shown = resample(image[..., None], undistortion_map(lens, SOURCE, camera))[..., 0]
        assert np.abs(find_spots(shown, expected) - expected).max() <= 0.1


def image_plane_grid():
    """Points of the image plane that every lens' cropped picture shows."""
    x, y = np.meshgrid([-0.55, 0, 0.5], [-0.35, 0.05, 0.4])
    return np.stack([x.ravel(), y.ravel()], -1)


def test_no_empty_border_and_no_more_crop_than_needed(lens):
    camera = pinhole_for(lens, SOURCE, np.eye(4))
    assert (camera.width, camera.height) == (SOURCE.width, SOURCE.height)
    assert camera.fx / camera.fy == pytest.approx(SOURCE.fx / SOURCE.fy)
    positions = undistortion_map(lens, SOURCE, camera)
    assert inside(positions, SOURCE.width, SOURCE.height).all()
    x, y = positions[..., 0], positions[..., 1]
    gaps = [x.min(), SOURCE.width - x.max(), y.min(), SOURCE.height - y.max()]
    assert max(gaps[:2]) < 2 or max(gaps[2:]) < 2  # across or down, both edges are reached


def test_wide_lens_keeps_half_the_focal_length():
    wide = Intrinsics(150, 150, 320, 240, 640, 480)  # it sees 122 degrees to each side
    camera = pinhole_for(Lens("fisheye"), wide, np.eye(4))
    assert (camera.fx, camera.cx, camera.cy) == (75, 320, 240)
    assert inside(undistortion_map(Lens("fisheye"), wide, camera), 640, 480).all()


def test_stated_focal_length_is_kept_and_what_the_lens_does_not_see_is_masked():
    camera = pinhole_for(FISHEYE, SOURCE, np.eye(4), focal=0.36)
    assert (camera.fx, camera.fy, camera.cx) == (SOURCE.fx * 0.36, SOURCE.fy * 0.36, SOURCE.cx)
    mask = inside(undistortion_map(FISHEYE, SOURCE, camera), 640, 480)
    assert mask[240, 320] and not mask[240, 0] and 0.3 < mask.mean() < 0.9


def test_pinhole_is_only_scaled():
    camera = pinhole_for(Lens(), Intrinsics(100, 101, 32.5, 20, 66, 41), np.eye(4), 0.5)
    assert (camera.width, camera.height) == (33, 20)
    np.testing.assert_allclose([camera.fx, camera.fy, camera.cx, camera.cy], [50, 101 * 20 / 41, 16.25, 20 * 20 / 41])


def positions(width, height, scale=1.0, shift=0.0):
    x, y = np.meshgrid((np.arange(width) + 0.5) * scale + shift, (np.arange(height) + 0.5) * scale)
    return np.stack([x, y], -1).astype(np.float32)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_resample_copies_and_averages_exactly(rng, dtype):
    image = rng.integers(0, 256, (24, 36, 3)).astype(dtype)
    np.testing.assert_array_equal(resample(image, positions(36, 24)), image)
    for factor in (2, 3):
        mean = image.reshape(24 // factor, factor, 36 // factor, factor, 3).mean((1, 3))
        np.testing.assert_allclose(resample(image, positions(36 // factor, 24 // factor, factor)), mean, rtol=1e-5)


def test_resample_keeps_ramps_and_range(rng):
    ramp = np.broadcast_to(np.arange(40, dtype=np.float32)[None, :, None], (20, 40, 1))
    shown = resample(ramp, positions(30, 20, shift=4.3))
    np.testing.assert_allclose(shown[..., 0], np.broadcast_to(np.arange(30) + 4.3, (20, 30)), atol=1e-4)
    noise = resample(rng.uniform(0, 1, (20, 40, 2)).astype(np.float32), positions(30, 20, 0.7, 0.2))
    assert noise.min() >= 0 and noise.max() <= 1


def test_outside_and_nowhere_are_zero_and_masked():
    at = positions(8, 8, shift=-2)
    at[3, 5] = np.nan
    shown, mask = resample(np.ones((8, 8, 1), np.float32), at)[..., 0], inside(at, 8, 8)
    expected = np.ones((8, 8))
    expected[:, :2], expected[3, 5] = 0, 0
    np.testing.assert_array_equal(shown, expected)
    np.testing.assert_array_equal(mask, expected.astype(bool))


def test_same_bytes_for_any_number_of_threads(rng):
    image = rng.uniform(0, 1, (200, 300, 3)).astype(np.float32)
    at = undistortion_map(BARREL, SOURCE, pinhole_for(BARREL, SOURCE, np.eye(4), 0.4))
    try:
        results = [(set_threads(n), resample(image, at).tobytes())[1] for n in (1, 3)]
    finally:
        set_threads(0)
    assert results[0] == results[1]


def test_wrong_lenses_are_said_plainly():
    with pytest.raises(FastGSError, match="'anamorphic'"):
        Lens("anamorphic")
    with pytest.raises(FastGSError, match="no p1"):
        Lens.named("fisheye", {"k1": 0.1, "p1": 0.2})
    with pytest.raises(FastGSError, match="numbers"):
        Lens.named("opencv", {"k1": "much"})
    with pytest.raises(FastGSError, match="finite"):
        Lens.named("opencv", {"k1": float("nan")})
    assert Lens.named("opencv", {"k2": 0.5, "p1": 1}) == Lens("opencv", (0, 0.5), (1, 0))


@pytest.mark.filterwarnings("error")
def test_a_focal_length_next_to_nothing_is_no_warning():
    """A damaged file may say 1e-308 pixels: rays are then as far out as numbers go, and nothing is in the picture."""
    for lens in (Lens(), Lens("opencv", (0.1,))):
        source = Intrinsics(1e-308, 1e-308, 16.0, 12.0, 32, 24)
        camera = pinhole_for(lens, source, np.eye(4))
        assert undistortion_map(lens, source, camera).shape == (24, 32, 2)
