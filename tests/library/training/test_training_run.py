# SPDX-License-Identifier: GPL-3.0-or-later
"""Training itself, on a capture of a few small pictures: it learns, it can be stopped and killed and gives the same file."""
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from held_runs import Barrier
from toy_captures import toy_capture, write_capture

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.run import checkpoint, folder, plan, session
from fastgs_blender.training.run.launch import launch, source_of
from fastgs_blender.training.run.progress import Reporter
from fastgs_blender.util import locks

ROOT = Path(__file__).resolve().parents[3]
FEW = dict(iterations=60, init_points=80, max_gaussians=160, densify_every=10, densify_from=0.1, densify_until=0.9, warm_up=(),
           position_rate=1e-3, position_rate_end=1e-4, motion_rate=2e-3, init_opacity=0.1, init_scale=1.0, init_duration=0.25,
           preview_every=0)


def trainer(capture=None, **choices):
    capture, store, points = capture or toy_capture()
    chosen = settings.settings(**{**FEW, **choices})
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    return Trainer(capture, store, chosen, Start(first))


def steps(who, count):
    return [who.step() for _ in range(count)]


def same(a, b):
    return all(np.array_equal(x, b.optimiser.arrays[name], equal_nan=True) for name, x in a.optimiser.arrays.items())


@pytest.mark.parametrize("choices", [
    {}, {"density": "mcmc"}, {"motion": "paper"}, {"motion": "fourier+linear", "batch": 2},
    {"motion": "polynomial", "densify_time": "random"}, {"motion": "keyframes", "regulariser": "group"},
    {"motion": "paper", "loss": "sum", "regulariser": "printed", "motion_weight": 1e-3, "rate_unit": "extent"},
    {"appearance": "rgb", "temporal": "always"}, {"appearance": "sh1", "densify_gradient": "absolute"},
], ids=str)
def test_it_learns(choices):
    who = trainer(**choices)
    before, _, _ = who.measure(who.capture.held_out)
    values = steps(who, 60)
    after, _, _ = who.measure(who.capture.held_out)
    assert np.mean([v["loss"] for v in values[-10:]]) < 0.7 * np.mean([v["loss"] for v in values[:10]])
    assert after > before + 2
    assert 80 < len(who) <= 160 and max(v["gaussians"] for v in values) <= 160


def test_transparent_parts_stay_transparent_before_any_background():
    who = trainer(toy_capture(mask=True), masks="cut", init_opacity=0.5)
    steps(who, 120)
    shot = who.capture.held_out[0]
    alpha = fg.render(who.model(), shot.camera, shot.t)["alpha"]
    truth = who.store.pixels(shot).mask
    assert alpha[truth < 0.01].mean() < 0.1 and alpha[truth > 0.95].mean() > 0.6


def test_the_same_seed_gives_the_same_model_and_another_does_not():
    first, again, other = trainer(), trainer(), trainer(seed=1)
    for who in (first, again, other):
        steps(who, 15)
    assert same(first, again) and not same(first, other)


@pytest.mark.parametrize("density", ["default", "mcmc"])
def test_a_restored_run_goes_on_exactly(tmp_path, density):
    straight = trainer(density=density)
    steps(straight, 17)
    checkpoint.save(tmp_path, *straight.state())
    steps(straight, 20)
    capture, store, _ = toy_capture()
    again = Trainer(capture, store, straight.settings)
    again.restore(*checkpoint.load(tmp_path))
    steps(again, 20)
    assert same(straight, again) and again.iteration == 37


def test_another_capture_is_refused(tmp_path):
    checkpoint.save(tmp_path, *trainer().state())
    capture, store, _ = toy_capture(frames=3)
    with pytest.raises(fg.FastGSError, match="another capture"):
        Trainer(capture, store, settings.settings(**FEW)).restore(*checkpoint.load(tmp_path))


def test_a_run_that_is_asked_to_stop_saves_and_stops(tmp_path):
    who, saved = trainer(), []
    reporter = Reporter(tmp_path, 60, quiet=True)
    assert not session.take_steps(who, reporter, lambda last: saved.append((who.iteration, last)), lambda: who.iteration >= 5)
    assert who.iteration == 5 and saved[-1] == (5, True)
    assert session.take_steps(who, reporter, lambda last: saved.append((who.iteration, last)), lambda: False)
    assert saved[-1] == (60, True)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("toy"))


def arguments(capture, out, *more):
    options = [text for name, value in FEW.items() for text in ("--set", f"{name}={','.join(map(str, value)) if value == () else value}")]
    return ["train", str(capture), "--out", str(out), "--init", "file", "--set", "checkpoint_seconds=0", *options, *map(str, more)]


def fastgs(*args, **options):
    return subprocess.run([sys.executable, "-m", "fastgs_blender", *args], cwd=ROOT, capture_output=True, text=True,
                          check=False, **options)


@pytest.fixture(scope="module")
def finished(files, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "model"
    result = fastgs(*arguments(files, out, "--json"))
    assert result.returncode == 0, result.stderr
    return out, json.loads(result.stdout)


def test_the_command_leaves_a_model_and_its_history(finished):
    out, report = finished
    trained = fg.load(out / "model.safetensors")
    assert len(trained) == report["gaussians"] <= 160 and report["iterations"] == 60
    assert report["held_out_psnr"] > 14 and report["model_bytes"] == (out / "model.safetensors").stat().st_size
    assert trained.clip == fg.Clip(6, 24.0, 1) and json.loads(trained.provenance["settings"])["iterations"] == 60
    status = json.loads((out / "status.json").read_text())
    assert status["state"] == "finished" and status["iteration"] == 60
    rows = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [row["iteration"] for row in rows if "loss" in row] == [20, 40, 60]
    assert (out / "loss.png").read_bytes()[:4] == b"\x89PNG"
    assert not list(out.glob(".fastgs-*"))


def test_a_long_run_says_how_long_it_takes_and_how_right_that_was(files, tmp_path, monkeypatch):
    monkeypatch.setattr("fastgs_blender.training.core.costs.estimate", lambda pixels, steps, *_: (pixels * steps / 96, 0))
    said = []
    wanted = {**FEW, "init": "file", "iterations": 5}
    launch(source_of(files, None, None, None, None), tmp_path / "run", wanted, False, False, True, said.append, "cpu")
    assert "about 1:30" in said[-2] and "1:30 were estimated" in said[-1]


def test_what_is_there_is_not_overwritten(files, finished):
    out, _ = finished
    before = (out / "model.safetensors").read_bytes()
    result = fastgs(*arguments(files, out))
    assert result.returncode == 2 and "--resume" in result.stderr and (out / "model.safetensors").read_bytes() == before
    result = fastgs(*arguments(files, out, "--resume", "--order", 2))
    assert result.returncode == 2 and "order = 0, not 2" in " ".join(result.stderr.split())  # lines end where the path's length puts it
    result = fastgs(*arguments(files, out, "--resume"))
    assert result.returncode == 0 and (out / "model.safetensors").read_bytes() == before


@pytest.fixture
def barrier(tmp_path, monkeypatch):
    """Holds the training processes that this test starts."""
    held = Barrier(tmp_path / "barrier")
    for name, value in held.variables.items():
        monkeypatch.setenv(name, value)
    yield held
    held.release()


def begun(*arguments):
    """A training process under way."""
    return subprocess.Popen([sys.executable, "-m", "fastgs_blender", *arguments], cwd=ROOT, stderr=subprocess.PIPE, text=True)


def killed_when_held(barrier, process):
    """Kill a process that is held, and say at which step it was."""
    step, number = barrier.wait(lambda: process.poll() is None)
    assert number == process.pid
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    return step


@pytest.mark.slow
@pytest.mark.posix
def test_killed_anywhere_and_resumed_it_gives_the_same_file(files, finished, tmp_path, barrier):
    """Before its first checkpoint, between two, and while one is being written."""
    out, target = tmp_path / "killed", finished[0] / "model.safetensors"
    command = arguments(files, out, "--resume", "--quiet")
    for place in ("checkpoint 0", "step 1", "step 9", "checkpoint 23", "checkpoint 24", "step 51"):
        barrier.hold_at(place)
        step = killed_when_held(barrier, begun(*command))
        assert place.endswith(f" {step}")
        done = checkpoint.load(out)
        assert (done[1]["iteration"] if done else None) == (step - 1 if step else None), "the last whole checkpoint is there"
    barrier.release()
    result = fastgs(*command)
    assert result.returncode == 0, result.stderr
    assert (out / "model.safetensors").read_bytes() == target.read_bytes()
    assert not list(out.glob(".fastgs-*"))


@pytest.mark.slow
@pytest.mark.parametrize("number", ["SIGINT", "SIGHUP"])
@pytest.mark.posix
def test_ctrl_c_saves_and_stops(files, tmp_path, finished, barrier, number):
    out = tmp_path / "stopped"
    barrier.hold_at("step 7")
    process = begun(*arguments(files, out, "--quiet"))
    barrier.wait(lambda: process.poll() is None)
    assert json.loads((out / "status.json").read_text())["state"] == "training"
    process.send_signal(getattr(signal, number))
    barrier.release()
    _, said = process.communicate()
    assert process.returncode == 130 and "--resume" in said
    assert json.loads((out / "status.json").read_text())["state"] == "stopped"
    assert checkpoint.load(out)[1]["iteration"] == 7
    assert fastgs(*arguments(files, out, "--resume")).returncode == 0
    assert (out / "model.safetensors").read_bytes() == (finished[0] / "model.safetensors").read_bytes()


@pytest.mark.slow
def test_a_folder_in_training_is_locked(files, tmp_path, barrier, monkeypatch):
    """A second trainer is refused with a sentence, and touches nothing that the first has in the folder."""
    monkeypatch.setattr(folder, "PATIENCE", 0.0)
    out = tmp_path / "run"
    barrier.hold_at("checkpoint 3")
    process = begun(*arguments(files, out, "--quiet"))
    try:
        barrier.wait(lambda: process.poll() is None)
        before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
        assert any(path.parent.name.startswith(".fastgs-") for path in before), "the first trainer is writing a checkpoint"
        for choice in ("--resume", "--overwrite"):
            second = fastgs(*arguments(files, out, choice))
            assert second.returncode == 2 and "another process" in second.stderr
            with pytest.raises(fg.FastGSError, match="another process"):
                plan.begin(out, {}, lambda w: settings.settings(**w), choice == "--resume", choice == "--overwrite")
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    finally:
        barrier.release()
        process.communicate()
    assert process.returncode == 0 and (out / "model.safetensors").exists()


def test_the_lock_of_a_run_is_free_after_it(tmp_path):
    """In this process too: what fails in begin() leaves no lock."""
    (tmp_path / "model.safetensors").touch()
    with pytest.raises(fg.FastGSError, match="already"):
        plan.begin(tmp_path, {}, lambda w: settings.settings(**w), False, False)
    with locks.acquire(tmp_path / "training.lock") as mine:
        assert mine is not None


@pytest.mark.parametrize("wrong", [["nowhere"], ["{files}", "--set", "colour=3"], ["{files}", "--layout", "none"]],
                         ids=["capture", "option", "layout"])
def test_a_run_that_cannot_begin_leaves_nothing(files, tmp_path, wrong):
    """Neither folders nor a lock, and of a folder that was there what was in it."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    words = [str(tmp_path / word) if word == "nowhere" else word.format(files=files) for word in wrong]
    for out in ("new/folder", "mine"):
        assert cli.main(["train", *words, "--out", str(tmp_path / out)]) == 2
        assert sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")) == ["mine", "mine/notes.txt"]


def test_a_lock_whose_file_was_removed_is_taken_anew(tmp_path):
    """Whoever waited for it while its holder removed it holds the new file, not the old one."""
    path, found = tmp_path / "lock", []
    first = locks.acquire(path)
    waiting = threading.Thread(target=lambda: found.append(locks.acquire(path, 10.0)))
    waiting.start()
    locks.release(first, path)
    waiting.join()
    assert found[0] is not None and locks.is_locked(path)
    locks.release(found[0])
    assert path.exists() and not locks.is_locked(path)


def test_a_full_disk_is_told_while_training_goes_on(tmp_path, monkeypatch, capsys):
    capture, store, points = toy_capture()
    monkeypatch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (points, rest[1]))
    real = checkpoint.save
    calls = []

    def full(folder, arrays, about):
        calls.append(about["iteration"])
        if len(calls) == 3:
            raise fg.FastGSError("the checkpoint could not be written: No space left on device; what was there before is kept.")
        real(folder, arrays, about)

    monkeypatch.setattr(checkpoint, "save", full)
    chosen = plan.begin(tmp_path, {**FEW, "iterations": 12, "checkpoint_seconds": 0.0}, lambda w: settings.settings(**w), False, False)
    report = session.run(capture, store, chosen, tmp_path, quiet=True)
    assert "No space left" in capsys.readouterr().err and report["iterations"] == 12 and len(calls) > 3


@pytest.mark.slow
@pytest.mark.parametrize("density", ["default", "mcmc"])
def test_two_processes_are_one_with_twice_the_batch(files, tmp_path, density):
    one, two = tmp_path / "one", tmp_path / "two"
    alone = fastgs(*arguments(files, one, "--density", density, "--batch", 2))
    assert alone.returncode == 0, alone.stderr
    script = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "-m", "fastgs_blender"]
    both = subprocess.run([*script, *arguments(files, two, "--density", density)], cwd=ROOT, capture_output=True,
                          text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert both.returncode == 0, both.stderr
    logs = [[json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()] for out in (one, two)]
    assert [row["gaussians"] for row in logs[0]] == [row["gaussians"] for row in logs[1]]
    np.testing.assert_allclose([row["loss"] for row in logs[0]], [row["loss"] for row in logs[1]], rtol=1e-4)
    a, b = (fg.load(out / "model.safetensors") for out in (one, two))
    for name, array in a.arrays.items():
        np.testing.assert_allclose(b.arrays[name], array, atol=1e-3)
