# SPDX-License-Identifier: GPL-3.0-or-later
"""The protocol of backends suffices: rendering, viewports and training run through one whose arrays NumPy cannot touch."""
from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_backend import METHODS, FakeBackend
from random_cameras import random_pose
from random_models import random_model
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.kernels.protocol import PictureBackend, TrainingBackend
from fastgs_blender.rendering import visibility
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.passes import PASSES, PassSettings
from fastgs_blender.rendering.shadow import Light, Shadow
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.util import backends

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def fake(monkeypatch):
    backend = FakeBackend()
    monkeypatch.setitem(backends.loaded, "fake", backend)
    return backend


@pytest.mark.parametrize(("name", "protocol"), [("cpu", TrainingBackend), ("reference", PictureBackend)])
def test_backends_offer_what_the_protocol_says(name, protocol):
    backend = backends.load_backend(name)
    for method in (each for each in dir(protocol) if not each.startswith("_")):
        wanted = list(inspect.signature(getattr(protocol, method)).parameters)[1:]
        assert list(inspect.signature(getattr(backend, method)).parameters)[:len(wanted)] == wanted, method


@pytest.mark.slow
def test_a_picture_through_the_protocol(rng, fake):
    """Models with and without decoders together, all passes; and what a viewport sorts."""
    camera = fg.Camera(60, 44, 50, 50, 30, 22, random_pose(rng, 2.5))
    scene = [(random_model(rng, 80, appearance=look), np.eye(4), 0.3) for look in ("rgb", "sigmoid", "sh1", "none")]
    holdout = rng.normal(size=(9, 3, 3))
    settings = PassSettings(shadows=(Shadow(Light.sun((0, 0, 1)), holdout, size=64),))
    for models in (scene, scene[1:2], scene[:1]):
        wanted, got = (fg.render(models, camera, passes=tuple(PASSES), backend=name, holdout=holdout, settings=settings)
                       for name in ("cpu", "fake"))
        assert wanted["alpha"].max() > 0.5
        assert all(np.array_equal(got[name], wanted[name]) for name in PASSES)
    seen = [Instance(*each).viewed(camera) for each in scene]
    np.testing.assert_array_equal(visibility.order(seen, camera, backend="fake"), visibility.order(seen, camera, backend="cpu"))
    assert set(fake.calls) == {"draw", "colour", "numpy", "front_to_back", "surface", "past_splats", "posed", "thinnest", "view_box"}


@pytest.mark.parametrize(("density", "mask", "options"), [
    ("default", False, {"motion_weight": 0.1}),
    ("mcmc", True, {"batch": 2, "appearance": "rgb", "motion": "keyframes", "regulariser": "group", "masks": "weight"}),
])
def test_training_through_the_protocol(fake, density, mask, options):
    """The same bytes as on the CPU; within a step nothing is brought back but a few numbers at its end, and pictures where the step looks
    at how cameras differ."""
    capture, store, points = toy_capture(frames=3, views=3, mask=mask)
    chosen = settings.settings(iterations=12, densify_every=5, densify_from=0.0, densify_until=1.0, densify_threshold=1e-6, reset_every=4,
                               density=density, preview_every=0, **options)
    model = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    sizes = np.where(np.arange(len(points)) < 10, 0.3, np.nan)
    ours, theirs = (Trainer(capture, store, chosen, Start(model, sizes, frozen=9), backend=name) for name in ("cpu", "fake"))
    used = set()
    for number in range(1, 13):
        fake.calls.clear()
        assert ours.step() == theirs.step()
        used |= set(fake.calls)
        assert fake.calls.count("end_step") == 1 and "read" not in fake.calls
        if not theirs.strategy.acts(number) and not theirs.cameras.response.is_due(number - 1, 12):
            assert "numpy" not in fake.calls
    assert len(ours) > len(points)
    for mine, other in zip(ours.state()[0].items(), theirs.state()[0].items()):
        assert mine[0] == other[0] and np.array_equal(mine[1], other[1], equal_nan=True), mine[0]
    needed = {"forward", "compare", "backward", "rows", "count", "steps_since", "motion_penalty", "anchor", "adam", "array", "zeros",
              "begin_step", "end_step"}
    assert needed | ({"mcmc_penalty", "mcmc_noise"} if density == "mcmc" else set()) <= used <= METHODS
    again = Trainer(capture, store, chosen, backend="fake")
    again.restore(*theirs.state())
    assert ours.step() == again.step()
    assert theirs.measure(capture.held_out[:1])[0] > 0


WITHOUT_TORCH = """
import sys

class Refuse:
    wrong = AssertionError
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "bpy"):
            raise self.wrong(name + " was imported")

sys.meta_path.insert(0, Refuse())
sys.path.insert(0, "tests/library")
from pathlib import Path
from toy_captures import write_capture
from fastgs_blender import cli
from fastgs_blender.training.run import session

folder = Path(sys.argv[1])
toy, run, again = (str(folder / name) for name in ("toy", "run", "again"))
write_capture(folder / "toy", 2, 3)
session.StopFlag.__call__ = lambda self: True
assert cli.main(["train", toy, "--out", run, "--set", "init=file", *OPTIONS]) == 130
session.StopFlag.__call__ = lambda self: self.asked
assert cli.main(["train", "--resume", "--out", run, "--quiet", "--device", "cpu"]) == 0
assert cli.main(["train", toy, "--out", again, "--init-model", run + "/model.safetensors", *OPTIONS]) == 0
Refuse.wrong = ModuleNotFoundError  # LPIPS is measured where torch is
assert cli.main(["eval", run, toy, "--quiet", "--device", "cpu"]) == 0
assert cli.main(["info", run]) == 0
"""
OPTIONS = ["--quiet", "--device", "cpu", "--iterations", "4", "--set", "densify_every=2", "--set", "densify_from=0"]


@pytest.mark.slow
def test_training_needs_no_torch_and_makes_the_same_model_without(tmp_path):
    """Without torch: train, stop, resume, start from a model, measure, tell.  Where torch is imported, the same bytes come out."""
    code = WITHOUT_TORCH.replace("OPTIONS", repr(OPTIONS))
    result = subprocess.run([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert cli.main(["train", str(tmp_path / "toy"), "--out", str(tmp_path / "other"), "--set", "init=file", *OPTIONS]) == 0
    made, wanted = ((tmp_path / name / "model.safetensors").read_bytes() for name in ("run", "other"))
    assert made == wanted
