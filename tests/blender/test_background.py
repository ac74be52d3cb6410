# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension in Blender without a window."""
from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from blenders import User
from conftest import psnr, read_png


def test_blender_accepts_the_zip(newcomer, user):
    newcomer.blender("--command", "extension", "validate", Path(os.environ["FASTGS_ZIP"]).name)


def test_installing_brings_what_blender_lacks(user):
    """The wheels that fit this Python, unpacked in the user's folder, without a network."""
    facts = user.story("background.environment")
    print(facts)
    assert facts["enabled"]
    assert facts["engine"]
    for place in facts["places"].values():
        assert place.startswith("/mnt/home/")


def test_enabling_is_light(user):
    """Nothing that takes long to import; how many seconds that is depends on the machine."""
    facts = user.story("background.enabling", "--factory-startup")
    print(facts)
    assert facts["enabled"] and not facts["heavy"]


def test_nothing_stays_behind(user):
    facts = user.copy("home-gone").story("background.going")
    assert facts["differ"]
    assert facts["same"]
    assert facts["gone"]
    assert not facts["enabled"]
    assert not facts["ours"]
    assert not facts["left"]


@pytest.fixture(scope="module")
def rendered(user, model):
    """The model imported, rendered half-way between two frames, and saved."""
    return user.story("background.picture", model=model[1], output="still.png", width=320, height=240, frame=11.5)


def test_f12_shows_what_the_library_draws(rendered, user, model, reference):
    assert rendered["count"] == len(model[0])
    assert rendered["engine"] == 'FASTGS'
    assert rendered["range"] == [1, model[0].clip.frame_count]
    assert rendered["fps"] == 24
    ours, wanted = read_png(user.folder / "still.png"), reference(model[0], rendered["camera"], 11.5 - rendered["start"])
    assert wanted[..., 3].mean() > 0.1
    assert np.abs(ours - wanted).max() <= 2 / 255
    assert psnr(ours, reference(model[0], rendered["camera"], 11.5)) < 40  # time matters


def test_a_saved_file_renders_from_the_command_line(rendered, user, model, reference):
    user.blender("-b", "still.png.blend", "-o", "//frame_###", "-s", "3", "-e", "6", "-j", "3", "-a")
    for frame in (3, 6):
        ours, wanted = read_png(user.folder / f"frame_{frame:03}.png"), reference(model[0], rendered["camera"], frame - rendered["start"])
        assert np.abs(ours - wanted).max() <= 2 / 255


def test_a_saved_file_knows_its_model(rendered, user, model):
    facts = user.story("background.opened", "still.png.blend")
    assert facts["engine"] == 'FASTGS'
    assert list(facts["objects"].values()) == [[rendered["path"], len(model[0]), rendered["start"]]]


def test_without_numba_the_picture_is_the_same(newcomer, model, reference):
    """A platform without numba, installed from a repository: NumPy renders, slowly, and the log says so."""
    plain = User(newcomer.root, newcomer.folder, "home-plain")
    plain.install_from(Path(os.environ["FASTGS_REPOSITORY_WITHOUT_NUMBA"]))
    facts = plain.story("background.environment")
    assert facts["enabled"]
    assert facts["places"]["numba"] is None
    facts = plain.story("background.picture", model=model[1], output="plain.png", width=80, height=60, frame=11)
    log = max(newcomer.folder.glob("log-*-blender.txt")).read_text()
    assert "numba" in log
    ours, wanted = read_png(newcomer.folder / "plain.png"), reference(model[0], facts["camera"], 11 - facts["start"])
    assert np.abs(ours - wanted).max() <= 2 / 255
