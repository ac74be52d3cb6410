# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that are neither equally exposed nor genlocked: what training finds, takes out and keeps in its checkpoint."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_captures import Pixels, toy_capture
from uneven_captures import uneven_capture

import fastgs_blender as fg
from fastgs_blender.evaluation import halves
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.evaluation.metrics import psnr
from fastgs_blender.evaluation.report import table
from fastgs_blender.evaluation.training_record import corrections, corrections_entry, sentence
from fastgs_blender.kernels.protocol import ForwardPass
from fastgs_blender.training.core.camera_estimates import CameraEstimates
from fastgs_blender.training.core.camera_response import ALIKE_PIXELS, CameraResponse
from fastgs_blender.training.core.measure import measure
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.targets import Target
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.dense import response_of
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.initial.start import expected_clocks
from fastgs_blender.training.run import checkpoint
from fastgs_blender.util.backends import load_backend

FEW = dict(init_points=80, max_gaussians=160, densify_every=10, warm_up=(), init_opacity=0.1, init_scale=1.0, preview_every=0)
VIEWS = ("a", "b", "c")


def trainer(made, **choices):
    capture, store, points = made
    chosen = settings(**{**FEW, **choices})
    return Trainer(capture, store, chosen, Start(model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)))


def train(who):
    while who.iteration < who.settings.iterations:
        who.step()
    return who


def shot(view):
    return SimpleNamespace(view=view, t=0.25)


def goal(rgb):
    return SimpleNamespace(rgb=np.float32(rgb), weight=None, least=None)


def shown(found, view, target, rgb, change=None):
    """What a picture of a view says, where the model shows `rgb`, and `change` more a frame later."""
    alpha = np.ones(rgb.shape[:2], np.float32)
    picture, *sides = (ForwardPass(image, alpha, None, None) for image in (rgb, *(() if change is None else (change / 2, -change / 2))))
    sums = found.measure(load_backend("cpu"), shot(view), picture, target.rgb, target.weight, target.least, None, sides or None)
    return found.accumulate([(shot(view), sums)])


def response(expected=None, **choices):
    return CameraResponse.initial(VIEWS, 10, settings(**choices), offsets=None if expected is None else np.array(expected, float))


def test_gains_and_offsets_are_found_and_taken_out():
    """Pictures that are the model's, but for a gain and an offset: what is found is about these, and the pixels become the model's."""
    rng = np.random.default_rng(0)
    model, found = np.float32(rng.uniform(0.1, 0.6, (24, 32, 3))), response(exposures="on")
    gains, biases = {"a": 1.0, "b": 1.3, "c": 0.8}, {"a": 0.0, "b": 0.02, "c": -0.03}
    filmed = {view: Pixels(model * np.float32(gains[view]) + np.float32(biases[view])) for view in VIEWS}
    for _ in range(30):
        for view in VIEWS:
            pixels = found.pixels(shot(view), filmed[view])
            found.update(**shown(found, view, goal(pixels.rgb), model))
    assert found.colours_differ and not found.clocks_differ
    for k, view in enumerate(VIEWS):
        np.testing.assert_allclose(found.gains[k], gains[view], atol=0.05)
        np.testing.assert_allclose(found.pixels(shot(view), filmed[view]).rgb, model, atol=0.02)
    assert found.facts().keys() == {"exposures"}
    unknown = Pixels(model)
    assert found.pixels(shot("held out"), unknown) is unknown


def test_gains_that_points_told_hold_against_a_model_that_believes_other_ones():
    """The model shows camera b's pictures 10 % too dark, as one does that was trained with wrong gains and sees the direction."""
    rng = np.random.default_rng(4)
    model, told = np.float32(rng.uniform(0.1, 0.6, (24, 32, 3))), np.full((3, 2, 3), 0.01)
    told[:, 0], told[2] = np.log([[1], [1.3], [1]]), 0  # nothing is known of c
    found = CameraResponse.initial(VIEWS, 10, settings(), told)
    assert found.colours_differ and (found.gains[2] == 1).all()
    alone = response(exposures="on")
    for who in (found, alone):
        for _ in range(20):
            for view, gain, drawn in (("a", 1.0, 1.0), ("b", 1.3, 1.1), ("c", 0.8, 1.0)):
                pixels = who.pixels(shot(view), Pixels(model * np.float32(gain)))
                who.update(**shown(who, view, goal(pixels.rgb), model * np.float32(drawn)))
    assert found.gains[1] == pytest.approx(1.3, abs=0.04) and alone.gains[1].max() < 1.22
    assert (found.gains[[0, 2]] == 1).all() and not found.biases[[0, 2]].any(), "the rest stays: a is equal, and c is unsure"
    assert alone.gains[2] == pytest.approx(0.8, abs=0.04)


def test_no_gain_moves_by_what_a_model_believes():
    """A poor model thinks that b is half as bright: points say that it is as bright as the others, to 5 %, or say nothing."""
    model, told = np.float32(np.random.default_rng(4).uniform(0.1, 0.6, (24, 32, 3))), np.zeros((3, 2, 3))
    told[:, 1], told[1, 0] = 0.05, 0.14  # 0.14 +- 0.05 is not surely different from 0
    for known in (told, None):
        found = CameraResponse.initial(VIEWS, 10, settings(), known)
        assert not found.is_due(100, 1000), "nothing is measured that could move nothing"
        for _ in range(20):
            for view, gain in (("a", 1.0), ("b", 0.5), ("c", 1.0)):
                found.update(**shown(found, view, goal(model * np.float32(gain)), model))
        assert (found.gains == 1).all() and not found.biases.any() and not found.colours_differ


def test_even_cameras_stay_as_they_are():
    rng = np.random.default_rng(1)
    model, found = np.float32(rng.uniform(0.1, 0.6, (24, 32, 3))), response()
    for view in VIEWS:
        noisy = model + np.float32(rng.normal(0, 0.02, model.shape))
        found.update(**shown(found, view, goal(noisy), model))
    pixels = Pixels(model)
    assert not found.colours_differ and found.pixels(shot("b"), pixels) is pixels and found.facts() == {}
    assert found.moment(shot("b")) == 0.25


def test_overexposed_pixels_are_lower_bounds_in_pictures_that_are_darkened():
    """A model that is brighter there is right, one that is darker is not; exposures and clocks are not told by such pixels."""
    found = response(exposures="on")
    found.gains[1] = 1.25
    rgb = np.full((4, 4, 3), 0.5, np.float32)
    rgb[0, 0, 1] = 1.0
    seen = found.pixels(shot("b"), Pixels(rgb))
    assert seen.least.sum() == 1 and seen.least[0, 0, 1] and found.pixels(shot("a"), Pixels(rgb)).least is None
    target = Target(None, 0.0, seen.rgb, None, None, None, True, seen.least)
    ones = np.ones((4, 4), np.float32)
    for drawn, wanted in ((0.9, 0), (0.3, -1)):
        picture = ForwardPass(np.full_like(rgb, drawn), ones, None, None)
        slope = load_backend("cpu").compare(picture, target.rgb, None, None, 0.0, 0.0, 1.0, target.least).rgb
        assert np.sign(slope[0, 0, 1]) == wanted and (np.sign(slope[1:]) == np.sign(drawn - 0.4)).all()
    wild = np.full_like(rgb, 0.4)
    sums = []
    for colour in (0.8, 0.9):
        wild[0, 0, 1] = colour
        sums.append(shown(found, "b", target, wild, wild)["colour_sums"])
    assert np.array_equal(*sums)


def test_a_clock_is_found_along_the_models_change():
    rng = np.random.default_rng(2)
    model, change = (np.float32(rng.uniform(low, 0.6, (24, 32, 3))) for low in (0.1, -0.6))
    found, late = response([[0, 0.1], [0.32, 0.1], [0.02, 0.1]], exposures="off"), {"a": 0.0, "b": 0.4, "c": 0.0}
    for _ in range(40):
        for view in VIEWS:
            drawn = model + change * np.float32(found.offsets[VIEWS.index(view)] if found.clocks_differ else 0)
            target = goal(model + change * np.float32(late[view]) + np.float32(rng.normal(0, 0.01, model.shape)))
            found.update(**shown(found, view, target, drawn, change))
    assert found.offsets == pytest.approx([0, 0.4, 0], abs=0.02) and (found.offsets[[0, 2]] == 0).all() and found.uncertainty().max() < 0.02
    assert found.moment(shot("b")) == pytest.approx(0.25 + 0.04, abs=0.002)
    assert found.facts()["clocks"]["b"] == pytest.approx(0.4, abs=0.02)


def test_a_clock_moves_only_as_far_as_evidence_is_unsure():
    """A poor model thinks that a clock is a frame off; two cameras show that it is not, or nothing is known."""
    clock = np.array([(1e3, 0, 10.0, 1e4), (1e3, 1e3, 10.0, 1e4), (1e3, 0, 10.0, 1e4)])
    for expected in ([[0, 0.05]] * 3, None):
        found = response(expected)
        for _ in range(20):
            found.update(np.zeros((3, 3, 5)), clock)
        assert not found.offsets.any() and not found.clocks_differ
    assert not response([[0, 0.1], [0.29, 0.1], [0, 0.1]]).offsets.any(), "0.29 +- 0.1 is not surely different from 0"
    told = response([[0, 0.05], [0.8, 0.05], [0, 0.05]])
    assert told.offsets == pytest.approx([0, 0.8, 0]) and told.clocks_differ
    for _ in range(20):
        told.update(np.zeros((3, 3, 5)), clock * [1, 1.5, 1, 1])
    assert told.offsets == pytest.approx([0, 0.9, 0]), "the model may say more, within two standard deviations"
    told = response([[0, 0.05], [0.8, 0.05], [0, 0.05]])
    assert np.isinf(response().uncertainty()).all() and told.uncertainty() == pytest.approx(0.05)
    free = response(clocks="on")
    for _ in range(20):
        free.update(np.zeros((3, 3, 5)), clock)
    assert free.offsets[1] > 0.3


def test_only_clocks_that_may_move_cost_further_renders():
    estimates = CameraEstimates(response([[0, 0.1], [0.4, 0.1], [0, 0.1]], exposures="off"), SimpleNamespace(is_due=lambda *_: False), 1000)
    picture = ForwardPass(np.full((8, 8, 3), 0.5, np.float32), np.ones((8, 8), np.float32), None, None)
    views = [SimpleNamespace(shot=shot(view), target=Target(None, 0.25, picture.rgb, None, None, None, True), picture=picture,
                             rgb=picture.rgb, weight=None, least=None) for view in VIEWS]
    drawn = []
    sums = estimates.measure(load_backend("cpu"), 300, views, lambda view, later: drawn.append((view.shot.view, later)) or picture)
    assert len(sums) == 3 and drawn == [("b", 0.025), ("b", -0.025)]


def test_evidence_of_two_cameras_comes_from_their_pictures_alone():
    capture, store, _ = uneven_capture(24, 5, {"cam02": 0.6}, zoom=3)
    views = tuple(dict.fromkeys(shot.view for shot in capture.training))
    expected = expected_clocks(capture, store, settings())
    assert expected.shape == (4, 2) and views[1] == "cam02" and ((expected[:, 1] > 0) & (expected[:, 1] < 0.1)).all()
    assert (np.abs(expected[:, 0] - [0, 0.6, 0, 0]) < 3 * expected[:, 1]).all()
    assert expected_clocks(capture, store, settings(clocks="off")) is None
    placed = replace(capture, shots=[replace(s, t=s.t + (0.6 / 24 if s.view == "cam02" else 0)) for s in capture.shots])
    against = expected_clocks(placed, store, settings())
    assert (np.abs(against[:, 0]) < 3 * against[:, 1]).all(), "against the times that shots state"
    heard = []
    far, filmed, _ = uneven_capture(30, 5, {"cam02": 3.0}, zoom=3)
    expected_clocks(far, filmed, settings(), heard.append)
    assert len(heard) == 1 and "cam02 +3" in heard[0] and "sync" in heard[0]


@pytest.mark.parametrize(("seems", "apart", "taken"), [
    ((-0.05, 0.2, -0.06, -0.07, 0.02, 0.03), (), "one"),  # a whole side of the rig seems late, because the model half believes one clock
    ((0.01, 0.09, -0.01, 0.0, 0.0, 0.0), (), "one"),  # at first little of a clock is seen, as the model believes the rest
    ((-0.4, 0.35, -0.2, -0.1, 0.02, 0.3), (), "all"),  # free cameras
    ((-0.05, 0.08, -0.06, -0.07, 0.02, 0.03), (0, 1, 2, 3, 4), "all")])  # they were already placed at their own moments
def test_cameras_that_run_together_keep_equal_clocks(seems, apart, taken):
    found = CameraResponse.initial(tuple("abcdef"), 10, settings(clocks="on"))
    found.independent = np.isin(np.arange(6), apart)
    clock = np.array([(1e4, 1e4 * late, 0.01, 1e5) for late in seems])
    found.update(np.zeros((6, 3, 5)), clock)
    assert (found.offsets != 0).tolist() == [taken == "all" or k == 1 for k in range(6)]
    assert found.offsets[1] > 0.1


def test_where_nothing_moves_no_clock_is_found():
    found = response()
    rgb = np.full((8, 8, 3), 0.5, np.float32)
    found.update(**shown(found, "b", goal(rgb), rgb, np.zeros_like(rgb)))
    assert not found.offsets.any() and np.isinf(found.uncertainty()).all() and ALIKE_PIXELS > 1


@pytest.fixture(scope="module")
def uneven():
    """A short run on cameras that differ, and the same run without corrections."""
    made = uneven_capture(6, 5, {"cam02": 0.4}, {"cam01": 1.25, "cam02": 0.75, "cam04": 1.1}, terms=2)
    return [train(trainer(made, iterations=400, **options)) for options in ({"exposures": "on", "clocks": "on"},
                                                                            {"exposures": "off", "clocks": "off"})]


def test_each_picture_is_read_once_for_its_step():
    """The pixels as they were filmed tell what moves; the same ones are corrected."""
    capture, store, points = uneven_capture(6, 5, {}, {"cam01": 1.25}, terms=2)
    read = []
    counted = SimpleNamespace(pixels=lambda shot: read.append(shot) or store.pixels(shot))
    who = trainer((capture, counted, points), iterations=100, exposures="on", moving_weight=3.0)
    for shot in who.shots:
        assert who.moving.share(shot, store.pixels(shot)).max() == 1  # each camera's median picture is known now
    read.clear()
    for _ in range(10):
        who.step()
    assert len(read) == 11, "one of each step, and that of the next one"


@pytest.mark.slow
def test_correction_makes_the_held_out_view_better(uneven):
    with_it, without = uneven
    shots = with_it.capture.held_out
    fitted = [np.mean([psnr(halves.fitted(picture, truth), truth) for picture, truth in who.measure(shots)[2]])
              for who in uneven]
    assert fitted[0] > fitted[1] + 0.5
    grey = 0.5 * with_it.cameras.response.gains[:, 1] + with_it.cameras.response.biases[:, 1]
    assert grey == pytest.approx(0.5 * np.array([1.25, 0.75, 1, 1.1]) / 1.05, abs=0.04)
    assert np.argmax(with_it.cameras.response.offsets) == 1
    model = with_it.final_model({})
    assert corrections(model)["exposures"].keys() == {"cam01", "cam02", "cam03", "cam04"} and "cam02" in sentence(corrections(model))
    assert corrections(without.final_model({})) == {}


def test_evaluation_fits_colours_of_such_a_model_and_says_so(uneven):
    with_it, without = uneven
    capture, store = with_it.capture, with_it.store
    result = evaluate(with_it.final_model({}), capture, store, lpips=False)
    assert result["fit_colours"] and halves.NOTE in result["notes"]
    pictures = measure(with_it.final_model({}), capture, store, with_it.settings, capture.held_out, fit_colours=True)
    assert result["average"]["psnr"] == pytest.approx(pictures[0], abs=0.01)
    plain = evaluate(without.final_model({}), capture, store, lpips=False)
    assert not plain["fit_colours"] and plain["average"]["psnr_right"] is None


def test_right_halves_are_measured_after_a_fit_on_left_ones(uneven):
    with_it, _ = uneven
    model, right = with_it.final_model({}), []
    result = evaluate(model, with_it.capture, with_it.store, lpips=False)
    for shot in with_it.capture.held_out:
        picture, truth = fg.render(model, shot.camera, shot.t)["rgb"], with_it.store.pixels(shot).rgb
        half = truth.shape[1] // 2
        right.append(psnr(halves.fitted(picture, truth)[:, half:], truth[:, half:]))
    assert result["average"]["psnr_right"] == pytest.approx(np.mean(right), abs=1e-3) != result["average"]["psnr"]
    assert "right half" in table(result)


def test_each_half_is_judged_by_a_fit_on_the_other_one():
    truth = np.random.default_rng(3).random((20, 31, 3))
    picture = (truth - 0.1) / 1.4
    assert psnr(halves.fitted(picture, truth), truth) > 50 > psnr(picture, truth)
    for own, other in ((np.s_[:, :15], np.s_[:, 15:]), (np.s_[:, 15:], np.s_[:, :15])):
        wrong = picture.copy()
        wrong[own] = truth[own] * 0.5 + 0.3
        found = halves.fitted(wrong, truth)
        np.testing.assert_allclose(found[own], 1.4 * wrong[own] + 0.1, atol=0.01)  # not by its own pixels
        np.testing.assert_allclose(found[other], 2 * picture[other] - 0.6, atol=0.02)
    counts = np.zeros((20, 31))
    assert np.array_equal(halves.fitted(picture, truth, counts), picture)
    counts[:, :15] = 1
    found = halves.fitted(picture, truth, counts)
    assert np.array_equal(found[:, :15], picture[:, :15]) and psnr(found[:, 15:], truth[:, 15:]) > 50


def test_a_clipped_lamp_stays_white_in_a_darker_exposure():
    truth = 0.6 * np.random.default_rng(3).random((20, 31, 3))
    picture = truth / 0.7
    truth[:3], picture[:3] = 1, 1
    found = halves.fitted(picture, truth)
    assert np.array_equal(found[:3], picture[:3]) and psnr(found, truth) > 50
    brighter = halves.fitted(0.5 * picture, truth)
    np.testing.assert_allclose(brighter[3:], truth[3:], atol=0.01)


def test_what_a_model_shows_wrongly_does_not_bend_the_fit():
    """A third of each half shows something else: plain least squares would find half the gain."""
    truth = np.random.default_rng(3).random((40, 60, 3))
    picture = (truth - 0.05) / 1.2
    for wrong in (np.s_[:, :10], np.s_[:, -10:]):
        picture[wrong] = 0.9 - 0.8 * picture[wrong]
    right = np.s_[:, 10:-10]
    assert psnr(halves.fitted(picture, truth)[right], truth[right]) > 35
    large = [np.repeat(np.repeat(image, 12, 0), 12, 1) for image in (picture, truth)]
    right = np.s_[:, 120:-120]
    assert psnr(halves.fitted(*large)[right], large[1][right]) > 35, "some of many pixels tell as much"


def test_a_restored_run_goes_on_exactly(tmp_path):
    made = uneven_capture(4, 4, {"cam02": 0.4}, {"cam01": 1.3}, terms=2)
    straight = trainer(made, iterations=60, exposures="on", clocks="on")
    for _ in range(25):
        straight.step()
    checkpoint.save(tmp_path, *straight.state())
    train(straight)
    again = Trainer(made[0], made[1], straight.settings)
    again.restore(*checkpoint.load(tmp_path))
    train(again)
    assert again.cameras.response.gains.std() > 0.01 and np.abs(again.cameras.response.clock_sums).max() > 0
    for name, array in straight.state()[0].items():
        assert np.array_equal(array, again.state()[0][name], equal_nan=True), name


@pytest.mark.parametrize("wrong", ["gains", "offsets", "colour_sums"])
def test_damaged_numbers_of_a_checkpoint_are_refused(wrong):
    made = toy_capture(frames=2, views=4)
    who = trainer(made, iterations=20)
    arrays, about = who.state()
    name = f"cameras.{wrong}"
    for array in (np.full_like(arrays[name], np.nan), arrays[name][:-1]):
        with pytest.raises(fg.FastGSError, match="cameras"):
            Trainer(made[0], made[1], who.settings).restore({**arrays, name: array}, about)


def test_records_that_cannot_be_understood_say_nothing():
    model = toy_capture(frames=2, views=3)[0]
    for text in ("[", "[]"):
        assert corrections(SimpleNamespace(provenance={"corrections": text})) == {}
    assert corrections_entry({}) == {} and model is not None and replace(model, notes=[]).notes == []


def test_colours_of_points_tell_gains_before_training():
    capture, _, _ = uneven_capture(2, 5)
    rng = np.random.default_rng(0)
    gains = rng.uniform(0.7, 1.3, (4, 3))
    gains /= np.exp(np.median(np.log(gains), 0))
    points = rng.uniform(0.1, 0.7, (200, 3))
    points[::9] = 2.0  # overexposed in some cameras
    for true in (gains, np.ones((4, 3))):
        looks = [{f"cam{v + 1:02}": point * true[v] * rng.normal(1, 0.05, 3) for v in rng.choice(4, 3, replace=False)} for point in points]
        found = response_of(capture, settings(), looks)
        assert found.views == ("cam01", "cam02", "cam03", "cam04") and found.gains == pytest.approx(true, abs=0.015)
    assert (found.gains == 1).all(), "nearly even cameras are left as they are"
    assert (response_of(capture, settings(), looks[:10]).gains == 1).all(), "a few points tell nothing"
