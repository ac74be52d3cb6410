# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs sync: offsets by motion and by a short training, into sync.json and a picture."""
from __future__ import annotations

import json
from collections import Counter
from functools import partial

import numpy as np
import pytest
from PIL import Image
from uneven_captures import write_uneven

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.clocks.files import FILE, Clocks, read_clocks
from fastgs_blender.checks import timing
from fastgs_blender.checks.reprojection import Judged
from fastgs_blender.checks.samples import Inspection
from fastgs_blender.cli import main
from fastgs_blender.commands import sync
from fastgs_blender.training.run import clocks
from fastgs_blender.util.errors import FastGSError

OFFSETS = {"cam02": 3.4}


@pytest.fixture
def shifted(tmp_path):
    return write_uneven(tmp_path / "capture", 36, 4, OFFSETS, zoom=2)


def test_quick(shifted, capsys):
    assert main(["sync", str(shifted), "--quick", "--quiet"]) == 0
    found = read_clocks(shifted)
    assert found.found_by == "motion" and found.offsets == pytest.approx({"cam00": 0, "cam01": 0, "cam02": 3.4, "cam03": 0}, abs=0.25)
    text = capsys.readouterr().out
    assert "cam02" in text and "+3." in text and max(map(len, text.splitlines()[:5])) <= 80
    picture = np.asarray(Image.open(shifted / "sync.png"))
    assert picture.shape == (620, 1100, 3) and (picture < 100).any(-1).mean() > 0.001
    capture = open_capture(shifted)
    assert max(shot.t for shot in capture.shots if shot.view == "cam02") > (capture.clip.frame_count - 1) / capture.clip.frame_count
    assert not timing.run(Inspection(capture)).findings, "after sync, check is content"


@pytest.mark.slow
def test_refining_keeps_what_was_found_and_measures_all_views(shifted, monkeypatch, capsys):
    seen = []

    def few(path, first, lost=(), layout=None, **_):
        return refined(path, first, lost, layout, 240, progress=lambda *told: seen.append(told))

    refined = clocks.refined
    monkeypatch.setattr(clocks, "refined", few)
    assert main(["sync", str(shifted), "--quiet", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["found_by"] == "training" and values["offsets"].keys() == {"cam00", "cam01", "cam02", "cam03"}
    assert values["offsets"]["cam02"] == pytest.approx(3.4, abs=0.5) and seen[-1] == (clocks.STAGES[-1], 1)
    assert Counter(stage for stage, _ in seen)["finding starting points"] > 1, "what takes long tells how far it is"
    assert set(clocks.STAGES) == {stage for stage, _ in seen} and set(clocks.STAGES) < set(sync.WEIGHTS)
    assert np.median(list(values["offsets"].values())) == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_training_begins_anew_where_a_clock_is_farther_than_it_corrects(shifted, monkeypatch, capsys):
    """The search found nothing; the small pictures of the training show 3.4 frames, of which training corrects 1.5."""
    def nothing(*_):
        raise FastGSError("what moves looks too different from camera to camera")

    monkeypatch.setattr("fastgs_blender.captures.clocks.find.find_offsets", nothing)
    monkeypatch.setattr(clocks, "refined", partial(clocks.refined, steps=240))
    assert main(["sync", str(shifted), "--quiet", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["offsets"]["cam02"] == pytest.approx(3.4, abs=0.25) and not values["lost"]


def test_what_cannot_be_found_is_told(tmp_path, capsys):
    folder = write_uneven(tmp_path / "still", 14, 3, speed=0.0)
    assert main(["sync", str(folder), "--quiet"]) == 2
    assert "nothing moves" in capsys.readouterr().err and not (folder / FILE).exists()


def test_a_camera_with_a_wrong_pose_has_no_clock(shifted, monkeypatch, tmp_path, capsys):
    """Planes through wrong poses say nothing: neither its clock nor those of others are found by it. --status tells the stages."""
    monkeypatch.setattr(Inspection, "judged", Judged({}, ["cam02"]))
    status = tmp_path / "status.json"
    assert main(["sync", str(shifted), "--quick", "--json", "--status", str(status)]) == 0
    told = capsys.readouterr()
    values = json.loads(told.out)
    assert values["lost"] == values["misplaced"] == ["cam02"] and values["offsets"] == {f"cam{k:02}": 0 for k in range(4)}
    assert "cam02" in told.err and "pose" in told.err and "alibrate" in told.err
    assert json.loads(status.read_text("utf-8"))["stage"] in sync.WEIGHTS


@pytest.mark.slow
def test_a_camera_with_a_wrong_pose_is_not_trained_on(shifted, monkeypatch):
    monkeypatch.setattr(clocks, "start", lambda capture, *_: pytest.fail(str(capture.views)))
    with pytest.raises(pytest.fail.Exception, match=r"\['cam00', 'cam02', 'cam03'\]"):
        clocks.refined(shifted, Clocks({"cam01": 0.5}, {}, "sound"), misplaced=["cam01"])


def test_a_part_of_the_clip(shifted, monkeypatch, capsys):
    """--frames is what is compared and what is refined on; the offsets hold for all frames."""
    parts = []
    monkeypatch.setattr(clocks, "refined", lambda path, first, lost, layout=None, frames=None, **_: parts.append(clocks._small(
        path, first.offsets, layout, frames)) or (first, ()))
    assert main(["sync", str(shifted), "--quiet", "--frames", "2:33", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["offsets"]["cam02"] == pytest.approx(3.4, abs=0.35)
    clip = parts[0].clip
    begin = open_capture(shifted, offsets={}).clip.start_frame
    assert (clip.start_frame - begin, clip.frame_count) == (3 + (31 - 24) // 2, 24), "cam02 has no picture of frame 2"
    assert main(["sync", str(shifted), "--quiet", "--frames", "0:30:3"]) == 2 and "--frames" in capsys.readouterr().err
