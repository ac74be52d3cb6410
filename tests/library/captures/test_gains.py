# SPDX-License-Identifier: GPL-3.0-or-later
"""Gains by the colours of points that cameras share: found where they differ, 0 where they do not, unsure where too few points tell."""
from __future__ import annotations

import numpy as np
import pytest

from fastgs_blender.captures.evidence import differs, limits
from fastgs_blender.captures.gains import LEAST, brighter, gains_of

VIEWS, POINTS = 6, 400


def seen(gains, apart=None):
    """Colours of points by cameras with these gains [V, 3]; a point is seen by a camera and its neighbour, some of them wrongly matched.

    apart  cameras below it share no point with the others
    """
    rng = np.random.default_rng(2)
    colours = np.full((POINTS, VIEWS, 3), np.nan)
    for row in colours:
        first = rng.integers(VIEWS - 1)
        views = [first, first + 1] if apart is None or first + 1 != apart else [first]
        row[views] = rng.uniform(0.1, 0.6, 3) * np.asarray(gains)[views] * rng.normal(1, 0.04, (len(views), 3))
        if rng.random() < 0.1:
            row[views[-1]] = rng.uniform(0.05, 0.9, 3)
    return colours


def test_the_camera_that_differs_is_found_channel_by_channel():
    true = np.ones((VIEWS, 3))
    true[4] = 1.0, 1.1, 1.4  # a warmer white balance
    found = gains_of(seen(true))
    assert brighter(found).tolist() == [False, False, False, False, True, False]
    assert (np.abs(found[:, 0] - np.log(true)) < 3 * found[:, 1]).all() and found[:, 1].max() < 0.06
    low, high = limits(*np.moveaxis(found, 1, 0), brighter(found)[:, None])
    assert (low[4] < found[4, 0]).all() and (high[4] > found[4, 0]).all() and not low[:4].any() and not high[:4].any()


def test_what_shares_too_few_points_is_unsure():
    assert not gains_of(seen(np.ones((VIEWS, 3)))[:8]).any()
    found = gains_of(seen(np.linspace(1, 1.5, VIEWS)[:, None] * np.ones(3), apart=2))
    assert not found[:2].any() and found[2:, 1].all() and brighter(found)[[2, 5]].all(), "the largest group tells itself alone"


@pytest.mark.parametrize(("value", "deviation", "counts"), [
    (0.5, 0.1, True), (-0.5, 0.1, True), (0.5, 0.2, False), (0.02, 1e-6, False), (0.5, 0.0, False), (0.5, np.inf, False),
    (np.nan, 0.1, False)])
def test_only_what_is_sure_counts(value, deviation, counts):
    assert differs(value, deviation, LEAST) == counts
