# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups of pixels that a splat reaches: all in which it has any alpha, and hardly more."""
import numba
import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.cameras.camera import Camera
from fastgs_blender.kernels.cpu import groups, raster, simd


@numba.njit
def reached8(u, v, slopes, opacity, cut):
    return groups.reached(np.empty(groups.LINES, np.float32), u, v, slopes, opacity, cut, 8)


@numba.njit
def reached16(u, v, slopes, opacity, cut):
    return groups.reached(np.empty(groups.LINES, np.float32), u, v, slopes, opacity, cut, 16)


BOTH = pytest.mark.parametrize(("lanes", "reached"), [(8, reached8), (16, reached16)])


@BOTH
@pytest.mark.parametrize("size", [0.6, 3.0, 40.0])
def test_every_pixel_above_the_cut_lies_in_a_reached_group(size, lanes, reached):
    rng, y, x = np.random.default_rng(3), *np.mgrid[:16, :16]
    visited = exact = 0
    for _ in range(200):
        slopes = np.float32([rng.uniform(0.2, 1.5), rng.normal(), rng.uniform(0.2, 1.5)]) / np.float32(size)
        mx, my = rng.uniform(-size, 16 + size, 2)
        opacity, cut = np.float32(rng.uniform(-7, 0)), np.float32(np.log2(1 / 255))
        u, v = np.float32(-slopes[0] * mx - slopes[1] * my), np.float32(-slopes[2] * my)
        bits = reached(u, v, tuple(slopes), opacity, cut)
        log2 = opacity - (slopes[0] * (x - mx) + slopes[1] * (y - my)) ** 2 - (slopes[2] * (y - my)) ** 2
        touched = (log2.reshape(16, -1, lanes) >= cut + 1e-4).any(2).ravel()
        found = bits >> np.arange(256 // lanes) & 1 == 1
        assert found[touched].all()
        visited, exact = visited + found.sum(), exact + touched.sum()
    assert 0 < exact <= visited < 1.6 * exact  # between two pixels there may be a peak that none of them has


@BOTH
def test_nothing_is_reached_far_away_and_all_where_a_splat_is_large(lanes, reached):
    one, cut = np.float32(1), np.float32(-8)
    assert reached(np.float32(1e6), one, (one, one, one), np.float32(0), cut) == 0
    flat, far = (one / 100, one / 100, one / 100), np.float32(-8)
    assert reached(far, far, flat, np.float32(0), np.float32(-200)) == groups.every(lanes)


@pytest.mark.slow
def test_groups_of_both_sizes_draw_the_same_bytes(monkeypatch, make_model):
    model, camera = make_model(np.random.default_rng(4), 300), Camera(72, 50, 60, 60, 36, 25, np.eye(4))
    monkeypatch.setattr(raster, "rasteriser", raster.rasteriser.__wrapped__)  # what it remembers is of one size
    images = []
    for lanes in (8, 16):
        monkeypatch.setattr(simd, "WIDE", lanes)
        images.append(fg.render(model, camera, 0.3, backend="cpu")["rgb"])
    assert np.ptp(images[0]) > 0.1
    np.testing.assert_array_equal(*images)
