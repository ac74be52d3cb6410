# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of tiles: of long thin splats, and of some of the tiles alone."""
import numpy as np
import pytest

from fastgs_blender.cameras.camera import Camera
from fastgs_blender.kernels.cpu import raster, tiles
from fastgs_blender.kernels.cpu.jit import kernel
from fastgs_blender.kernels.cpu.lanes import LANES
from fastgs_blender.kernels.cpu.rasterise import rasterise
from fastgs_blender.kernels.cpu.tile_lists import TileLists, list_tiles, tiles_of
from fastgs_blender.util.threads import set_threads

CAMERA = Camera(150, 120, 100, 100, 75, 60, np.eye(4), window=(5, 3, 131, 110))


@pytest.fixture
def splats():
    """Of 400 splats, from round to long and thin, their order, geometry and attributes (raster.py)."""
    rng, n = np.random.default_rng(4), 400
    geometry = np.stack([rng.uniform(-20, 170, n), rng.uniform(-20, 140, n), 10 ** rng.uniform(-1.6, 0, n), rng.normal(0, 0.3, n),
                         10 ** rng.uniform(-1.6, 0, n)], 1)
    attributes = np.empty((n, raster.CHANNEL + 3), np.float32)
    attributes[:, raster.LOG2_OPACITY], attributes[:, raster.LOG2_CUT] = rng.uniform(-6, 0, n), -8
    attributes[:, raster.ALPHA_MAX], attributes[:, raster.DEPTH] = 0.99, 1
    attributes[:, raster.CHANNEL:] = rng.uniform(0, 1, (n, 3))
    reach = np.sqrt(attributes[:, raster.LOG2_OPACITY].astype(float) + 8)
    _, _, a, b, c = geometry.T
    attributes[:, raster.RADIUS_X] = reach * np.hypot(b, c) / (a * c) + 1e-3
    attributes[:, raster.RADIUS_Y] = reach / c + 1e-3
    return np.arange(n, dtype=np.int32), geometry, attributes


def test_a_tile_lists_each_splat_that_shows_in_it(splats):
    order, geometry, attributes = splats
    listing = TileLists.of(*splats, CAMERA)
    starts, ids = list_tiles(listing.segments, listing.counts, 0, listing.counts.shape[1])
    left, top, columns, rows = listing.grid
    y, x = np.mgrid[top * 16:(top + rows) * 16, left * 16:(left + columns) * 16] + 0.5
    listed = shown = 0
    for i in order:
        mx, my, a, b, c = geometry[i]
        alpha = attributes[i, raster.LOG2_OPACITY] - (a * (x - mx) + b * (y - my)) ** 2 - (c * (y - my)) ** 2
        tiles = (alpha >= attributes[i, raster.LOG2_CUT]).reshape(rows, 16, columns, 16).any((1, 3)).ravel()
        has = np.array([i in ids[starts[tile]:starts[tile + 1]] for tile in range(rows * columns)])
        assert has[tiles].all()
        listed, shown = listed + has.sum(), shown + tiles.sum()
    assert shown <= listed < 1.1 * shown


@kernel
def extents(low, ellipses, mx, box_right, found):
    """tiles._extent() of each ellipse [n, 5], in rows from `low` [n] of its centre on, into found [n, 2, LANES]."""
    number = np.empty((1, LANES))
    for lane in range(LANES):
        number[0, lane] = lane * 16
    for k in range(len(ellipses)):
        ellipse = ellipses[k, 0], ellipses[k, 1], ellipses[k, 2], ellipses[k, 3], ellipses[k, 4]
        tiles._extent(number, low[k], 16, ellipse, mx[k], 0.0, box_right, found[k])


def test_tiles_of_an_ellipse_lie_in_the_picture_also_where_it_touches_none():
    """What spans() writes where a row is not touched has to lie in its arrays: a needle's tip may be thousands of pixels away."""
    rng, n, columns = np.random.default_rng(6), 2000, 9
    square, a, b, c = rng.uniform(-1, 8, n), 10 ** rng.uniform(-2, 3, n), rng.normal(0, 30, n), 10 ** rng.uniform(-3, 0, n)
    peak = b * np.sqrt(np.maximum(square, 0)) / (c * np.hypot(b, c))
    ellipses, found = np.stack([square, peak, a, b, c], 1), np.empty((n, 2, LANES))
    ellipses[:3, 1:4] = np.nan
    extents(rng.uniform(-300, 100, n), ellipses, rng.uniform(-500, 700, n), 16.0 * columns - 1, found)
    first, last = found.transpose(1, 0, 2).astype(int)
    touched = first <= last
    assert 0.01 < touched.mean() < 0.9 and not touched[:3].any()
    assert (first >= 0).all() and (last < columns).all() and (first[touched] < columns).all() and (last[~touched] == -1).any()
    assert (first <= columns).all() and (last >= -1).all()


@pytest.mark.parametrize("threads", [1, 7])
def test_the_tiles_that_are_wanted_are_as_if_all_were(splats, threads):
    order, geometry, attributes = splats
    whole = rasterise(order, geometry, attributes, 3, CAMERA)
    wanted = np.random.default_rng(5).random(9 * 8) < 0.3
    set_threads(threads)
    try:
        part = rasterise(order, geometry, attributes, 3, CAMERA, wanted=wanted)
    finally:
        set_threads(0)
    x0, y0, width, height = CAMERA.window
    mask = np.kron(wanted.reshape(8, 9), np.ones((16, 16), bool))[y0:y0 + height, x0:x0 + width]
    assert (part.channels[mask] == whole.channels[mask]).all() and (part.alpha[mask] == whole.alpha[mask]).all()
    assert not part.alpha[~mask].any() and mask.any() and not mask.all()


def test_pixels_ask_for_the_tiles_that_they_lie_in():
    x0, y0, width, height = CAMERA.window
    x, y = np.random.default_rng(6).integers(0, [[width], [height]], (2, 20))
    pixels, expected = np.zeros((height, width), bool), np.zeros((8, 9), bool)
    pixels[y, x] = expected[(y + y0) // 16, (x + x0) // 16] = True
    assert np.array_equal(tiles_of(pixels, CAMERA), expected.ravel()) and not expected.all()
    assert tiles_of(None, CAMERA) is None
