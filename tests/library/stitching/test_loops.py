# SPDX-License-Identifier: GPL-3.0-or-later
"""find_loop(): the period of clips that have one, and seams that a fade makes smaller."""
from dataclasses import replace

import numpy as np
import pytest
from stitched_scenes import swinging

import fastgs_blender as fg


@pytest.mark.parametrize("period", [20, 17.5, 23.25])
def test_a_known_period_is_found(period):
    loop = fg.find_loop(swinging(fg, period), least=12, fade=4)
    rounds = round(loop.length / period)  # one, or two where its frames meet those of the clip better
    assert rounds >= 1 and loop.length == pytest.approx(rounds * period, abs=0.13)
    assert loop.cut < 1.6 and loop.motion > 0.95
    assert loop.start >= 0 and loop.end <= 59


@pytest.mark.parametrize("least", [25, 38])
def test_it_lasts_as_long_as_is_wanted(least):
    loop = fg.find_loop(swinging(fg, 20), least=least, fade=0)
    assert loop.length == pytest.approx(40, abs=0.13) and loop.fade == 0


def test_a_clip_without_a_period_is_better_with_a_fade():
    wander = swinging(fg, 71.0, frames=48, n=60)
    loop = fg.find_loop(wander, least=20, fade=8)
    assert loop.blended < loop.cut and loop.length >= 20 and loop.end <= 47
    assert fg.find_loop(wander, least=20, fade=8) == loop


@pytest.mark.parametrize(("period", "uncut"), [(48, True), (47, True), (30, False)])
def test_a_clip_that_loops_by_itself_is_left_whole(period, uncut):
    """No cut of it is better than its own end; one of a round and a half has a better cut."""
    loop = fg.find_loop(swinging(fg, period, frames=48, n=80), fade=4)
    assert loop.uncut == uncut and loop.seam < 1.05
    assert (loop.start, loop.length, loop.fade) == (0, 48, 0) if uncut else loop.length == pytest.approx(30, abs=0.13)
    assert loop.uncut or loop.blended < loop.whole


def test_backwards_is_not_taken_for_the_same():
    """A pendulum is at one place twice in a period; only once it goes the same way."""
    model = swinging(fg, 24, n=80)
    model = replace(model, basis=fg.Fourier(order=1, scale=60 / 24), motion=model.motion[:, :2] * [[[0], [1]]])
    loop = fg.find_loop(model, least=8, fade=0)
    assert loop.length == pytest.approx(24, abs=0.13) and loop.motion > 0.9


def test_a_range_and_masks_are_kept_to():
    from fastgs_blender.rendering.masks import pack_mask

    loop = fg.find_loop(swinging(fg, 16), least=10, fade=2, first=10, last=40)
    assert loop.start >= 10 and loop.end <= 40 and loop.length == pytest.approx(16, abs=0.13)
    steady, odd = swinging(fg, 15, n=80), swinging(fg, 26, n=80, seed=3)
    both = fg.concatenate([steady, replace(odd, basis=steady.basis, motion=odd.motion * [[[3], [-3], [0], [5]]])])
    masked = fg.ObjectSettings(mask=pack_mask(np.arange(160) >= 80))
    assert fg.find_loop(both, least=9, fade=0, settings=masked).length == pytest.approx(15, abs=0.13)


@pytest.mark.parametrize(("options", "say"), [(dict(least=70), "too short"), (dict(first=58), "four frames"), (dict(fade=-1), "fade")])
def test_what_cannot_be_is_told(options, say):
    with pytest.raises(fg.FastGSError, match=say):
        fg.find_loop(swinging(fg, 20), **options)


def test_a_still_has_no_loop():
    with pytest.raises(fg.FastGSError, match="still"):
        fg.find_loop(fg.freeze(swinging(fg, 20), 0.0))
