# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a run: --resume restores all settings, and a start that fails leaves no file behind."""
from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from toy_captures import toy_capture, write_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.captures import open_capture
from fastgs_blender.training.core import costs
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.run.files import CHECKPOINT, MODEL, RUN
from fastgs_blender.training.run.plan import Source, plan_from_dict, read_plan, suited

SHORT = ["--init", "file", "--quiet", *(text for option in ("iterations=6", "init_points=60", "preview_every=0", "warm_up=") for text in
                                        ("--set", option))]
PART = ["--scale", "0.5", "--frames", "1:3", "--held-out", "cam01,cam03"]


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("toy") / "capture")


@pytest.fixture(scope="module")
def finished(toy, tmp_path_factory):
    """A run of a few steps on a part of the capture."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert cli.main(["train", str(toy), "--out", str(out), *PART, *SHORT]) == 0
    return out


@pytest.fixture
def run(finished, tmp_path):
    """A copy of that run which lacks its model: it is to be finished again."""
    out = tmp_path / "run"
    shutil.copytree(finished, out)
    (out / MODEL).unlink()
    return out


def test_resume_needs_the_folder_alone(run, finished, capsys):
    assert cli.main(["train", "--resume", "--out", str(run), "--quiet"]) == 0
    again = fg.load(run / MODEL)
    assert (run / MODEL).read_bytes() == (finished / MODEL).read_bytes()
    known = json.loads(again.provenance["trained_on"])
    assert known["scale"] == 0.5 and known["views"] == ["cam00", "cam02", "cam04"] and again.clip.frame_count == 3


@pytest.mark.parametrize(("width", "height", "times"), [(48, 36, 1), (1250, 1000, 2), (4000, 3000, 3)])
def test_a_rig_that_films_more_than_a_room_gets_more_gaussians(width, height, times):
    """In proportion to the pixels of one moment of its four training cameras, above 2.5 million and up to three times."""
    capture = toy_capture(frames=2)[0]
    shots = [replace(shot, camera=replace(shot.camera, width=width, height=height)) for shot in capture.shots]
    capture = replace(capture, shots=shots)
    for preset, most, points in (("draft", 20_000, 10_000), ("standard", 50_000, 20_000), ("final", 150_000, 60_000)):
        chosen = suited(settings(preset), capture)
        assert (chosen.max_gaussians, chosen.init_points) == (times * most, times * points)
    named = suited(settings(max_gaussians=70, init_points=60), capture, ("max_gaussians", "init_points"))
    assert (named.max_gaussians, named.init_points) == (70, 60)
    assert suited(settings("stg"), capture) == settings("stg")


@pytest.mark.parametrize(("frames", "steps"), [(100, 7000), (150, 10_500), (161, 7000)])
def test_a_long_segment_gets_more_steps(frames, steps):
    """161 frames are two segments of 85."""
    capture = toy_capture(frames=2)[0]
    capture = replace(capture, clip=replace(capture.clip, frame_count=frames))
    assert suited(settings(), capture).iterations == steps
    assert suited(settings(iterations=50), capture, ("iterations",)).iterations == 50


def test_a_draft_has_less_of_a_floor_under_slopes():
    """In proportion to its steps and Gaussians; longer runs and larger rigs have all of it."""
    capture = toy_capture(frames=2)[0]
    whole = settings().slope_floor
    assert [suited(settings(preset), capture).slope_floor for preset in ("standard", "final")] == [whole] * 2
    assert suited(settings("draft"), capture).slope_floor == pytest.approx(whole / 7)
    assert suited(settings(iterations=3500), capture, ("iterations",)).slope_floor == pytest.approx(whole / 2)
    assert suited(settings("draft", slope_floor=whole), capture, ("slope_floor",)).slope_floor == whole


@pytest.mark.parametrize(("options", "used"), [(["--preset", "draft"], 0.5), (["--preset", "draft", "--scale", "0.75"], 0.75), ([], 1)])
def test_a_draft_uses_large_pictures_at_a_smaller_size(options, used, toy, tmp_path, monkeypatch, capsys):
    """What few Gaussians cannot show costs no time; a scale that is asked for is kept."""
    shot = open_capture(toy).shots[0]
    monkeypatch.setattr(costs, "DRAFT_PIXELS", shot.camera.width * shot.camera.height // 4)
    assert cli.main(["train", str(toy), "--out", str(tmp_path / "run"), *options, *SHORT[:2], *SHORT[3:], "--set", "iterations=2"]) == 0
    assert json.loads(fg.load(tmp_path / "run" / MODEL).provenance["trained_on"])["scale"] == used
    assert ("50%" in capsys.readouterr().err) == (used == 0.5)
    pixels = shot.camera.width * shot.camera.height
    assert costs.trained_pixels("draft", pixels) == pixels // 4 and costs.trained_pixels("standard", pixels) == pixels
    assert costs.trained_pixels("DRAFT", pixels, 1.0) == pixels


@pytest.mark.parametrize(("options", "words"), [
    (["--scale", "1"], "scale = 0.5, not 1.0"), (["--frames", "0:3"], "frames = 1, 4, 1, not 0, 4, 1"),
    (["--held-out", "cam00"], "held_out = cam01, cam03, not cam00"), (["--layout", "colmap"], "layout = its default, not colmap"),
    (["--set", "iterations=7"], "iterations = 6, not 7"), (["--preset", "draft"], "preset = standard, not draft")])
def test_what_contradicts_the_run_is_refused(run, toy, capsys, options, words):
    for capture in ([], [str(toy)]):
        assert cli.main(["train", *capture, "--resume", "--out", str(run), *options]) == 2
        assert words in capsys.readouterr().err
    assert not (run / MODEL).exists()


def test_another_capture_is_refused_unless_the_first_has_moved(run, toy, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(toy, copy)
    assert cli.main(["train", str(copy), "--resume", "--out", str(run)]) == 2
    assert f"trained on {toy}, not on {copy}" in capsys.readouterr().err
    values = json.loads((run / RUN).read_text())
    values["source"]["capture"] = str(tmp_path / "where it was")
    (run / RUN).write_text(json.dumps(values))
    assert cli.main(["train", str(copy), "--resume", "--out", str(run), "--quiet"]) == 0
    assert read_plan(run).source == Source(str(copy), None, 0.5, (1, 4, 1), ("cam01", "cam03"))


def test_a_start_that_fails_does_not_block_the_corrected_one(toy, tmp_path, capsys):
    out = tmp_path / "run"
    missing = ["--init", "model", "--init-model", str(tmp_path / "none.ply")]  # noticed when the capture is open
    for wrong in (["--layout", "nothing"], ["--scale", "7"], ["--held-out", "nobody"], missing):
        assert cli.main(["train", str(toy), "--out", str(out), *SHORT, *wrong]) == 2
        said = capsys.readouterr().err
        assert "Traceback" not in said and "already" not in said
        assert not (out / RUN).exists()
    assert cli.main(["train", str(toy), "--out", str(out), *SHORT]) == 0


def test_a_failed_overwrite_keeps_the_earlier_run(finished, tmp_path, capsys):
    out = tmp_path / "run"
    shutil.copytree(finished, out)
    before = {name: (out / name).read_bytes() for name in (MODEL, CHECKPOINT, RUN)}
    assert cli.main(["train", str(tmp_path / "no capture"), "--out", str(out), "--overwrite"]) == 2
    assert {name: (out / name).read_bytes() for name in before} == before


def test_a_capture_is_named_unless_a_run_knows_it(tmp_path, finished, capsys):
    assert cli.main(["train", "--out", str(tmp_path / "new")]) == 2
    assert "name the CAPTURE" in capsys.readouterr().err
    old = {"settings": read_plan(finished).settings.to_dict()}  # as earlier versions wrote it
    (tmp_path / RUN).write_text(json.dumps(old))
    assert cli.main(["train", "--resume", "--out", str(tmp_path)]) == 2
    assert "name the capture" in capsys.readouterr().err


@pytest.mark.parametrize("source", [3, {"capture": 3}, {"scale": 0}, {"scale": True}, {"frames": [1, 2]}, {"frames": [0, 4, 0]},
                                    {"held_out": "cam01"}, {"held_out": [1]}, {"other": 1}, {"": 1}, {"capture": "a\0b"}])
def test_plans_that_make_no_sense(source):
    with pytest.raises(fg.FastGSError, match="not valid"):
        plan_from_dict({"settings": {}, "source": source}, "run.json")
    assert plan_from_dict({"settings": {}, "source": {"capture": "a", "frames": [0, 4, 1]}}).source == Source("a", frames=(0, 4, 1))


def test_training_from_python_gives_the_model(toy, tmp_path):
    from fastgs_blender.training.run.launch import train

    model = train(toy, tmp_path / "run", scale=0.5, frames=slice(0, 2), init="file", iterations=3, init_points=50, preview_every=0)
    assert model.clip.frame_count == 2 and len(model) < 80
    with pytest.raises(fg.FastGSError, match="already"):
        train(toy, tmp_path / "run")


def test_the_time_of_a_run_follows_this_machine_and_the_work(monkeypatch, capsys, tmp_path):
    """Twice as slow a machine takes twice as long; more cameras take longer before the first step; a measured pace is a real one.  That
    kernels are compiled for it, which takes a minute, is said."""
    from fastgs_blender.kernels import made
    from fastgs_blender.util.threads import thread_count

    pace = 1 / thread_count()
    work = 640 * 480, 2500, 20_000, 300, 12
    assert costs.estimate(*work, 2 * pace)[0] == pytest.approx(2 * costs.estimate(*work, pace)[0])
    assert costs.estimate(*work)[0] == costs.estimate(*work, pace)[0] < costs.estimate(*work[:3], 600, 24)[0]
    monkeypatch.setattr(costs, "MADE", 500)
    assert 0 < costs.measured_pace(24 * 16) < 1e3
    assert made.is_compiled(), "it knows the kernels by their names in the cache"
    capsys.readouterr()
    costs.measured_pace(96 * 64)
    assert "compiling" not in capsys.readouterr().err
    monkeypatch.setattr(made, "folder", lambda: tmp_path)
    costs.measured_pace(96 * 64)
    assert "compiling" in capsys.readouterr().err
