# SPDX-License-Identifier: GPL-3.0-or-later
"""What fastgs check says of lenses, white balance, disk and memory, which needs no features of pictures or gets them made up here."""
from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from filmed_room import write_room
from PIL import Image
from uneven_captures import write_uneven

from fastgs_blender.captures import open_capture
from fastgs_blender.checks import calibration, cost, exposure, timing
from fastgs_blender.checks.matching import Matches, Pair
from fastgs_blender.checks.reprojection import Judged
from fastgs_blender.checks.samples import Inspection, sample
from fastgs_blender.training.initial.features import Features

VIEWS = ("cam00", "cam01", "cam02")


@pytest.fixture
def inspection(tmp_path):
    """looked(capture, matches): the samples of a capture of the room, with these matches, and the same misses for all cameras."""
    def of(path, matches=None):
        found = Inspection(open_capture(path))
        sample(found)
        found.__dict__["matches"] = matches or Matches({}, {}, [], 3)
        found.__dict__["judged"] = Judged(dict.fromkeys(VIEWS, 0.4), [])
        return found

    return of


def told(section):
    found = {}
    for finding in section.findings:
        for view in finding.views:
            found[view] = f"{found.get(view, '')} {finding.sentence}"
    return found


def test_odd_lenses_and_empty_borders_are_named(tmp_path, inspection):
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    values = json.loads((path / "cameras.json").read_text("utf-8"))
    zero, one, two = values["cameras"]
    zero["fy"] *= 1.2
    zero["cx"] += 60
    one["distortion"] = {"model": "opencv", "p1": 0.8, "p2": 1.2}
    two["fy"] *= 1.02
    two["cx"] += 20
    (path / "cameras.json").write_text(json.dumps(values), "utf-8")
    found = told(calibration.run(inspection(path)))
    assert found.keys() == {"cam00", "cam01"}, "a few per cent are usual"
    assert all(part in found["cam00"] for part in ("focal lengths", "300 and 360 pixels", "optical axis", "19%"))
    assert "distortion of cam01" in found["cam01"]


def test_what_many_cameras_share_is_told_once(tmp_path, inspection):
    path = write_room(tmp_path / "made", 7, 1, spread=0.4, detail=1)
    values = json.loads((path / "cameras.json").read_text("utf-8"))
    for i, camera in enumerate(values["cameras"]):
        camera["cx"] += 60 + i
    (path / "cameras.json").write_text(json.dumps(values), "utf-8")
    (finding,) = (finding for finding in calibration.run(inspection(path)).findings if "optical axis" in finding.sentence)
    assert len(finding.views) == 7 and "cam06" in finding.sentence and "21%" in finding.sentence


def test_one_pose_for_two_cameras_is_wrong_where_their_pictures_differ(tmp_path, inspection):
    """As where a calibration was copied by hand; one camera whose film is there twice, zoomed and darker, is none."""
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    values = json.loads((path / "cameras.json").read_text("utf-8"))
    zero, one, two = values["cameras"]
    two["world_to_camera"] = zero["world_to_camera"]
    for file in (path / "cam00").iterdir():
        shown = Image.open(file)
        shown.crop((40, 30, 280, 210)).resize((320, 240)).point(lambda v: 0.8 * v).save(path / "cam02" / file.name)
    two["fx"], two["fy"] = zero["fx"] * 4 / 3, zero["fy"] * 4 / 3
    (path / "cameras.json").write_text(json.dumps(values), "utf-8")
    assert not [finding for finding in calibration.run(inspection(path)).findings if finding.severity == "wrong"]
    one["world_to_camera"] = zero["world_to_camera"]
    (path / "cameras.json").write_text(json.dumps(values), "utf-8")
    (finding,) = (finding for finding in calibration.run(inspection(path)).findings if finding.severity == "wrong")
    assert finding.views == VIEWS and "calibration is wrong" in finding.sentence and "same pose" in finding.sentence


def test_transparent_pixels_are_no_fault_of_the_lens(tmp_path, inspection):
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    values = json.loads((path / "cameras.json").read_text("utf-8"))
    values["cameras"][1]["distortion"] = {"model": "opencv", "k1": 0.01}
    (path / "cameras.json").write_text(json.dumps(values), "utf-8")
    for file in (path / "cam01").iterdir():
        picture = Image.open(file).convert("RGBA")
        picture.paste((0, 0, 0, 0), (0, 0, picture.width, picture.height // 2))
        picture.save(file)
    of = inspection(path)
    assert not of.samples["cam01"][0].valid[:100].any()
    assert "cam01" not in told(calibration.run(of))


def made_up(path, distance, features=60):
    """Matches between neighbours, whose features lie on the diagonals of the picture; distance(view, radius) in pixels for each, radius 1
    at the corner."""
    capture = open_capture(path)
    cameras = {shot.view: shot.camera for shot in capture.shots}
    radius, corner = np.linspace(0.05, 0.98, features), np.array([(160, 120), (-160, 120)])[np.arange(features) % 2]
    places = (160, 120) + radius[:, None] * corner
    each = {(0, view): Features(places, np.zeros((features, 1)), cameras[view]) for view in VIEWS}
    rows = np.repeat(np.arange(features)[:, None], 2, 1)
    return each, [Pair(0, a, b, rows, (distance(a, radius) + distance(b, radius)) / 2) for a, b in itertools.pairwise(VIEWS)]


def test_a_lens_that_bends_more_than_its_calibration_is_seen_near_the_borders(tmp_path, inspection):
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    for wrong, views in ((20.0, {"cam02"}), (0.0, set())):
        each, pairs = made_up(path, lambda view, radius, wrong=wrong: 0.3 + (wrong * radius**4 if view == "cam02" else 0 * radius))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Matches, "good_points", lambda self, bad: np.zeros((0, 3)))
            section = calibration.run(inspection(path, Matches(each, {}, pairs, 2)))
        assert views <= set(told(section)) and "cam00" not in told(section)
        assert all("lens" in told(section)[view] and "calibration" in told(section)[view] for view in views)


def test_wrong_matches_near_one_side_are_no_fault_of_a_lens(tmp_path, inspection):
    """A curtain that repeats itself at the edge: errors of whole folds, beside exact matches."""
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    aside = (np.arange(60) % 2 == 0) * np.random.default_rng(1).uniform(8, 10, 60)
    each, pairs = made_up(path, lambda view, radius: 0.3 + (radius > 0.7) * aside)
    keep = (np.arange(60) % 2 == 0) | (np.linspace(0.05, 0.98, 60) < 0.7)
    pairs = [replace(pair, rows=pair.rows[keep], distance=pair.distance[keep]) for pair in pairs]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Matches, "good_points", lambda self, bad: np.zeros((0, 3)))
        assert not told(calibration.run(inspection(path, Matches(each, {}, pairs, 2))))


def test_surely_large_errors_are_told_where_no_camera_can_be_named(tmp_path, inspection):
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    each, pairs = made_up(path, lambda view, radius: 0.3 + 0 * radius)
    found = inspection(path, Matches(each, {}, pairs, 2))
    found.__dict__["judged"] = Judged({"cam00": 1.0, "cam01": 4.3, "cam02": 1.9}, [], ["cam02"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Matches, "good_points", lambda self, bad: np.zeros((0, 3)))
        findings = calibration.run(found).findings
    assert {finding.views: finding.severity for finding in findings} == {("cam02",): "note", ("cam01",): "poor"}


def test_a_clock_is_not_judged_by_a_wrong_pose(tmp_path):
    capture = open_capture(write_uneven(tmp_path, 24, 4, {"cam01": 1.6}, zoom=3), offsets={})
    for wrong in ([], ["cam01"]):
        found = Inspection(capture)
        found.__dict__["judged"] = Judged(dict.fromkeys(capture.views, 0.4), wrong)
        section = timing.run(found)
        assert section.measures["unknown"] == wrong
        assert [finding.severity for finding in section.findings if "cam01" in finding.views] == (["note"] if wrong else ["wrong"])


def test_another_white_balance_is_named_by_its_channel(tmp_path, inspection):
    yellow = {1: lambda image, frame: image * (1, 1, 0.78)}
    path = write_room(tmp_path / "made", 3, 2, spread=0.0, change=yellow, detail=1)
    each, pairs = made_up(path, lambda view, radius: 0 * radius)
    found = inspection(path)
    found.__dict__["matches"] = Matches(each, {(0, view): found.samples[view][0] for view in VIEWS}, pairs, 2)
    section = exposure.run(found)
    (sentence,) = {finding.sentence for finding in section.findings}
    assert sentence.startswith("cam01 (blue x 0.85)") and "white balance" in sentence and set(told(section)) == {"cam01"}
    assert np.array(section.measures["channels"]["cam01"]) == pytest.approx([1, 1, 0.78], abs=0.02)


@pytest.mark.parametrize(("free", "most", "memory", "words"), [
    (1e12, "", 1e12, ""), (1e6, "", 1e12, "The cache of decoded pictures needs"), (1e12, "0.0001", 1e12, "All decoded pictures need"),
    (1e12, "", 1e6, "Training with the preset standard takes about"), (None, "", None, "")])
def test_too_little_disk_and_memory_are_told_before(tmp_path, monkeypatch, inspection, free, most, memory, words):
    monkeypatch.setenv("FASTGS_CACHE_GB", most)
    path = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)

    def free_bytes(folder):
        if free is None:
            raise OSError("the drive is gone")
        return free

    monkeypatch.setattr(cost.checks, "free_bytes", free_bytes)
    monkeypatch.setattr(cost.checks, "available_memory", lambda: memory)
    section = cost.run(inspection(path))
    assert [finding.sentence[:len(words)] for finding in section.findings] == ([words] if words else [])
    assert section.measures["cache_gb"] == pytest.approx(3 * 2 * 320 * 240 * 3 / 1e9, abs=6e-5)
    assert set(section.measures["presets"]) == {"draft", "standard", "final"} and "Cache: 0.00 GB" in section.summary
    monkeypatch.setattr(cost.costs, "DRAFT_PIXELS", 160 * 120)  # a draft takes large pictures smaller, unless a scale is asked for
    smaller, kept = cost.run(inspection(path)), cost.run(replace(inspection(path), scaled=True))
    assert smaller.measures["presets"]["draft"]["scale"] == 0.5 and "scale" not in smaller.measures["presets"]["standard"]
    assert "50%" in smaller.summary and "scale" not in kept.measures["presets"]["draft"]
