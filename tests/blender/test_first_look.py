# SPDX-License-Identifier: GPL-3.0-or-later
"""The first picture that a newcomer sees, judged by what the library draws from there."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import black_behind, read_png, region_camera

import fastgs_blender as fg
from fastgs_blender.rendering.instances import Instance, ObjectSettings

CLEAR = slice(130, -50), slice(80, -330)
"""Of the view, where neither Blender's text and buttons nor our tab lie over it."""


@pytest.fixture(scope="module")
def looked(user):
    """The example imported into the startup file, in Solid and Rendered shading, and framed by Blender's own keys."""
    return user.story("first_look.newcomer", window=True)


def cover(model, facts) -> np.ndarray:
    """What of a view a model covers at the story's frame: its alpha [h, w]."""
    shown = Instance(model, np.eye(4), model.clip.t_of_frame(facts["frame"]), ObjectSettings(backdrop="HIDDEN"))
    return fg.render([shown], region_camera(facts))["alpha"]


def dancer(example, frame) -> fg.GaussianModel:
    """The example without the room around her."""
    x, y, z = fg.slice_model(example, example.clip.t_of_frame(frame), cull=False).position.T
    return example.take((np.hypot(x, y) < 0.5) & (z > 0.06) & (z < 2.2))


@pytest.mark.parametrize("name", ["solid", "rendered"])
def test_the_subject_fills_at_least_a_third_of_the_views_height(looked, example, name):
    facts = {**looked[name], "frame": looked["frame"]}
    rows = np.flatnonzero((cover(dancer(example, looked["frame"]), facts) > 0.5).any(1))
    assert np.ptp(rows) > facts["region"][3] / 3
    assert facts["cube"] == [True, True]


def test_numpad_period_frames_the_subject(looked, example):
    """The dancer, not all of her room: its walls are more than twice as high and as far apart as she is tall."""
    covered = cover(dancer(example, looked["frame"]), {**looked["period"], "frame": looked["frame"]}) > 0.5
    rows = np.flatnonzero(covered.any(1))
    print(f"Numpad-period: the dancer fills {np.ptp(rows) / looked['period']['region'][3]:.2f} of the view's height")
    assert np.ptp(rows) > looked["period"]["region"][3] / 3


def test_home_shows_all_of_the_subject(looked, example):
    """The startup file's camera and lamp are part of what Home shows too."""
    covered = cover(dancer(example, looked["frame"]), {**looked["home"], "frame": looked["frame"]}) > 0.5
    rows = np.flatnonzero(covered.any(1))
    assert covered.mean() > 0.001 and rows[0] > 0 and rows[-1] < covered.shape[0] - 1
    assert looked["home"]["distance"] < 30


def test_nothing_hides_it(looked, user, example, reference):
    """Solid shows the splats over its grid; Rendered, under Standard, is what the library draws."""
    for name, colours in (("solid", lambda w: w[..., :3]), ("standard", black_behind)):
        x, y, width, height = looked[name]["region"]
        wanted = reference(example, region_camera(looked[name]), looked["frame"])[CLEAR]
        shown = read_png(user.folder / f"first-{name}.png")[y:y + height, x:x + width, :3][CLEAR]
        opaque = wanted[..., 3] > 0.99
        assert opaque.mean() > 0.6 and wanted[..., :3].std() > 0.1
        error = np.quantile(np.abs(shown - colours(wanted)).max(-1)[opaque], 0.9)
        print(f"The first look, {name}: 90 % of the pixels differ by less than {error * 255:.1f}/255")
        assert error <= 9 / 255


def test_colours_are_the_users(looked):
    assert [looked[name]["transform"] for name in ("solid", "rendered", "standard")] == ['AgX', 'AgX', 'Standard']


def test_preferences_are_drawn_and_their_guide_is_a_page_for_browsers(user):
    facts = user.story("first_look.preferences", window=True)
    assert facts["guide"] == "guide.html" and facts["words"] > 5
    picture = read_png(user.folder / "first-preferences.png")[..., :3]
    assert picture.std() > 0.05
