# SPDX-License-Identifier: GPL-3.0-or-later
"""The ways in which users look at things: what viewports show of splats in each."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import black_behind, psnr, read_png, region_camera

import fastgs_blender as fg


@pytest.fixture(scope="module")
def looks(user, small_model):
    return user.story("looking.ways", window=True, model=small_model[1])


@pytest.fixture
def library(looks, small_model):
    """library(place, objects): what the library draws of the two objects for what `seen_by` says; RGBA, premultiplied."""
    def draw(place, objects=(0, 1)):
        t = small_model[0].clip.t_of_frame(looks["frame"] - looks["start"])
        places = [np.eye(4), np.eye(4)]
        places[1][:3, 3] = looks["second"]
        out = fg.render([(small_model[0], places[i], t) for i in objects], region_camera(place))
        return np.concatenate([out["rgb"], out["alpha"][..., None]], -1)

    return draw


@pytest.fixture
def shown(user):
    """shown(name, place): a screenshot's part where a region is."""
    def cut(name, place):
        x, y, width, height = place["region"]
        return read_png(user.folder / f"{name}.png")[y:y + height, x:x + width, :3]

    return cut


MARGIN, BAR = 4, 32
"""Pixels at a region's edge that Blender draws on: rounded corners, the lines between four views; and at the top of the area, where 5.2
keeps the bar of tool settings."""
INNER = slice(BAR, -MARGIN), slice(MARGIN, -MARGIN)


@pytest.mark.parametrize(("name", "objects"), [("front", (0, 1)), ("local", (1,))])
def test_a_view(looks, library, shown, name, objects):
    """From the front, orthographic; and of one object by itself, in local view."""
    wanted = black_behind(library(looks[name], objects))
    assert wanted.std() > 0.05
    assert psnr(shown(name, looks[name])[INNER], wanted[INNER]) >= 40


def test_framing(looks):
    where, wanted = looks["framed"]
    assert np.allclose(where, wanted, atol=1e-3)


def test_four_views(looks, library, shown):
    assert len(looks["quad"]) == 4
    for place in looks["quad"]:
        wanted = black_behind(library(place))
        assert wanted.std() > 0.02
        assert psnr(shown("quad", place)[INNER], wanted[INNER]) >= 40


def test_a_border_to_render(looks, library, shown):
    picture, wanted = shown("border", looks["border"]), black_behind(library(looks["border"]))
    height, width = picture.shape[:2]
    inside = slice(round(0.25 * height) + 2, round(0.75 * height) - 2), slice(round(0.25 * width) + 2, round(0.625 * width) - 2)
    assert wanted[inside].std() > 0.05
    assert psnr(picture[inside], wanted[inside]) >= 40
    for outside in (picture[round(0.75 * height) + 2:-MARGIN, MARGIN:-MARGIN], picture[inside[0], round(0.625 * width) + 2:-MARGIN]):
        assert np.ptp(outside.reshape(-1, 3), axis=0).max() < 0.02


def test_xray_and_wireframe(looks, library, shown):
    place = looks["border"]
    opaque = library(place)[..., 3] > 0.99
    solid, xray, wires, without = (shown(name, place) for name in ("solid-both", "xray", "wireframe", "without"))
    strength = np.abs(solid - without)[opaque].mean()
    assert strength > 0.1
    assert 0.3 < np.abs(xray - without)[opaque].mean() / strength < 0.7
    assert np.abs(wires - without)[INNER].max(-1).mean() < 0.02


def test_a_click_on_the_box_selects(looks):
    assert looks["clicked"] == looks["wanted"]


def test_density_and_pixels(looks):
    (count, width, height), = looks["whole"]
    _, _, w, h = looks["front"]["region"]
    assert (width, height) == (w // 4, h // 4)
    (playing, *_), = looks["playing"]
    (rested, *_), = looks["rested"]
    assert playing <= 0.3 * count
    assert rested == pytest.approx(count, rel=0.1)
