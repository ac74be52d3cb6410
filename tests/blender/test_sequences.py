# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbered files as one object in a real window: each frame is its file, in viewports and in F12."""
from __future__ import annotations

import models
import numpy as np
import pytest
from conftest import black_behind, library_camera, psnr, read_png, region_camera

import fastgs_blender as fg

FRAMES = 12
INNER = slice(40, -6), slice(6, -6)


@pytest.fixture(scope="module")
def frames(newcomer):
    """Models of frames, each with a few Gaussians less than the one before, and the names of their files."""
    folder = newcomer.folder / "take"
    folder.mkdir()
    knot, found = models.knot(3_000, seed=8), {}
    for i in range(FRAMES):
        frame = fg.freeze(knot, 0.9 * i / FRAMES)
        frame = frame.take(np.arange(len(frame) - 40 * i))
        fg.save(frame, folder / f"knot_{i + 1:03}.ply")
        found[f"knot_{i + 1:03}.ply"] = fg.load(folder / f"knot_{i + 1:03}.ply")
    return found


@pytest.fixture(scope="module")
def played(user, frames, small_model):
    return user.story("sequences.playing", window=True, folder="take", names=list(frames), beside=small_model[1])


def test_chosen_files_are_one_object(played):
    assert len(played["made"]) == 1 and "take" in played["made"][0]
    first, last = played["range"]
    assert last - first + 1 == FRAMES


@pytest.mark.parametrize("offset", ["2", "11", "5", "7"])
def test_a_frame_is_its_file(played, frames, user, offset):
    """Scrubbed to in any order, and after it was played."""
    place = played["views"][offset]
    x, y, width, height = place["region"]
    shown = read_png(user.folder / f"sequence-{offset}.png")[y:y + height, x:x + width, :3]
    alone = fg.render([(list(frames.values())[int(offset)], np.eye(4), 0.0)], region_camera(place))
    expected = black_behind(np.concatenate([alone["rgb"], alone["alpha"][..., None]], -1))
    own = np.flatnonzero((alone["alpha"] > 0).any(0))[-1] - 4  # columns beyond are the still model's
    shown, expected = (picture[INNER][:, :own] for picture in (shown, expected))
    assert expected.std() > 0.03
    assert psnr(shown, expected) >= 40
    worse = fg.render([(list(frames.values())[(int(offset) + 3) % FRAMES], np.eye(4), 0.0)], region_camera(place))
    other = black_behind(np.concatenate([worse["rgb"], worse["alpha"][..., None]], -1))[INNER][:, :own]
    assert psnr(shown, other) < psnr(shown, expected) - 10


def test_it_plays_from_disk(played, frames):
    first, _ = played["range"]
    assert played["seen"] == list(range(first, first + FRAMES))
    counts = {len(frame) for frame in frames.values()}
    assert len(counts & set(played["drawn"])) > FRAMES / 2
    assert max(played["kept"]) <= played["limit"]


def test_f12_of_a_frame_is_its_file(played, frames, user):
    camera = library_camera(played["camera"])
    alone = fg.render([(list(frames.values())[played["rendered"]], np.eye(4), 0.0)], camera)
    expected = black_behind(np.concatenate([alone["rgb"], alone["alpha"][..., None]], -1))
    saved = read_png(user.folder / "sequence-f12.png")[..., :3]
    assert expected.std() > 0.05
    assert np.abs(saved - expected).max() <= 2 / 255
