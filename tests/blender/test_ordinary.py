# SPDX-License-Identifier: GPL-3.0-or-later
"""Splats under Blender's ordinary operators and in its other engines, in real windows."""
from __future__ import annotations

import itertools

import numpy as np
import pytest
from conftest import library_camera, psnr, read_png, region_camera

import fastgs_blender as fg

INNER = slice(60, -66), slice(70, -70)
"""The part of the 3D view without its headers, its tools, the last operator's panel and pop-ups."""
FRAMES = (5, 20, 32.5)


@pytest.fixture(scope="module")
def story(user, small_model):
    return user.story("ordinary.operators", window=True, model=small_model[1])


@pytest.fixture
def shown(user, story):
    """shown(name): what the 3D view shows in a screenshot."""
    def cut(name):
        x, y, width, height = story["view"]["region"]
        return read_png(user.folder / f"ordinary-{name}.png")[y:y + height, x:x + width, :3][INNER]

    return cut


@pytest.mark.parametrize("name", ["applied", "origin", "joined", "edited", "shown"])
def test_operators_leave_splats_where_they_are(shown, name):
    assert psnr(shown(name), shown("before")) >= 45


def test_they_are_where_the_library_draws_them(story, shown, small_model):
    model = small_model[0]
    camera = region_camera(story["view"])
    t = model.clip.t_of_frame(story["frame"] - story["start"])
    alpha = fg.render([(model, np.array(story["matrix"]), t)], camera, passes=["alpha"])["alpha"][INNER]
    different = np.abs(shown("before") - shown("deleted")).max(-1) > 0.03
    assert (different & (alpha > 0.5)).sum() > 0.8 * (alpha > 0.5).sum()
    assert (different & (alpha < 0.02)).sum() < 0.02 * different.sum()


def test_the_origin_moves_alone(story):
    assert story["origin"] == pytest.approx([1, 1, 0])


def test_what_was_joined_is_parted(story):
    assert [faces for _, faces in story["joined"]] == [6, 0]


def test_a_click_on_splats_selects_them(story):
    for shading in ("SOLID", "MATERIAL", "RENDERED"):
        assert len(story["clicked"][shading]) == 1 and story["clicked"][f"{shading} beside"] == [], shading


@pytest.mark.parametrize("name", ["hidden", "deleted"])
def test_what_is_gone_is_not_shown(shown, name):
    assert shown(name).std() < 0.02


@pytest.fixture(scope="module")
def engines(user, small_model):
    return user.story("ordinary.engines", window=True, model=small_model[1], frames=FRAMES)


def apart(one, other):
    """The mean distances, in pixels, of the pixels of each of two masks [h, w] from the nearest of the other."""
    a, b = (np.argwhere(mask).astype(np.float32) for mask in (one, other))
    square = ((a[:, None] - b[None]) ** 2).sum(-1)
    return np.sqrt(square.min(1)).mean(), np.sqrt(square.min(0)).mean()


@pytest.mark.parametrize("engine", ["workbench", "cycles", "eevee"])
def test_other_engines_show_the_moving_splats_in_colour(engines, user, small_model, engine):
    """On the mean, what is covered and what should be are within 1 % of the height of each other, both ways."""
    model = small_model[0]
    camera, pictures = library_camera(engines["camera"]), []
    for frame in FRAMES:
        picture = read_png(user.folder / f"engine-{engine}-{frame:g}.png")
        truth = fg.render([(model, np.eye(4), model.clip.t_of_frame(frame - engines["start"]))], camera)
        here, there = picture[..., 3] > 0.5, truth["alpha"] > 0.5
        height = np.ptp(np.flatnonzero(there.any(1)))
        print(f"{engine}, frame {frame:g}: {', '.join(f'{100 * away / height:.2f} %' for away in apart(here, there))} of the height apart")
        assert max(apart(here, there)) <= 0.01 * height
        both = here & there
        seen, wanted = picture[..., :3][both], truth["rgb"][both] / truth["alpha"][both][:, None]
        assert all(np.corrcoef(seen[:, k], wanted[:, k])[0, 1] > (0.5 if engine == "workbench" else 0.8) for k in range(3))
        pictures.append(picture)
    assert all(np.abs(a - b).mean() > 0.005 for a, b in itertools.pairwise(pictures))
