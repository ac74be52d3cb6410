# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever is in a checkpoint, it is refused in one sentence or training goes on from it; nothing in it reaches a kernel unchecked."""
from __future__ import annotations

import copy
import functools
import json
import operator
import os
import warnings
from dataclasses import replace

import mutations
import numpy as np
import pytest
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.camera_estimates import SUMS
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.run import checkpoint, plan, session, written
from fastgs_blender.training.run.files import CHECKPOINT, REPORT, RUN, SEGMENT_DONE, SEGMENT_MODEL
from fastgs_blender.training.run.folder import release
from fastgs_blender.training.run.intermediate import model_of

FEW = dict(iterations=40, init_points=20, max_gaussians=40, warm_up=(), densify_every=10, densify_from=0.1, preview_every=0, init_scale=1.0)


@pytest.fixture(scope="module")
def toy():
    return toy_capture(frames=2, views=3)


def begun(toy, steps=12, **choices):
    """A trainer of 20 Gaussians after some steps; every third of them is held."""
    capture, store, points = toy
    chosen = settings.settings(**{**FEW, **choices})
    points = points.take(np.arange(0, len(points.xyz), 4))
    sizes = np.where(np.arange(len(points.xyz)) % 3, np.nan, 0.1)
    points = replace(points, size=sizes)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, Start(first, sizes))
    for _ in range(steps):
        trainer.step()
    return trainer


def resumed(toy, folder, chosen, steps=1):
    """What `fastgs train --resume` and Blender's button do with a checkpoint."""
    capture, store, _ = toy
    arrays, about = checkpoint.load(folder)
    model_of(arrays, about)
    trainer = Trainer(capture, store, chosen)
    trainer.restore(arrays, about)
    for _ in range(min(steps, chosen.iterations - trainer.iteration)):
        trainer.step()
    return trainer


def changed(name, change):
    """A function that changes one array of a checkpoint."""
    def apply(arrays, about):
        arrays[name] = np.ascontiguousarray(change(np.array(arrays[name])))

    return apply


def with_value(name, at, value):
    def change(array):
        array.reshape(-1)[at] = value
        return array

    return changed(name, change)


def without(name):
    return lambda arrays, about: arrays.pop(name)


def about_changed(**values):
    return lambda arrays, about: about.update(values)


DAMAGES = {
    "a sign bit of a counter": with_value("optimiser.count.position", 3, -(2**31) + 5),
    "a counter beyond the steps": with_value("optimiser.count.opacity", 0, 13),
    "moved later than now": with_value("optimiser.moved", 2, 13), "moved before the beginning": with_value("optimiser.moved", 2, -1),
    "steps that do not fit": with_value("optimiser.steps", 0, 11), "a beta of one": with_value("optimiser.betas", 1, 1.0),
    "a beta that is no number": with_value("optimiser.betas", 0, np.nan),
    "a position that is no number": with_value("optimiser.value.position", 5, np.nan),
    "an infinite mean": with_value("optimiser.mean.scale", 5, np.inf), "a negative square": with_value("optimiser.square.motion", 0, -1),
    "an infinite anchor": with_value("optimiser.value.anchor", 1, np.inf),
    "shortened statistics": changed("statistics.radius", lambda array: array[:-1]),
    "empty statistics": changed("statistics.seen", lambda array: array[:0]),
    "negative statistics": with_value("statistics.seen", 0, -1.0),
    "shortened opacities": changed("optimiser.value.opacity", lambda array: array[:-1]),
    "motion of another order": changed("optimiser.value.motion", lambda array: array[:, :-1]),
    "a decoder of another shape": changed("optimiser.value.w1", lambda array: array[:, :-1]),
    "doubles": changed("optimiser.value.scale", lambda array: array.astype(np.float64)),
    "long counters": changed("optimiser.count.scale", lambda array: array.astype(np.int64)),
    "no dimension": changed("optimiser.value.position", lambda array: array.reshape(-1)),
    "no Gaussians": changed("optimiser.value.position", lambda array: array[:0]),
    "an unknown array": lambda arrays, about: arrays.update({"optimiser.value.sigma": np.zeros(3, np.float32)}),
    "no positions": without("optimiser.value.position"), "no moments": without("optimiser.square.opacity"),
    "no betas": without("optimiser.betas"), "no statistics": without("statistics.absolute"), "no array at all": lambda a, about: a.clear(),
    "a decoder beyond all numbers": with_value("optimiser.value.w2", 0, -1e30),
    "a position beyond all scenes": with_value("optimiser.value.position", 5, 1e30),
    "a size beyond them": with_value("optimiser.value.scale", 0, 60),
    "an anchor beyond them": with_value("optimiser.value.anchor", 0, 1e30),
    "a square that is no number": with_value("optimiser.square.w1", 0, np.nan),
    "a mean without its square": with_value("optimiser.mean.opacity", 0, 1e6),
    "a clock beyond the clip": with_value("cameras.offsets", 0, -1e30),
    "a bias beyond colours": with_value("cameras.biases", 0, 1e30),
    "delayed clocks": with_value("cameras.delayed.clock_sums", 0, -1e30),
    "delayed colours": with_value("cameras.delayed.colour_sums", 1, 1e30),
    "delayed turns": with_value("cameras.delayed.turn_sums", 0, -1e30), "poses that are not alike": with_value("cameras.turn_sums", 1, 5.0),
    "poses of negative squares": with_value("cameras.turn_sums", 0, -5.0),
    "poses without errors": with_value("cameras.turn_sums", 12, -1.0),
    "steps after the end": about_changed(iteration=41), "negative steps": about_changed(iteration=-1),
    "no steps": about_changed(iteration=None),
    "no capture": about_changed(capture=None), "no settings": about_changed(settings=None), "no clip": about_changed(clip=[]),
    "a clip of no frames": about_changed(clip=[0, 24.0, 1]), "no axes": about_changed(axes=None),
    "a queue too long": changed("cameras.delayed.steps", lambda array: np.zeros(17, np.int64)),
    "a queued step to come": with_value("cameras.delayed.steps", 0, 12),
    "no depth": about_changed(depth="far"), "a depth of 0": about_changed(depth=0), "no time": about_changed(elapsed="x"),
}


@pytest.fixture(scope="module")
def whole(toy, tmp_path_factory):
    """(trainer, arrays, about) of a checkpoint that is all right."""
    trainer = begun(toy)
    queued = {name: np.zeros((len(trainer.cameras.turns.views), *shape)) for name, shape in SUMS.items()}
    trainer.delayed.updated, trainer.delayed.arrived = 10, {11: queued}  # as a GPU, which is steps ahead, has some
    folder = tmp_path_factory.mktemp("whole")
    checkpoint.save(folder, *trainer.state())
    assert resumed(toy, folder, trainer.settings, 2).iteration == 14
    return trainer, *checkpoint.load(folder)


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_refused_before_it_is_used(toy, whole, tmp_path, damage):
    trainer, arrays, about = whole[0], dict(whole[1]), dict(whole[2])
    DAMAGES[damage](arrays, about)
    checkpoint.save(tmp_path, arrays, about)
    with pytest.raises(fg.FastGSError):
        resumed(toy, tmp_path, trainer.settings)


def told_of(about, above=()):
    """The way to each value in what a checkpoint says beside its arrays; its settings have a reader of their own."""
    for key, value in about.items() if isinstance(about, dict) else enumerate(about):
        if key != "settings":
            yield (*above, key)
            yield from told_of(value, (*above, key)) if isinstance(value, (dict, list)) else ()


def forgeries(arrays, about):
    """Checkpoints of which one array, or one value beside the arrays, is another: far out, no number, of another type or shape."""
    for name, array in arrays.items():
        numbers = {"f": (-1e30, 1e17, np.nan, np.inf), "i": (np.iinfo("i4").min, np.iinfo("i4").max)}[array.dtype.kind]
        changes = [with_value(name, -1, number) for number in numbers]
        changes += [changed(name, lambda array, number=number: np.full_like(array, number)) for number in (1e9, -1e3, *numbers[-1:])]
        changes += [changed(name, lambda array: array.astype(np.float16)), changed(name, lambda array: array[..., None])]
        for change in changes:
            forged = dict(arrays)
            change(forged, about)
            yield forged, about
    for way in told_of(about):
        for value in (None, "x", {}, [[]], -1, 1e30, True):
            forged = copy.deepcopy(about)
            inner = functools.reduce(operator.getitem, way[:-1], forged)
            inner[way[-1]] = value
            yield arrays, forged


@pytest.mark.slow
def test_no_value_of_a_checkpoint_ends_in_anything_but_a_sentence_or_a_model(toy, whole, tmp_path):
    """What is accepted is trained on, written and read."""
    trainer, arrays, about = whole
    told = {True: 0, False: 0}
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for forged in forgeries(arrays, about):
            checkpoint.save(tmp_path, *forged)
            try:
                written.write(resumed(toy, tmp_path, trainer.settings, 2).final_model({}), tmp_path / "model.safetensors")
            except fg.FastGSError:
                told[False] += 1
            else:
                fg.load(tmp_path / "model.safetensors")
                told[True] += 1
    assert told[False] > 6 * len(arrays) > told[True] > 0


def test_a_model_that_nobody_could_read_is_not_written(make_model, rng, tmp_path):
    good, bad = make_model(rng, 5), make_model(rng, 5)
    bad.position = np.full_like(bad.position, np.nan)
    file = tmp_path / "model.safetensors"
    written.write(good, file)
    before = file.read_bytes()
    with pytest.raises(fg.FastGSError, match="model.safetensors.*position") as error:
        written.write(bad, file)
    assert file.read_bytes() == before and ".tmp" not in str(error.value) and os.listdir(tmp_path) == ["model.safetensors"]


@pytest.mark.parametrize("choices", [{"density": "mcmc"}, {"appearance": "sh1"}, {"appearance": "rgb", "motion": "static"},
                                     {"motion": "keyframes", "temporal": "always"}, {"motion": "paper"}], ids=str)
def test_a_whole_one_is_not(toy, tmp_path, choices):
    trainer = begun(toy, **choices)
    checkpoint.save(tmp_path, *trainer.state())
    resumed(toy, tmp_path, trainer.settings, 2)


def test_mutations(toy, whole, tmp_path):
    """One step is taken from every checkpoint that is accepted: with wild but finite numbers training may diverge, which it says."""
    trainer, arrays, about = whole
    checkpoint.save(tmp_path, arrays, about)
    seeds = {"checkpoint": {CHECKPOINT: (tmp_path / CHECKPOINT).read_bytes()}}

    def read(folder):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", RuntimeWarning)
            resumed(toy, folder, trainer.settings)

    mutations.campaign("checkpoint", read, seeds, tmp_path / "damaged")


@pytest.mark.slow
def test_mutations_of_the_small_files(tmp_path, monkeypatch):
    """run.json, done.json and the log of a run that is resumed."""
    monkeypatch.setattr("tqdm.tqdm.monitor_interval", 0)  # no thread for each of the bars
    chosen = settings.settings(**FEW)
    segment = session.segment_folder(tmp_path, 0)
    segment.mkdir(parents=True)
    files = {RUN: json.dumps({"settings": chosen.to_dict()}).encode(), f"segments/000/{SEGMENT_DONE}": b'{"elapsed": 12.5}\n',
             f"segments/000/{SEGMENT_MODEL}": b"", "log.jsonl": b'{"iteration": 20, "loss": 0.1, "smooth_loss": 0.2, "psnr": 20.0}\n' * 3}

    def read(folder):
        from fastgs_blender.training.run.plot import write_plot
        from fastgs_blender.training.run.progress import Reporter

        begun = plan.begin(folder, {}, lambda wanted: chosen, True, False)
        try:
            done, elapsed = session.progress_so_far(folder, [begun.settings.iterations] * 2)
            assert done == begun.settings.iterations and elapsed >= 0
            Reporter(folder, 100, 60, quiet=True).close()
            write_plot(folder / "plot.png", folder / "log.jsonl")
        finally:
            release(str(folder.resolve()))

    mutations.campaign("run", read, {"run": files}, tmp_path / "damaged", fixed=[f"segments/000/{SEGMENT_MODEL}"])
    assert not (tmp_path / REPORT).exists()
