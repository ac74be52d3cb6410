# SPDX-License-Identifier: GPL-3.0-or-later
"""align(): parts of one place, moved, scaled, recoloured and noisy, come back onto each other; others are refused."""
from dataclasses import replace

import numpy as np
import pytest
from stitched_scenes import motion, off, part, place

import fastgs_blender as fg


def pair(seed, true, **options):
    """Two captures that share 2 of 6 units of a place, the first one moved."""
    return fg.Instance(part(fg, seed, -3, 1, **options), true, 0.0), fg.Instance(part(fg, seed, -1, 3), np.eye(4), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "angle", "far", "scale"), [
    (0, 0.25, 0.3, 1.0), (4, 0.3, 0.4, 1.0), (5, 0.2, 0.3, 1.2), (6, 0.0, 0.0, 1.0)])
def test_overlapping_parts_fit(seed, angle, far, scale):
    true = motion(np.random.default_rng(seed), angle, far, scale)
    found = fg.align(*pair(seed, true), scale=scale != 1)
    assert off(found.matrix @ true, place(seed)[0]) < 0.03  # of 6 units
    assert found.scale * scale == pytest.approx(1, abs=0.01) and found.residual < 0.03 and 0.2 < found.overlap < 0.9


def test_recoloured_and_thinned_copies_fit():
    true = motion(np.random.default_rng(2), 0.2, 0.3)
    moving, fixed = pair(4, true, count=5000)
    warm = replace(moving.model, features=np.clip(moving.model.features**1.4 * [1.1, 0.9, 0.7], 0, 1))
    found = fg.align(replace(moving, model=warm), fixed)
    assert off(found.matrix @ true, place(4)[0]) < 0.04


@pytest.mark.slow
def test_it_is_searched_for_all_around():
    true = motion(np.random.default_rng(15), 2.4, 8.0)
    moving, fixed = fg.Instance(part(fg, 4, -3, 2), true, 0.0), fg.Instance(part(fg, 4, -2, 3), np.eye(4), 0.0)
    found = fg.align(moving, fixed)
    assert off(found.matrix @ true, place(4)[0]) < 0.04
    with pytest.raises(fg.FastGSError, match="no sure fit"):
        fg.align(moving, fixed, search=False)


@pytest.mark.slow
@pytest.mark.parametrize("other", [part(fg, 9, -3, 3, features=np.random.default_rng(0).uniform(size=(13000, 3))), part(fg, 0, 1.5, 3)])
def test_what_does_not_overlap_is_refused(other):
    with pytest.raises(fg.FastGSError, match="three pairs"):
        fg.align(fg.Instance(part(fg, 0, -3, 0), np.eye(4), 0.0), fg.Instance(other, np.eye(4), 0.0))


@pytest.mark.slow
def test_two_floors_slide():
    flat = part(fg, 0, -3, 3)
    floor = flat.take(flat.position[:, 2] < 0.02)
    floor = replace(floor, features=np.full((len(floor), 3), 0.5))
    with pytest.raises(fg.FastGSError, match="slide|no sure fit"):
        fg.align(fg.Instance(floor, np.eye(4), 0.0), fg.Instance(floor, np.eye(4), 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"noise": 0.02}, {"count": 3000}])
def test_what_lies_there_stays_exactly_and_a_small_motion_is_undone(options):
    """Without the judge of no motion these moved by 0.001 to 0.01."""
    assert np.array_equal(fg.align(*pair(6, np.eye(4), **options)).matrix, np.eye(4))
    true = motion(np.random.default_rng(6), 0.0, 0.03)
    assert off(fg.align(*pair(6, true, **options)).matrix @ true, place(6)[0]) < 0.015


def test_masked_gaussians_do_not_count():
    """Only what an instance shows is laid onto the other."""
    from fastgs_blender.rendering.masks import pack_mask

    whole, true = part(fg, 4, -3, 3), motion(np.random.default_rng(3), 0.2, 0.3)
    moving = fg.Instance(whole, true, 0.0, fg.ObjectSettings(mask=pack_mask(whole.position[:, 0] > 1)))
    found = fg.align(moving, fg.Instance(part(fg, 4, -1, 3), np.eye(4), 0.0))
    assert off(found.matrix @ true, place(4)[0]) < 0.03 and found.overlap < 0.8


def test_progress_ends_at_one_and_can_stop_it():
    shares = []
    moving, fixed = pair(0, np.eye(4))
    fg.align(moving, fixed, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] <= 1

    def stop(share):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        fg.align(moving, fixed, progress=stop)


def test_nothing_solid_is_told():
    faint = replace(part(fg, 0, -3, 0), opacity=np.full(len(part(fg, 0, -3, 0)), -4.0))
    with pytest.raises(fg.FastGSError, match="solid"):
        fg.align(fg.Instance(faint, np.eye(4), 0.0), fg.Instance(part(fg, 0, -1, 3), np.eye(4), 0.0))
