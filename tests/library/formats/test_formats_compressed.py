# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: errors within their bounds, segments, damage, and what pruning leaves out."""
from __future__ import annotations

import json
from dataclasses import replace

import mutations
import numpy as np
import pytest
from damage import Unchecked
from random_models import BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.formats import columns, compressed, quantising, rate, refit, rounding, sensitivity, thinning
from fastgs_blender.model.filmed_from import BAKED
from fastgs_blender.model.pruning import pruned, scores
from fastgs_blender.util.tensor_files import open_tensors

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
CAMERA = fg.Camera(96, 72, 90.0, 90.0, 48.0, 36.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 6], [0, 0, 0, 1]]))


@pytest.fixture(autouse=True)
def few_small_pictures(monkeypatch):
    monkeypatch.setattr(sensitivity, "WIDTH", 64)
    monkeypatch.setattr(rate, "SHOTS", 10)
    monkeypatch.setattr(rate, "FEW", 1)
    monkeypatch.setattr(rate, "JUDGED", 4)
    monkeypatch.setattr(rate, "SHOWN", 64)
    monkeypatch.setattr(thinning, "SENSED", 6)
    monkeypatch.setattr(thinning, "REFITS", 4)
    monkeypatch.setattr(thinning, "FINAL", 10)


def psnr(a: fg.GaussianModel, b: fg.GaussianModel, t: float) -> float:
    one, two = (np.clip(fg.render(m, CAMERA, t)["rgb"], 0, 1) for m in (a, b))
    return -10 * np.log10(max(np.mean((one - two) ** 2), 1e-12))


@pytest.mark.slow
@pytest.mark.parametrize(("basis", "rotation_basis", "temporal", "appearance"), [
    *((basis, "line", "radial", "rgb") for basis in BASES), ("cubic", "keys", "window", "sh3"), ("static", "static", "always", "sh4"),
    ("paper", "line", "radial-window", "sigmoid"), ("line", "cosine", "always", "changing sh1")])
def test_every_kind_looks_as_before(tmp_path, basis, rotation_basis, temporal, appearance):
    model = random_model(np.random.default_rng(1), 400, basis, rotation_basis, temporal, appearance, extent=2.0,
                         clip=fg.Clip(40, 25.0, 3), axes="RUB", provenance={"from": "a test"})
    fg.save(model, tmp_path / "m.safetensors", compress="fine")
    again = fg.load(tmp_path / "m.safetensors")
    for kind in ("basis", "rotation_basis", "temporal_kind", "clip", "raster", "axes", "colour_space", "provenance"):
        assert getattr(again, kind) == getattr(model, kind)
    assert 0 < len(again) <= len(model)
    for t in (0.1, 0.6):
        assert psnr(model, again, t) > 33, (psnr(model, again, t), t)


def test_a_model_too_small_to_be_seen_is_read_again(tmp_path):
    """No picture shows its numbers, so any step does: the header says one that a reader takes."""
    rng = np.random.default_rng(0)
    model = replace(random_model(rng, 40, "static", "static", "always", "rgb"), position=rng.normal(0, 1e-12, (40, 3)).astype(np.float32),
                    scale=rng.uniform(-31, -29, (40, 3)).astype(np.float32), opacity=np.zeros(40, np.float32))
    for level in ("fine", "small"):
        fg.save(model, tmp_path / "m.safetensors", compress=level)
        assert len(fg.load(tmp_path / "m.safetensors")) <= 40


@pytest.mark.slow
def test_files_lose_what_they_may_and_are_smaller_for_it(tmp_path):
    model = random_model(np.random.default_rng(2), 2000, "paper", "line", "radial", "sh1", extent=2.0, size=0.04)
    judged = sensitivity.shots(model, 4, 1000)  # neither measured on nor searched on
    truth, sizes = sensitivity.pictures(model, judged), []
    for level in (0.28, "fine", 0.02):
        fg.save(model, tmp_path / "m.safetensors", compress=level)
        error = sensitivity.mean_square(truth, sensitivity.pictures(fg.load(tmp_path / "m.safetensors"), judged))
        assert 0.5 < error / rate.Loss.of(level).error(model) < 1.6, level
        sizes.append((tmp_path / "m.safetensors").stat().st_size)
    assert sizes == sorted(sizes) and sizes[0] < model.nbytes / 4.5
    first = (tmp_path / "m.safetensors").read_bytes()
    fg.save(model, tmp_path / "m.safetensors", compress=0.02)
    assert first == (tmp_path / "m.safetensors").read_bytes()


def test_progress_rises_and_may_end_it(tmp_path):
    model, path = random_model(np.random.default_rng(2), 300, "cubic"), tmp_path / "m.safetensors"
    told = []
    fg.save(model, path, compress="fine", progress=told.append)
    assert told == sorted(told) and len(told) > 12 and 0 < told[0] < 0.2 and told[-1] == 1 and len(set(told)) > 12
    before = path.read_bytes()

    def stop(share):
        if share > 0.6:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        fg.save(model, path, compress="small", progress=stop)
    assert path.read_bytes() == before and [file.name for file in tmp_path.iterdir()] == [path.name]


def test_refitting_shows_what_was_left_out():
    """Half of the Gaussians stay, coarsely rounded; refitted, they are nearer to the whole, from places that were not looked at."""
    model = random_model(np.random.default_rng(2), 1500, "cubic", "line", "radial", "sh1", extent=2.0, size=0.06)
    model = quantising.canonical(model)
    found = sensitivity.sensitivity(model, sensitivity.shots(model, 10))
    keep = sensitivity.removal(model, found)
    keep = keep > np.median(keep)
    ready, level = quantising.prepared(model.take(keep), found.take(keep)), -13.0
    judged = sensitivity.shots(model, 4, 1000)
    truth = sensitivity.pictures(model, judged)

    def error(one):
        arrays = refit.as_read(refit.in_parts(one, level, 400), one.model)
        return sensitivity.mean_square(truth, sensitivity.pictures(replace(one.model, **arrays), judged))

    after = refit.refitted(ready, level, 400, model, sensitivity.shots(model, 100, 100), lambda share: None)
    assert error(after) < 0.75 * error(ready), (error(after), error(ready))
    np.testing.assert_allclose(np.linalg.norm(after.model.rotation, axis=1), 1, atol=1e-5)


def test_the_price_is_the_slope_of_the_cost():
    """Moved a little, the numbers of the file, as if they were not whole, cost as much more as their price says."""
    model = quantising.canonical(random_model(np.random.default_rng(2), 60, "cubic", "line", "radial", "rgb", extent=2.0, size=0.06))
    found = sensitivity.sensitivity(model, sensitivity.shots(model, 6))
    parts = refit.in_parts(quantising.prepared(model, found), -12.0, 60)
    (codes, steps), = parts
    own = quantising.step_sizes(codes, steps, quantising.scales(codes, steps))["position"]

    def cost(position):
        return rounding.TAIL / 6 * np.log1p(np.abs(np.diff(position, axis=0, prepend=0) / own)).sum()

    position = np.cumsum(codes["position"] * own, axis=0)
    far = (codes["position"] != 0).all(1) & np.append((codes["position"][1:] != 0).all(1), True)
    assert far.sum() > 30
    for i in np.flatnonzero(far)[:10]:
        moved = position.copy()
        moved[i, 1] += 1e-4 * own[i, 0]
        assert (cost(moved) - cost(position)) / 1e-4 == pytest.approx(refit.price("position", parts)[i, 1], rel=0.02, abs=1e-4)


def test_layers_that_stand_in_for_each_other_are_not_left_out_together(monkeypatch):
    """Of four equal layers each is worth nothing beside the others, and all of them are worth everything."""
    monkeypatch.setattr(thinning, "SHARE", 0.3)
    layer = random_model(np.random.default_rng(2), 120, "static", "static", "always", "rgb", extent=2.0, size=0.15)
    layer = replace(layer, opacity=np.full(120, 3, np.float32))
    model = quantising.canonical(layer.take(np.repeat(np.arange(120), 4)))
    found = sensitivity.sensitivity(model, sensitivity.shots(model, 10))
    harm = sensitivity.removal(model, found)
    judged = sensitivity.shots(model, 4, 1000)
    truth = sensitivity.pictures(model, judged)

    def error(ready, level):
        arrays = refit.as_read(refit.in_parts(ready, level, 1000), ready.model)
        return sensitivity.mean_square(truth, sensitivity.pictures(replace(ready.model, **arrays), judged)) / 0.002

    ready, _ = thinning.thinned(model, found, -16.0, 1000, model, 20, 64, error, lambda share: None)
    least = np.sort(harm)[-len(ready.model)]
    at_once = model.take(harm >= least)
    rounds, at_once = (sensitivity.mean_square(truth, sensitivity.pictures(one, judged)) for one in (ready.model, at_once))
    assert len(ready.model) < 240 and rounds < 0.5 * at_once, (len(ready.model), rounds, at_once)


def test_leaving_out_ends_where_it_saves_no_bits(monkeypatch):
    """No Gaussian of a few that do not overlap can be spared: after the first round all are kept."""
    model = quantising.canonical(random_model(np.random.default_rng(2), 30, "static", "static", "always", "rgb", extent=2.0, size=0.1))
    found = sensitivity.sensitivity(model, sensitivity.shots(model, 10))
    tried = []

    def error(ready, level):
        tried.append(len(ready.model))
        return 0.9 * 4.0 ** (level + 14) if len(ready.model) == 30 else 2.0

    ready, level = thinning.thinned(model, found, -14.0, 1000, model, 20, 64, error, lambda share: None)
    assert len(ready.model) == 30 and tried[:5] == [30, 30, 27, 27, 30]
    assert level == pytest.approx(-14 + 0.5 * np.log2(1 / 0.9), abs=1e-6)


def test_what_is_left_of_the_loss_leaves_out_more():
    """As many as the error allows, within a few, and those of least harm, in their order."""
    model = quantising.canonical(random_model(np.random.default_rng(2), 1000, "static", "static", "always", "rgb"))
    ready = quantising.prepared(model, sensitivity.sensitivity(model, sensitivity.shots(model, 2)))
    harm = np.random.default_rng(0).uniform(0, 1, 1000)
    for most in (0, 40, 100):
        left = thinning.trimmed(ready, harm, lambda part, most=most: len(part.model) >= 1000 - most)
        assert 1000 - most <= len(left.model) <= 1000 - most + 4
        np.testing.assert_array_equal(left.model.position, model.position[np.sort(np.argsort(-harm)[:len(left.model)])])


@pytest.mark.parametrize(("here", "finer", "change"), [(1.0, 0.25, 0.0), (0.25, 0.0625, 1.0), (4.0, 1.0, -1.0), (1.3, 1.2, -np.inf)])
def test_levels_change_with_what_quantisation_adds(here, finer, change):
    assert thinning.allowed_change(here, finer) == pytest.approx(change)


def test_few_pictures_do_not_decide_alone():
    truth, found = [np.zeros((2, 2, 3))] * 5, [np.full((2, 2, 3), error) for error in (0.1, 1.0, 0.1, 2.0, 0.1)]
    assert rate.usual_square(truth, found) == pytest.approx(0.01 * (3 + 2 * rate.OUTLIER) / 5)
    assert rate.usual_square(truth, found[:1] * 5) == pytest.approx(0.01)


def test_a_model_that_is_farther_from_the_truth_may_lose_more():
    model = random_model(np.random.default_rng(2), 5, provenance={"held_out_psnr": "29"})
    other = replace(model, provenance={"held_out_psnr": "no number"})
    assert rate.held_out(other) == rate.NOMINAL == 32
    assert rate.Loss(0.1).error(model) == pytest.approx(10 ** 0.3 * rate.Loss(0.1).error(other))
    assert 10 * np.log10(1 + rate.Loss(0.3).error(model) / 10**-2.9) == pytest.approx(0.3)


def test_small_models_and_those_that_tell_their_cameras_may_lose_less(monkeypatch):
    model = random_model(np.random.default_rng(2), 60)
    usual = rate.Loss(0.3).error(model)
    for few, share in ((80, 0.75), (1000, 0.5)):
        monkeypatch.setattr(rate, "FEW", few)
        assert rate.Loss(0.3).error(model) == pytest.approx(share * usual)
    filmed = replace(model, surroundings=replace(model.surroundings, cameras=(viewpoint_of(CAMERA, distance=6.0),)))
    assert rate.Loss(0.3).error(filmed) == pytest.approx(0.5 * rate.BETWEEN * usual)


def test_every_second_four_shots_of_a_capture_are_framed():
    model = random_model(np.random.default_rng(2), 60, extent=1.0)
    filmed = replace(model, surroundings=replace(model.surroundings, cameras=(viewpoint_of(CAMERA, distance=6.0),)))
    shapes = [(shot.camera.width, shot.camera.height) for shot in sensitivity.shots(filmed, 8, width=96)]
    assert shapes == [(96, 72)] * 4 + [(96, 54)] * 4
    focal = [shot.camera.fx for shot in sensitivity.shots(filmed, 8, width=96)]
    assert focal[0] == pytest.approx(90) and focal[4] == pytest.approx(90 / sensitivity.FRAMED, rel=0.02)


@pytest.mark.parametrize(("place", "source"), [((0.0, 0.0, 0.9), "figure.ply"), ((0.0, 4.0, 0.9), BAKED)], ids=["standing", "baked"])
def test_what_stands_on_the_ground_is_measured_from_all_around(rng, place, source):
    """The origin is between its feet, or beside it: neither is where cameras stood."""
    position = place + rng.uniform(-1, 1, (400, 3)) * (0.3, 0.2, 0.9)
    model = replace(random_model(rng, 400), position=position, axes="RFU", provenance={"source": source})
    eyes = np.array([np.linalg.inv(shot.camera.world_to_camera)[:3, 3] for shot in sensitivity.shots(model, 40)]) - place
    assert np.abs(eyes[:, :2]).max(1).min() > 0.5 and (eyes[:, 2] > 0).all()
    assert all((eyes @ side).max() > 0.8 for side in np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]))


def test_sensitivities_foretell_what_an_error_does():
    model = random_model(np.random.default_rng(11), 60, "cubic", temporal="radial", appearance="sh1", extent=1.0)
    model = replace(model, opacity=np.minimum(model.opacity, 3))
    series = sensitivity.shots(model, 40)
    found, truth = sensitivity.sensitivity(model, series), sensitivity.pictures(model, series)
    moved = replace(model, position=model.position + np.random.default_rng(0).normal(0, 1e-3, (60, 3)))
    expected = 1e-6 * found.rows["position"].sum()
    assert sensitivity.mean_square(truth, sensitivity.pictures(moved, series)) == pytest.approx(expected, rel=0.5)
    harm = sensitivity.removal(model, found)
    worst = np.argsort(harm)[-12:]  # each is measured with the noise of random signs: together they are near
    error = [sensitivity.mean_square(truth, sensitivity.pictures(model.take(np.arange(60) != i), series)) for i in worst]
    assert sum(error) == pytest.approx(harm[worst].sum(), rel=0.5)


@pytest.mark.parametrize("kind", ["zeros", "skewed", "wide", "far", "few", "none"])
def test_columns_come_back(kind):
    rng = np.random.default_rng(9)
    order = columns.Order()
    order.columns["life"] = rng.integers(-3, 4, 5000)
    codes = {"zeros": np.zeros(5000, int), "skewed": rng.laplace(0, 1, 5000).astype(int) * (order.columns["life"] > 0),
             "wide": rng.normal(100, 300, 5000).astype(int), "far": rng.integers(-2**29, 2**29, 5000), "few": rng.integers(0, 9, 3),
             "none": np.zeros(0, int)}[kind]
    order.columns["life"] = order.columns["life"][:len(codes)]
    data, block = columns.packed("x", codes, order)
    np.testing.assert_array_equal(columns.unpacked(data, block, len(codes), order), codes)
    assert kind != "skewed" or (block.context == "life" and 8 * len(data) < 1.5 * 5000)


def test_columns_of_noise_cost_little_more_than_their_entropy():
    """The search for repetitions finds some in it that cost more than they save."""
    codes = np.rint(np.random.default_rng(3).normal(0, 3, 20000)).astype(int)
    share = np.bincount(codes - codes.min()) / len(codes)
    entropy = -(share[share > 0] * np.log2(share[share > 0])).sum()
    assert 8 * len(columns.packed("x", codes, columns.Order())[0]) / len(codes) < 1.0115 * entropy


def test_windows_keep_their_edges_to_the_bit(tmp_path):
    model = random_model(np.random.default_rng(3), 50, temporal="window")
    fg.save(model, tmp_path / "m.safetensors", compress="fine")
    again = fg.load(tmp_path / "m.safetensors")
    assert len(again) > 40 and set(map(tuple, again.temporal[:, :2])) <= set(map(tuple, model.temporal[:, :2]))


def test_segments_can_be_read_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(compressed, "SEGMENT", 100)
    model = random_model(np.random.default_rng(4), 250, "cubic", appearance="sh1")
    fg.save(model, tmp_path / "m.safetensors", compress="fine")
    whole = fg.load(tmp_path / "m.safetensors")
    assert 200 < len(whole) <= 250
    with open_tensors(tmp_path / "m.safetensors") as file:
        about = json.loads(file.metadata["fast-gs"])["compressed"]
        part = compressed.unpacked(file, about, whole.take(slice(0, 0)), range(1, 2))
    for name, array in part.arrays.items():
        np.testing.assert_array_equal(array, getattr(whole, name)[100:200])


def test_damage_is_found_by_the_checksum(tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(random_model(np.random.default_rng(5), 300, "cubic"), path, compress="fine")
    data = bytearray(path.read_bytes())
    data[-40] ^= 1
    path.write_bytes(data)
    with pytest.raises(fg.FastGSError, match=r"m\.safetensors.*checksum"):
        fg.load(path)


def test_mutated_files(tmp_path, monkeypatch):
    def seed(**kinds):
        fg.save(random_model(np.random.default_rng(6), 9, **kinds), tmp_path / "m.safetensors", compress="fine")
        return {"m.safetensors": (tmp_path / "m.safetensors").read_bytes()}

    def read(folder):
        model = fg.load(folder / "m.safetensors")
        assert all(np.isfinite(array).all() for array in model.arrays.values())

    seeds = {"cubic": seed(basis="cubic", rotation_basis="line", temporal="radial"),
             "keys": seed(basis="keys", rotation_basis="keys", temporal="window", appearance="clamp")}
    (tmp_path / "seeds").mkdir()
    told = mutations.campaign("compressed", read, seeds, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0
    monkeypatch.setattr(columns, "zlib", Unchecked)
    told = mutations.campaign("compressed, unchecked", read, seeds, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_what_cannot_be_compressed_is_said(tmp_path):
    model = random_model(np.random.default_rng(7), 5)
    with pytest.raises(fg.FastGSError, match=r"m\.ply.*compressed variant"):
        fg.save(model, tmp_path / "m.ply", compress="fine")
    for level in (0, "tiny", [1]):
        with pytest.raises(fg.FastGSError, match=r"m\.safetensors.*fine.*small.*0.001 to 10 dB"):
            fg.save(model, tmp_path / "m.safetensors", compress=level)
    model.position[2] = np.nan
    with pytest.warns(fg.LossWarning, match="1 Gaussians.*not finite.*quantised"):
        fg.save(model, tmp_path / "m.safetensors", compress="fine")
    assert len(fg.load(tmp_path / "m.safetensors")) == 4


@pytest.mark.parametrize("temporal", TEMPORALS)
def test_pruning_leaves_out_what_is_never_drawn(temporal):
    model = random_model(np.random.default_rng(8), 300, "cubic", temporal=temporal, extent=2.0)
    model = replace(model, opacity=np.where(np.arange(300) % 3 == 0, np.float32(-9), model.opacity))
    left = pruned(model)
    assert 0 < len(left) <= 200
    for t in (0, 0.35, 1):
        np.testing.assert_array_equal(fg.render(model, CAMERA, t)["rgb"], fg.render(left, CAMERA, t)["rgb"])
    fewer = pruned(model, 0.25)
    assert len(fewer) == pytest.approx(0.75 * len(left), abs=1)
    assert scores(fewer).min() >= np.quantile(scores(left), 0.2)
    with pytest.raises(fg.FastGSError, match="share"):
        pruned(model, 1.0)
