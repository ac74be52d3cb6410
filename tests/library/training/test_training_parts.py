# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of training that need no picture: settings, starting model, schedule, checkpoints."""
import errno
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.captures.pixels.store import Pixels
from fastgs_blender.commands.train import FLAGS
from fastgs_blender.training.core import density, schedule, targets
from fastgs_blender.training.core import model as starting
from fastgs_blender.training.core import settings as options
from fastgs_blender.training.core.moving_pixels import MovingPixels
from fastgs_blender.training.core.presets import PRESETS, SCENES
from fastgs_blender.training.initial.first_model import depth_of, model_from_points
from fastgs_blender.training.initial.neighbours import neighbour_distance
from fastgs_blender.training.run import checkpoint
from fastgs_blender.training.run.files import CHECKPOINT
from fastgs_blender.util.backends import load_backend


def test_settings_survive_json():
    chosen = options.settings("draft", order=7, warm_up=(0.1,), motion="fourier")
    assert options.from_dict(json.loads(json.dumps(chosen.to_dict()))) == chosen
    assert chosen.iterations < options.settings().iterations < options.settings("final").iterations


@pytest.mark.parametrize("wrong", [
    {"motion": "wavelets"}, {"iterations": 0}, {"iterations": 2.5}, {"wings": 2}, {"batch": True}, {"dssim": float("nan")}, {"dssim": 2},
    {"warm_up": (0.5, 0.1)}, {"warm_up": 3}, {"preset": "best"}, {"decoder_place": 1},
])
def test_settings_that_mean_nothing_are_told(wrong):
    with pytest.raises(fg.FastGSError):
        options.from_dict(wrong)


def test_published_setups():
    """--preset paper is the paper where it says something, and Spacetime Gaussians where it is silent."""
    paper, stg = options.settings("paper"), options.settings("stg")
    assert (paper.motion, paper.order, paper.motion_weight, paper.regulariser, paper.loss) == ("paper", 5, 0.1, "printed", "sum")
    assert (stg.motion, stg.order, stg.motion_weight, stg.loss, stg.dssim) == ("polynomial", 3, 0, "mixed", 0.2)
    differ = {name for name, value in paper.to_dict().items() if stg.to_dict()[name] != value}
    assert differ == {"preset", "motion", "order", "motion_weight", "regulariser", "loss"}
    first, last = (schedule.learning_rates(stg, i, 2.0, 12.0, fg.Polynomial(3)) for i in (0, stg.iterations))
    assert [rates["position"] for rates in (first, last)] == pytest.approx([2 * 1.6e-4, 2 * 1.6e-4 * 0.01 ** (25 / 30)]), "in extents"
    assert first["motion"] == pytest.approx(2 * 2.8e-4) and last["motion"] == pytest.approx(first["motion"])
    assert first["scale"] == last["scale"] == 1.5e-3 and set(first["w1"]) == {1e-4}


@pytest.mark.parametrize(("data_set", "scene", "steps", "scaling_lr", "last"), [
    ("n3v", "cook_spinach", 25_000, 0.0015, 9000), ("n3v", "coffee_martini", 10_000, 0.003, 9000),
    ("n3v", "flame_salmon", 12_000, 0.003, 9000), ("technicolor", "Fabien", 25_000, 0.005, 9000),
    ("immersive", "02_Flames", 20_000, 0.001, 12_000)])
def test_published_scenes_are_trained_as_published(data_set, scene, steps, scaling_lr, last):
    """Transcribed from STG's configs/*_full/<scene>.json, commit 427abfc: test_iteration, scaling_lr, densify_until_iter; densification
    from step 500 (arguments/__init__.py, densify_from_iter); and get_expon_lr_func of 30 000 steps (position_lr_max_steps)."""
    chosen = options.settings("stg", **SCENES[data_set].get(scene, {}))
    assert (chosen.iterations, chosen.scale_rate) == (steps, scaling_lr)
    for step in (0, 5000, steps):
        rate = schedule.learning_rates(chosen, step, 1.0, 12.0, fg.Polynomial(3))["position"]
        assert rate == pytest.approx(np.exp(np.log(1.6e-4) * (1 - step / 30_000) + np.log(1.6e-6) * step / 30_000))
    control = density.Default(chosen, 1.0, starting.empty_model(chosen, fg.Clip(50), "RDF"), np.zeros((1, 3)))
    assert (control.first, control.last) == (500, last)


def test_every_option_is_told():
    """A preset sets it, a flag does, or the page on training names it."""
    page = (Path(__file__).parents[3] / "docs" / "training.md").read_text("utf-8")
    known = {"preset", "init_model", *FLAGS, *(name for preset in PRESETS.values() for name in preset)}
    assert [name for name in options.settings().to_dict() if name not in known and not re.search(rf"\b{name}\b", page)] == []


def test_the_printed_loss_is_a_sum():
    """L1 + (1 - SSIM) is twice the mixture with d = 1/2."""
    mixed, printed = options.settings(dssim=0.3), options.settings(dssim=0.3, loss="sum")
    for chosen, (l1, dissimilar) in ((mixed, (0.7, 0.3)), (printed, (1.0, 1.0))):
        d = chosen.dissimilarity
        assert (chosen.loss_scale * (1 - d), chosen.loss_scale * d) == pytest.approx((l1, dissimilar))


def test_gaussians_are_added_so_often_and_no_more():
    chosen = options.settings("stg", max_gaussians=1000)
    strategy = density.Default(chosen, 1.0, None)
    rooms = [i for i in range(1, chosen.iterations + 1) if strategy.due(i) and strategy._room(i, 100)]
    assert rooms == [600, 700, 800, 900, 1000, 1100] and strategy.due(9000) and not strategy.due(9100)


@pytest.mark.parametrize(("text", "value"), [
    ("iterations=3e3", ("iterations", 3000)), ("dssim = 0.5", ("dssim", 0.5)), ("warm_up=", ("warm_up", ())), ("warm_up=0.1,0.2",
     ("warm_up", (0.1, 0.2))), ("decoder_place=yes", ("decoder_place", True)), ("density=mcmc", ("density", "mcmc")),
])
def test_options_as_text(text, value):
    assert options.option_from_text(text) == value


@pytest.mark.parametrize("text", ["iterations", "wings=2", "iterations=many", "decoder_place=perhaps", "iterations=1e400"])
def test_option_texts_that_mean_nothing_are_told(text):
    with pytest.raises(fg.FastGSError):
        options.option_from_text(text)


@pytest.mark.parametrize(("motion", "terms"), [("cosine", 10), ("fourier", 10), ("fourier+linear", 11), ("paper", 10), ("polynomial", 3),
                                               ("keyframes", 11), ("static", 0)])
def test_usual_orders_have_about_as_many_coefficients(motion, terms):
    assert starting.motion_basis(motion, 0, fg.Clip(40)).terms == terms


def test_short_clips_get_lower_orders_but_for_the_printed_form():
    for motion in ("cosine", "fourier", "fourier+linear", "keyframes", "polynomial"):
        assert starting.motion_basis(motion, 0, fg.Clip(10)).terms <= 4
        assert starting.motion_basis(motion, 6, fg.Clip(10)).terms >= 6
    assert starting.motion_basis("paper", 0, fg.Clip(10)) == fg.Fourier(5, 1.0, 0.0)
    assert starting.motion_basis("cosine", 0, fg.Clip(1)) == fg.Static()


def test_cosines_span_the_clip():
    basis = starting.motion_basis("cosine", 3, fg.Clip(20))
    np.testing.assert_allclose(basis.weights(np.array([0, 19 / 20])), [[1, 1, 1], [-1, 1, -1]], atol=1e-12)


@pytest.mark.parametrize("count", [2, 5, 90, 1500])
def test_neighbour_distance(rng, count):
    xyz = rng.normal(size=(count, 3))
    squared = np.sort(((xyz[:, None] - xyz[None]) ** 2).sum(-1), 1)[:, 1:4]
    found, exact = neighbour_distance(xyz), np.sqrt(squared.mean(1))
    assert (found >= exact * (1 - 1e-6)).all()
    assert np.mean(found / exact) < 1.03


def test_one_point_has_no_neighbour():
    assert neighbour_distance(np.zeros((1, 3)))[0] == np.inf


@pytest.mark.parametrize("appearance", ["features", "rgb", "sh2"])
def test_the_first_model_shows_the_points(rng, appearance):
    points = Points(rng.uniform(-1, 1, (300, 3)), rng.uniform(0.1, 0.9, (300, 3)), np.where(np.arange(300) < 200, np.nan, 0.25),
                    np.where(np.arange(300) < 190, np.nan, 0.5))
    chosen = options.settings(appearance=appearance, init_opacity=0.5, init_scale=0.8, init_duration=0.1)
    model = model_from_points(points, chosen, fg.Clip(20, 25.0, 3), "RUB", 20.0)
    assert model.axes == "RUB" and model.clip == fg.Clip(20, 25.0, 3) and len(model) == 300
    early, at = fg.slice_model(model, 0.0, cull=False), fg.slice_model(model, 0.25, cull=False)
    np.testing.assert_allclose(at.position, points.xyz, atol=1e-6)
    np.testing.assert_allclose(at.opacity[200:], 0.5, atol=1e-5)
    assert early.opacity[:200].min() > 0.48 and early.opacity[200:].max() < 0.5 * np.exp(-0.9)
    np.testing.assert_allclose(np.exp(model.scale[:190, 0]), 0.8 * neighbour_distance(points.xyz[:200])[:190], rtol=1e-4)
    np.testing.assert_allclose(np.exp(model.scale[190:]), 0.5, rtol=1e-4)


def test_every_shot_is_seen_equally_often_and_a_step_shows_one_moment():
    shots = [SimpleNamespace(frame=f, place=False) for f in range(7) for _ in range(5)]
    views = schedule.Views(shots, 3)
    seen = np.zeros(len(shots), int)
    for i in range(35):
        chosen = views.at(i, 2)
        assert len({shots[j].frame for j in chosen}) == 1 and len(set(chosen)) == 2
        seen[chosen] += 1
    assert seen.min() == seen.max() == 2
    assert views.at(11, 2) == schedule.Views(shots, 3).at(11, 2)
    assert any(views.at(i, 2) != schedule.Views(shots, 4).at(i, 2) for i in range(5))


def test_a_single_moving_camera_helps_out_from_other_moments():
    views = schedule.Views([SimpleNamespace(frame=f, place=False) for f in range(6)], 0)
    seen = np.bincount(np.concatenate([views.at(i, 3) for i in range(4)]), minlength=6)
    assert (seen == 2).all()


def test_more_views_than_the_capture_has():
    assert len(schedule.Views([SimpleNamespace(frame=0, place=False)] * 3, 0).at(4, 8)) == 8


@pytest.mark.parametrize("has_alpha", [False, True])
def test_mask_files_weigh_and_alpha_cuts(rng, has_alpha):
    """A mask file says where the subject is, the picture's own alpha what there is at all."""
    rgb, subject, alpha = rng.uniform(size=(4, 6, 3)).astype(np.float32), np.eye(4, 6, dtype=np.float32), np.tri(4, 6, dtype=np.float32)
    pixels = Pixels(rgb, subject * alpha, alpha=alpha) if has_alpha else Pixels(rgb, subject)
    capture = SimpleNamespace(mask_means="foreground")
    shot = SimpleNamespace(mask="file", place=False, camera=fg.Camera(6, 4, 5.0, 5.0, 3.0, 2.0, np.eye(4)), t=0.0)
    found = targets.target(capture, pixels, shot, options.settings(background="white"), 1)
    np.testing.assert_allclose(found.weight, 1 + pixels.mask)
    np.testing.assert_allclose(found.rgb, rgb * alpha[..., None] + 1 - alpha[..., None] if has_alpha else rgb, atol=1e-6)
    assert found.opaque == (not has_alpha) and (found.background == 1).all()


@pytest.mark.parametrize("why", ["", "the camera moves", "there are masks", "too few frames"])
def test_what_moves_weighs_more(why, rng):
    """A square walks over a wall with a little noise; without masks, and where the camera stands still, its pixels count more."""
    count = 3 if why == "too few frames" else 8
    films = np.tile(rng.uniform(0.2, 0.5, (24, 32, 3)).astype(np.float32), (count, 1, 1, 1)) + rng.uniform(0, 0.01, (count, 24, 32, 3))
    for k in range(count):
        films[k, 8:12, 3 * k:3 * k + 3] = 0.9
    shots = []
    for k in range(count):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * k * (why == "the camera moves")
        shots.append(SimpleNamespace(view="a", place=False, mask="file" if why == "there are masks" else None, t=k / 8, number=k,
                                     camera=fg.Camera(32, 24, 20.0, 20.0, 16.0, 12.0, pose)))
    store = SimpleNamespace(pixels=lambda shot: Pixels(films[shot.number].astype(np.float32)))
    chosen = options.settings(moving_weight=3.0)
    pixels = store.pixels(shots[1])
    share = MovingPixels(store, shots).share(shots[1], pixels)
    found = targets.target(SimpleNamespace(mask_means="foreground"), pixels, shots[1], chosen, 1, moving=share).weight
    if why:
        assert found is None
        return
    expected = np.ones((24, 32))
    expected[8:12, 3:6] = 3.0
    np.testing.assert_array_equal(found, expected)
    half = targets.target(SimpleNamespace(mask_means="foreground"), pixels, shots[1], chosen, 2, moving=share).weight
    assert half.shape == (12, 16) and half.mean() == pytest.approx(expected.mean())


def test_rates_fall_and_divide_by_the_frequency():
    chosen = options.settings(cool_down=0.0)
    first, last = (schedule.learning_rates(chosen, i, 2.0, 2.0, fg.Fourier(2, linear=True)) for i in (0, chosen.iterations))
    assert first["position"] == pytest.approx(2 * chosen.position_rate) and last["position"] == pytest.approx(2 * chosen.position_rate_end)
    far = [schedule.learning_rates(chosen, i, 2.0, 12.0, fg.Fourier(2, linear=True))["position"] for i in (0, chosen.iterations)]
    assert far == pytest.approx([12 * chosen.position_rate, 2 * chosen.position_rate_end]), "far things begin with longer steps"
    np.testing.assert_allclose(first["motion"] / first["motion"][0], np.repeat([1, 1, 0.5, 0.5, 1], 3))
    assert last["motion"][0] == pytest.approx(chosen.motion_decay * first["motion"][0])
    for name in set(first) - {"position", "motion"}:
        np.testing.assert_allclose(last[name], chosen.rate_decay * np.asarray(first[name]), err_msg=name)


def test_floors_of_slopes_know_no_unit_of_length_and_no_size_of_pictures(make_model, rng):
    """A disc before a wall that is half white: its slope stands for as many floors in finer pictures, and where all is ten times larger."""
    backend = load_backend("cpu")
    found = []
    for finer, larger in ((1, 1.0), (3, 1.0), (1, 10.0)):
        camera = fg.Camera(48 * finer, 32 * finer, 40.0 * finer, 40.0 * finer, 24.0 * finer, 16.0 * finer, np.eye(4))
        model = make_model(rng, 1, appearance="rgb")
        values = {name: np.zeros_like(array, np.float32) for name, array in model.arrays.items()}
        values |= {"position": np.float32([[0, 0, 4 * larger]]), "scale": np.full((1, 3), np.log(0.4 * larger), np.float32),
                   "rotation": np.float32([[1, 0, 0, 0]]), "features": np.ones((1, 3), np.float32)}
        wall = np.zeros((32 * finer, 48 * finer, 3), np.float32)
        wall[:, :24 * finer] = 1
        picture = backend.forward(values, model, camera, 0.0)
        loss = backend.compare(picture, wall, None, None, 0.0, 0.0, 1.0)
        slope = backend.backward(picture, loss.rgb, loss.alpha)["position"][0, 0]
        found.append(slope / schedule.slope_floors(options.settings(), camera.fx / camera.width, 4 * larger)["position"])
    assert found == pytest.approx(found[:1] * 3, rel=0.02) and found[0] > 100


def test_a_model_is_refined_with_shorter_steps():
    """Where training begins with a model its places and motions move less, its shapes a little less, and colours as ever."""
    chosen = options.settings(warm_start_rate=0.04)
    usual, refined = (schedule.learning_rates(chosen, 100, 2.0, 2.0, fg.Fourier(2), known) for known in (False, True))
    for names, factor in ((("position", "motion"), 0.04), (("scale", "rotation", "rotation_motion"), 0.2), (("opacity", "features"), 1.0)):
        for name in names:
            np.testing.assert_allclose(refined[name], factor * np.asarray(usual[name]), err_msg=name)


def test_all_rates_fall_to_nothing_in_the_last_part_of_a_run():
    with_rest, without = options.settings(cool_down=0.2), options.settings(cool_down=0.0)
    for share, rest in ((0.0, 1.0), (0.8, 1.0), (0.9, 0.5), (0.98, 0.1)):
        step = round(share * with_rest.iterations)
        found, usual = (schedule.learning_rates(chosen, step, 2.0, 2.0, fg.Fourier(2)) for chosen in (with_rest, without))
        assert found.keys() == usual.keys()
        for name in usual:
            np.testing.assert_allclose(found[name], rest * np.asarray(usual[name]), err_msg=name)


@pytest.mark.parametrize(("distance", "reach"), [(9.0, 9.0), (0.5, 2.2)])
def test_the_reach_is_how_far_away_the_scene_is(distance, reach, rng):
    """Two cameras 4 apart look along +z at a wall; the backdrop behind it does not count."""
    poses = [np.eye(4), np.eye(4)]
    for pose, x in zip(poses, (-2.0, 2.0), strict=True):
        pose[0, 3] = -x
    shots = [SimpleNamespace(camera=fg.Camera(60, 40, 20.0, 20.0, 30.0, 20.0, pose)) for pose in poses]
    wall = np.concatenate([rng.uniform(-3, 3, (500, 2)), np.full((500, 1), distance)], 1)
    behind = wall * (1, 1, 0) + (0, 0, 500)
    points = Points(np.concatenate([wall, behind]), np.zeros((1000, 3)), size=np.repeat([np.nan, 30.0], 500))
    assert depth_of(points, SimpleNamespace(training=shots, extent=2.2)) == pytest.approx(reach)


def test_a_checkpoint_comes_back(rng, tmp_path):
    arrays = {"a.b": rng.normal(size=(3, 2)).astype(np.float32), "c": np.arange(4, dtype=np.int64)}
    assert checkpoint.load(tmp_path) is None
    checkpoint.save(tmp_path, arrays, {"iteration": 7})
    back, about = checkpoint.load(tmp_path)
    assert about["iteration"] == 7 and back.keys() == arrays.keys()
    assert all(np.array_equal(back[k], v) and back[k].dtype == v.dtype for k, v in arrays.items())


def test_a_full_disk_is_told_and_leaves_the_checkpoint(tmp_path, monkeypatch):
    checkpoint.save(tmp_path, {"a": np.zeros(3)}, {"iteration": 1})
    before = (tmp_path / CHECKPOINT).read_bytes()

    def full(path, tensors, metadata):
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(checkpoint, "write_tensors", full)
    with pytest.raises(fg.FastGSError, match=r"checkpoint.*No space left.*kept"):
        checkpoint.save(tmp_path, {"a": np.ones(3)}, {"iteration": 2})
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [CHECKPOINT]


@pytest.mark.parametrize("content", [b"", b"junk", b"\x08\0\0\0\0\0\0\0{}      "])
def test_a_broken_checkpoint_is_told(tmp_path, content):
    (tmp_path / CHECKPOINT).write_bytes(content)
    with pytest.raises(fg.FastGSError, match="delete it"):
        checkpoint.load(tmp_path)
