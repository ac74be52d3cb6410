# SPDX-License-Identifier: GPL-3.0-or-later
"""match_grade(): known looks of one part of a place are found from the other part."""
from dataclasses import replace

import numpy as np
import pytest
from stitched_scenes import part

import fastgs_blender as fg
from fastgs_blender.rendering.looks import graded, look_numbers


def graded_part(look, **options):
    model = part(fg, 4, -1, 3, **options)
    return replace(model, features=graded(model.features, look_numbers(look, "srgb")))


@pytest.mark.slow
@pytest.mark.parametrize("look", [
    fg.ObjectSettings(exposure=0.6), fg.ObjectSettings(exposure=-0.8, tint=(1.0, 0.9, 0.7)),
    fg.ObjectSettings(saturation=0.6, contrast=1.2),
    fg.ObjectSettings(hue=0.25), fg.ObjectSettings()])
def test_a_known_grade_is_found(look):
    moving, fixed = fg.Instance(part(fg, 4, -3, 1), np.eye(4), 0.0), fg.Instance(graded_part(look), np.eye(4), 0.0)
    found = fg.match_grade(moving, fixed)
    assert found.after < 0.025 and found.after <= found.before and found.pixels > 1000
    colours = np.random.default_rng(0).uniform(0.1, 0.8, (200, 3))
    mine = graded(colours, look_numbers(fg.ObjectSettings(**found.looks), "srgb"))
    assert np.abs(np.clip(mine, 0, 1) - np.clip(graded(colours, look_numbers(look, "srgb")), 0, 1)).mean() < 0.035


def test_the_others_look_counts_and_ones_own_is_replaced():
    model = part(fg, 4, -3, 3)
    look = fg.ObjectSettings(exposure=0.5, saturation=0.7)
    found = fg.match_grade(fg.Instance(model, np.eye(4), 0.0, fg.ObjectSettings(exposure=-2.0)), fg.Instance(model, np.eye(4), 0.0, look))
    assert found.looks["exposure"] == pytest.approx(0.5, abs=0.06) and found.looks["saturation"] == pytest.approx(0.7, abs=0.06)
    assert found.after < 0.01 < found.before


def test_what_does_not_overlap_is_refused():
    with pytest.raises(fg.FastGSError, match="align"):
        fg.match_grade(fg.Instance(part(fg, 4, -3, -1), np.eye(4), 0.0), fg.Instance(part(fg, 4, 1, 3), np.eye(4), 0.0))
