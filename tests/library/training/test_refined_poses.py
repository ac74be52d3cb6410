# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras whose poses are a little wrong: training turns them back, leaves right ones, and goes on from a checkpoint exactly."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
from toy_captures import MemoryStore, toy_cameras

import fastgs_blender as fg
from fastgs_blender.cameras.poses import turned
from fastgs_blender.captures.capture import Capture, Points, Shot
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.evaluation.training_record import corrections, corrections_entry, sentence
from fastgs_blender.training.core.camera_turns import CameraTurns
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.run import checkpoint
from fastgs_blender.training.run.session import at_limits
from fastgs_blender.util.backends import load_backend

FOCAL = 90.0
"""Pixels."""
WRONG = {"cam03": np.array([0.3, 1.0, 0.2]) / FOCAL}
"""A turn of about a pixel."""


def cloud(wrong=WRONG):
    """(capture, store, points, truth): Gaussians at all depths, without a moving one; cameras in the capture are turned by `wrong`."""
    rng, n = np.random.default_rng(3), 150
    upright = np.zeros((n, 4))
    upright[:, 0] = 1
    truth = fg.GaussianModel(position=rng.uniform((-2.2, -1.8, -0.3), (2.2, 1.8, 1.5), (n, 3)), rotation=upright,
                             scale=np.full((n, 3), np.log(0.25)), opacity=np.full(n, 3.0), features=rng.uniform(0.05, 0.95, (n, 3)),
                             motion=np.zeros((n, 0, 3)), basis=fg.Cosine(0), clip=fg.Clip(1, 24.0, 1))
    cameras = [fg.Camera(2 * c.width, 2 * c.height, FOCAL, FOCAL, 2 * c.cx, 2 * c.cy, c.world_to_camera) for c in toy_cameras(6)]
    shots = [Shot(f"cam{v:02}", 0, camera, None, None, v == 0, 0.0) for v, camera in enumerate(cameras)]
    believed = [replace(shot, camera=moved(shot.camera, wrong.get(shot.view, np.zeros(3)))) for shot in shots]
    return Capture(Path("cloud"), "test", believed, truth.clip), MemoryStore(truth, shots), Points(truth.position, truth.features), truth


def moved(camera, turn):
    return replace(camera, world_to_camera=turned(camera.world_to_camera, turn))


def trainer(made, unsure=MappingProxyType({}), **choices):
    capture, store, points, _ = made
    chosen = settings(**{**dict(init_points=150, max_gaussians=150, warm_up=(), init_opacity=0.9, init_scale=1.0, preview_every=0,
                                appearance="rgb", motion="static", iterations=300), **choices})
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    return Trainer(capture, store, chosen, Start(first, unsure=unsure))


def train(who):
    while who.iteration < who.settings.iterations:
        who.step()
    return who


def test_a_turn_is_found_from_the_slopes_of_one_picture():
    """The model is the truth: a few looks at each camera find all three angles."""
    capture, store, _, truth = cloud()
    backend, found = load_backend("cpu"), CameraTurns.initial(capture.training, "on")
    arrays = {name: np.array(array) for name, array in truth.arrays.items()}
    for _ in range(12):
        for shot in capture.training:
            camera = found.camera(shot.view, shot.camera)
            picture = backend.forward(arrays, truth, camera, 0.0)
            goal = SimpleNamespace(camera=camera, rgb=store.pixels(shot).rgb, weight=None, least=None)
            found.update(**found.accumulate([(shot, found.measure(shot, goal, *backend.over(picture, None)))]))
    right = np.array([-WRONG.get(view, np.zeros(3)) for view in found.views])
    np.testing.assert_allclose(found.turns * FOCAL, right * FOCAL, atol=0.1)


def test_what_all_cameras_turn_by_is_not_told():
    capture, *_ = cloud({})
    found = CameraTurns.initial(capture.training, "on")
    for shared in np.eye(3) * 2e-3:
        new = np.zeros((5, 14))
        for k, axes in enumerate(found.axes):
            new[k] = *(1e9 * np.eye(3)).ravel(), *(1e9 * axes @ shared), 1.0, 1e5
        found.update(new)
        assert np.abs(found.turns).max() < 1e-6
    new[2, 9:12] += 1e9 * np.array([0, 0.03, 0])
    for _ in range(12):
        found.update(new)
    assert found.turns[2, 1] == pytest.approx(0.03, rel=0.05) and np.abs(np.delete(found.turns, 2, 0)).max() < 1.5e-3


def test_what_stopped_at_its_limit_is_a_warning():
    facts = {"poses": {"a": [1.2, 0, 0], "b": [0, 1.6, 1.2]}, "clocks": {"c": -1.5, "d": 1.4}}
    pose, clock = at_limits(facts)
    assert "pose of b" in pose and "calibrate" in pose and "clock of c" in clock and "fastgs sync" in clock
    assert at_limits({"poses": {"a": [1.2, 0, 0]}, "exposures": {}}) == []


@pytest.fixture(scope="module")
def refined():
    """A run with the setting auto, that knows of one camera that it may be wrong, and the same one that leaves poses as they are."""
    return [train(trainer(cloud(), {"cam03": 2 / FOCAL}, poses=setting)) for setting in ("auto", "off")]


def test_one_wrong_pose_is_refined_and_told(refined):
    who, without = refined
    left = np.array([who.cameras.turns.turns[k] + WRONG.get(view, 0) for k, view in enumerate(who.cameras.turns.views)]) * FOCAL
    assert np.linalg.norm(left, axis=1).max() < np.linalg.norm(WRONG["cam03"]) * FOCAL / 3
    model = who.final_model({})
    assert corrections(model)["poses"]["cam03"] == pytest.approx(np.degrees(who.cameras.turns.turns[2]), abs=1e-3)
    assert "poses were refined" in sentence(corrections(model)) and "cam03" in sentence(corrections(model))
    assert "poses" not in corrections(without.final_model({}))
    seen = [evaluate(each.final_model({}), each.capture, each.store, views=["cam03"], lpips=False) for each in refined]
    assert seen[0]["average"]["psnr"] > 30 and any("refined" in note for note in seen[0]["notes"])
    assert not any("refined" in note for note in seen[1]["notes"])


def test_right_poses_stay():
    who = train(trainer(cloud({}), dict.fromkeys(WRONG, 2 / FOCAL), poses="auto"))
    assert who.cameras.turns.turn_sums.any() and not who.cameras.turns.differ and who.cameras.turns.facts() == {}
    shot = who.shots[0]
    assert who.cameras.turns.camera(shot.view, shot.camera) is shot.camera


def test_no_camera_turns_farther_than_tracks_are_unsure_of():
    """A poor model wants to turn all cameras by 3 pixels, each another way."""
    capture, *_ = cloud({})
    sums = np.zeros((5, 14))
    for k, row in enumerate(sums):
        row[:] = *(1e9 * np.eye(3)).ravel(), *(1e9 * 3 / FOCAL * np.roll([1, -1, 0], k)), 1.0, 1e5
    found = CameraTurns.initial(capture.training, "auto", {"cam03": 0.5 / FOCAL})
    for _ in range(8):
        found.update(sums)
    size = np.linalg.norm(found.turns, axis=1) * FOCAL
    assert 0.4 < size[2] <= 0.5 + 1e-9 and not np.delete(size, 2).any()
    assert not CameraTurns.initial(capture.training, "auto").is_due(400, 1000), "nothing is measured that could turn nothing"


def test_a_restored_run_goes_on_exactly(tmp_path):
    made = cloud()
    straight = trainer(made, iterations=60, poses="on")
    for _ in range(31):
        straight.step()
    checkpoint.save(tmp_path, *straight.state())
    train(straight)
    again = Trainer(made[0], made[1], straight.settings)
    again.restore(*checkpoint.load(tmp_path))
    train(again)
    assert again.cameras.turns.turns.any()
    for name, array in straight.state()[0].items():
        assert np.array_equal(array, again.state()[0][name], equal_nan=True), name


@pytest.mark.parametrize("wrong", ["turns", "turn_sums"])
def test_damaged_numbers_of_a_checkpoint_are_refused(wrong):
    made = cloud()
    who = trainer(made, iterations=20)
    arrays, about = who.state()
    name = f"cameras.{wrong}"
    for array in (np.full_like(arrays[name], np.nan), arrays[name][:-1]):
        with pytest.raises(fg.FastGSError, match="cameras"):
            Trainer(made[0], made[1], who.settings).restore({**arrays, name: array}, about)


def test_parallel_projections_and_single_cameras_are_left_alone():
    capture, *_ = cloud()
    flat = [replace(shot, camera=replace(shot.camera, orthographic=True)) for shot in capture.training]
    assert CameraTurns.initial(flat, "on").setting == "off" and CameraTurns.initial(capture.training[:1], "on").setting == "off"


def test_evaluation_shows_trained_views_by_refined_cameras():
    """The model is the truth, and its file says what training changed in a capture that believes something else."""
    capture, store, _, truth = cloud()
    change = {"turn": (-WRONG["cam03"]).tolist(), "shift": [0.0, 0.0, 0.0], "focal": 1.0}
    told = replace(truth, provenance={**truth.provenance, **corrections_entry({"cameras": {"cam03": change}})})
    assert corrections(told)["cameras"] == {"cam03": change} and "cameras of 1 views" in sentence(corrections(told))
    right, wrong = (evaluate(model, capture, store, views=["cam03"], lpips=False) for model in (told, truth))
    assert (right["average"]["psnr"] or 99) > wrong["average"]["psnr"] + 20 and any("refined" in note for note in right["notes"])
    for damage in ({"focal": 0.0}, {"focal": "1"}, {"turn": [0.0]}, {"shift": None}):
        assert corrections(replace(truth, provenance=corrections_entry({"cameras": {"cam03": {**change, **damage}}}))) == {}
