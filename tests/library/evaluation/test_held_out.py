# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs eval never calls a picture held out that the model was trained on, in any combination of options."""
from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from toy_captures import toy_capture, toy_scene, write_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.evaluation import metrics
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.evaluation.perceptual import Flip
from fastgs_blender.evaluation.training_record import KEY, recorded, sentence

FRAMES = 4


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path / "cache"))


def model_of(views, scale=1.0, clip=None) -> fg.GaussianModel:
    """A model of the toy scene whose file says that it was trained on these views."""
    model = toy_scene(FRAMES)
    return replace(model, position=model.position + np.float32([0.05, 0, 0]), clip=clip or model.clip,
                   provenance={KEY: json.dumps({"views": list(views), "scale": scale})})


@pytest.fixture
def measure(tmp_path, capsys):
    """measure(model, *options): the result of fastgs eval on a capture whose own choice to hold out is cam00."""
    write_capture(tmp_path / "cap", FRAMES, 3)

    def run(model, *options):
        fg.save(model, tmp_path / "m.safetensors")
        code = cli.main(["eval", str(tmp_path / "m.safetensors"), str(tmp_path / "cap"), "--out", str(tmp_path / "out"), "--quiet",
                         "--json", "--images", "0", *options])
        out, err = capsys.readouterr()
        return json.loads(out) if code == 0 else err

    return run


@pytest.mark.parametrize("trained", [("cam01", "cam02"), ("cam00", "cam02"), ("cam00",)])
def test_the_views_that_were_not_trained_on_are_measured_whatever_the_capture_holds_out(measure, trained):
    result = measure(model_of(trained))
    assert set(result["views"]) == {"cam00", "cam01", "cam02"} - set(trained)
    assert result["held_out"] is True and not any(row["trained_on"] for row in result["rows"])


CHOICES = itertools.product(("--views", "--held-out"), ("all", "cam00", "cam01", "cam01,cam02"), (None, "0:1", "2:3"))
OTHERS = itertools.cycle([(), ("--fit-colours", "on", "--layout", "fastgs"), ("--scale", "0.5"), ("--fit-colours", "off"), ("--no-lpips",)])
"""Options that have no say in what a label is; each choice meets one of them."""


@pytest.mark.slow
@pytest.mark.parametrize(("flag", "views", "frames", "more"), [(*choice, more) for choice, more in zip(CHOICES, OTHERS)])
def test_labels_are_true_in_every_combination(measure, tmp_path, flag, views, frames, more):
    """Trained on cam01 and cam02, on the first two of four frames; with other options, the clock of cam01 is 0.4 frames ahead."""
    clip = fg.Clip(2, 24.0, 1)
    if more:
        fg.write_clocks(tmp_path / "cap", fg.Clocks({"cam01": 0.4}))
    result = measure(model_of(("cam01", "cam02"), clip=clip), flag, views, *(["--frames", frames] if frames else []), *more)
    assert result["rows"]
    for row in result["rows"]:
        assert row["trained_on"] == (row["view"] in ("cam01", "cam02") and row["frame"] < 2)
    seen = sum(row["trained_on"] for row in result["rows"])
    assert result["held_out"] == (seen == 0)
    assert any("were trained on" in note for note in result["notes"]) == (seen > 0)
    assert ("seen" in result) == (0 < seen < len(result["rows"]))
    if "seen" in result:
        assert result["seen"]["frames"] == seen and result["unseen"]["frames"] == len(result["rows"]) - seen


def test_sub_frames_between_the_training_frames_were_not_trained_on(measure):
    result = measure(model_of(("cam00", "cam01", "cam02"), clip=fg.Clip(2, 12.0, 1)), "--views", "cam01")
    assert [row["trained_on"] for row in result["rows"]] == [True, False, True]


def test_what_train_was_told_to_hold_out_is_what_eval_measures(tmp_path, capsys):
    """The case that was reported: train --held-out cam02, then eval measured cam00, the layout's choice, and called it held out."""
    write_capture(tmp_path / "cap", 2, 3)
    few = ["--iterations", "2", "--init", "file", "--set", "preview_every=0", "--quiet"]
    assert cli.main(["train", str(tmp_path / "cap"), "--out", str(tmp_path / "run"), "--held-out", "cam02", "--scale", "0.5", *few]) == 0
    capsys.readouterr()
    assert cli.main(["eval", str(tmp_path / "run"), str(tmp_path / "cap"), "--json", "--quiet", "--images", "0"]) == 0
    result = json.loads(capsys.readouterr()[0])
    assert set(result["views"]) == {"cam02"} and result["held_out"] is True and result["width"] == 24


def test_a_model_trained_on_all_views_has_nothing_held_out(measure):
    assert "trained on all 3 views" in measure(model_of(("cam00", "cam01", "cam02")))


def test_the_size_of_the_pictures_is_that_of_the_training(measure):
    result = measure(model_of(("cam01", "cam02"), scale=0.5))
    assert (result["width"], result["height"]) == (24, 18)
    assert measure(model_of(("cam01", "cam02"), scale=0.5), "--scale", "1")["width"] == 48


@pytest.mark.parametrize("text", ["", "[]", '{"views": "cam00", "scale": 1}', '{"views": [1], "scale": 1}', '{"views": [], "scale": "x"}',
                                  '{"views": ["cam00"], "scale": NaN}', '{"views": ["cam00"], "scale": 7}'])
def test_a_record_that_cannot_be_understood_says_nothing(text):
    assert recorded(replace(toy_scene(1), provenance={KEY: text})) is None


def test_what_is_not_valid_counts_in_no_measure():
    """The same picture, with a border that is no part of the truth: measures are those of the inside."""
    rng = np.random.default_rng(0)
    truth, picture = rng.random((2, 40, 40, 3))
    valid = np.zeros((40, 40), bool)
    valid[:, 10:30] = True
    bare = truth * valid[..., None], picture * valid[..., None]
    other = np.where(valid[..., None], picture, 0.0), np.where(valid[..., None], truth, 0.0)
    assert metrics.dssim2(*other, valid) == pytest.approx(metrics.dssim2(picture[:, 10:30], truth[:, 10:30]), abs=1e-12)
    assert metrics.dssim1(*other, valid) == pytest.approx(metrics.dssim1(picture[:, 10:30], truth[:, 10:30]), abs=1e-12)
    assert metrics.dssim1(*other) < metrics.dssim1(*other, valid), "equal borders make pictures look better"
    assert metrics.temporal_error(*bare, np.zeros_like(truth), np.zeros_like(truth), valid) == pytest.approx(
        np.abs(truth - picture)[valid].mean())
    assert np.isnan(metrics.dssim2(*other, np.zeros((40, 40), bool)))


def test_borders_that_a_lens_leaves_out_count_in_no_measure():
    """What evaluate() says of pictures with invalid borders is what the measures say of the inside alone."""
    capture, store, _ = toy_capture(FRAMES, 3)
    model = model_of(("cam01", "cam02"))
    shot, inside = capture.held_out[0], slice(8, 40)
    truth, picture = store.pictures[shot.view, 0].rgb, fg.render(model, shot.camera, shot.t)["rgb"]
    valid = np.zeros(truth.shape[:2], bool)
    valid[:, inside] = True
    for key, pixels in store.pictures.items():
        store.pictures[key] = replace(pixels, valid=valid)
    found = evaluate(model, capture, store, frames=[0])["average"]
    for name in ("psnr", "dssim1", "dssim2"):
        assert found[name] == pytest.approx(getattr(metrics, name)(picture[:, inside], truth[:, inside]), abs=1e-6), name
    diluted = Flip()(picture * valid[..., None], truth * valid[..., None])
    assert found["flip"] > 1.2 * diluted, "borders that are black in both pictures make the mean better by a third"


def test_a_camera_of_another_white_balance_is_named_with_its_colour():
    found = {"exposures": {"even": {"gain": [1.001, 1.0, 1.002], "bias": [0, 0, 0]}, "dark": {"gain": [0.8, 0.8, 0.8], "bias": [0.05] * 3},
                           "cold": {"gain": [1.1, 1.0, 0.85], "bias": [0, 0, 0]}}}
    assert sentence(found) == "exposures differ, and were evened: cold 0.98 (blue 0.85), dark 0.90"
