# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of a render are reported in one sentence, the other objects are rendered, and a stopped render stops."""
import os
import re
import threading
from concurrent.futures import CancelledError

import bpy
import by_hand
import numpy as np
import pytest
from held_runs import GUARD


@pytest.fixture
def broken_file(tmp_path):
    """A file that is no model."""
    path = tmp_path / "broken.safetensors"
    path.write_bytes(b"this is not a model")
    return str(path)


@pytest.mark.parametrize("kind", ["missing", "broken"])
def test_other_objects_still_render(scene, fg, kind, broken_file, make_model, model_file, splat_object, add_camera, render,
                                    caplog, capfd):
    model = make_model()
    splat_object(model_file(model), "Good")
    path = broken_file if kind == "broken" else os.path.abspath("/nowhere/at all.ply")
    splat_object(path, "Bad")
    add_camera()
    scene.render.film_transparent = True
    want = fg.render(model, by_hand.camera(fg, by_hand.look_at((0, -5, 0), (0, 0, 0))), backend="reference")
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))
    lines = [record for record in caplog.records if path in record.message]
    assert len(lines) == 1 and lines[0].levelname == "WARNING" and "Bad" in lines[0].message
    assert "\n" not in lines[0].message
    if kind == "missing":
        assert f"out: {path}" in capfd.readouterr().out


@pytest.mark.parametrize("broken", [dict(location=(float("nan"), 0, 0)), dict(scale=(float("inf"), 1, 1)), dict(scale=(3e38, 1, 1))])
def test_an_object_with_a_broken_transform_is_left_out_and_named(
        broken, make_model, model_file, splat_object, add_camera, render, caplog):
    splat_object(model_file(make_model()), "Good")
    add_camera()
    alone = render()["ViewLayer.Combined"]
    bad = splat_object(model_file(make_model(seed=1), "bad.safetensors"), "Bad")
    for name, value in broken.items():
        setattr(bad, name, value)
    both = render()["ViewLayer.Combined"]
    assert np.isfinite(both).all()
    np.testing.assert_array_equal(both, alone)
    line, = [record.message for record in caplog.records]
    assert line.startswith("Bad is left out: its transform holds numbers")


def test_nothing_that_can_be_loaded_is_an_error_and_not_a_black_picture(scene, splat_object, add_camera, tmp_path, caplog):
    splat_object("/nowhere/a.ply", "A")
    splat_object("/nowhere/b.ply", "B")
    add_camera()
    scene.render.filepath = str(tmp_path / "black.png")
    with pytest.raises(RuntimeError, match=re.escape(os.path.abspath("/nowhere/a.ply"))):
        bpy.ops.render.render(write_still=True)
    assert not os.path.exists(scene.render.filepath)
    assert "Traceback" not in caplog.text


def test_an_empty_scene_gives_the_background_and_a_warning(scene, add_camera, render, caplog):
    add_camera()
    np.testing.assert_array_equal(render()["ViewLayer.Combined"][5, 5], (0, 0, 0, 1))
    assert "shows no 4D Gaussians" in caplog.text


def test_a_hidden_broken_object_is_of_no_account(scene, broken_file, make_model, model_file, splat_object, add_camera, render, caplog):
    splat_object(model_file(make_model()), "Good")
    splat_object(broken_file, "Bad").hide_render = True
    add_camera()
    render()
    assert not caplog.records


def test_the_unexpected_is_one_sentence_and_a_traceback_in_the_log(
        scene, module, make_model, model_file, splat_object, add_camera, render, caplog, monkeypatch):
    splat_object(model_file(make_model()))
    add_camera()
    monkeypatch.setattr(module("scene.colour"), "scene_linear", lambda *_: 1 / 0)
    with pytest.raises(RuntimeError, match="frame 1 .*ZeroDivisionError") as caught:
        render()
    assert "Traceback" not in str(caught.value)
    assert "Traceback" in caplog.text


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 0, 1), (float("nan"), 1, 1)])
def test_a_camera_without_directions_is_one_sentence(scale, make_model, model_file, splat_object, add_camera, render, caplog):
    splat_object(model_file(make_model()))
    add_camera().scale = scale
    with pytest.raises(RuntimeError, match='"Camera" .*scale of 1'):
        render()
    assert "Traceback" not in caplog.text


UNPRINTABLE = "/nowhere/\udcff\x1b[31m.ply"
"""A file's name that is no UTF-8, with an escape sequence in it."""


def test_names_that_cannot_be_printed_are_reported(make_model, model_file, splat_object, add_camera, render, caplog, capfd):
    splat_object(model_file(make_model()), "Good")
    splat_object(UNPRINTABLE, "Bad")
    add_camera()
    render()
    assert os.path.abspath("/nowhere/a.ply").replace("a.ply", r"\udcff\x1b[31m.ply") in capfd.readouterr().out
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_a_frame_that_fails_with_a_name_that_cannot_be_printed_is_a_failed_frame(
        scene, splat_object, add_camera, tmp_path, caplog):
    splat_object(UNPRINTABLE)
    add_camera()
    scene.render.filepath = str(tmp_path / "black.png")
    with pytest.raises(RuntimeError, match="nowhere.*udcff"):
        bpy.ops.render.render(write_still=True)
    assert not os.path.exists(scene.render.filepath) and "Traceback" not in caplog.text


def test_too_little_memory_is_said(scene, module, fg, make_model, model_file, splat_object, add_camera, render, monkeypatch):
    splat_object(model_file(make_model()))
    add_camera()

    def starve(*_, **__):
        raise MemoryError

    monkeypatch.setattr(fg, "render", starve)
    with pytest.raises(RuntimeError, match="memory"):
        render()


class Observer:
    """Stands in for the RenderEngine instance where a test has to press Esc or watch the status line.

    stop  () -> whether Esc was pressed
    """

    camera_override = None

    def __init__(self, stop=lambda: False):
        self.test_break = stop
        self.fractions, self.stats, self.results, self.memory, self.reports = [], [], [], [], []
        self.told = threading.Condition()

    def update_progress(self, fraction):
        with self.told:
            self.fractions.append(fraction)
            self.told.notify_all()

    def update_stats(self, left, right):
        self.stats.append(right)

    def update_memory_stats(self, memory_used, memory_peak):
        self.memory.append(memory_used)

    def report(self, kind, text):
        self.reports.append((kind, text))

    def begin_result(self, *_, **__):
        self.results.append("begun")
        raise AssertionError("the picture is not wanted here")


@pytest.fixture
def replaced(fg, make_model, model_file, splat_object, add_camera, monkeypatch):
    """replaced("open_source" or "render", before): a scene whose library first calls before(progress or None) in that function."""
    splat_object(model_file(make_model()))
    add_camera()

    def make(what, before):
        original = getattr(fg, what)

        def function(*arguments, **options):
            before(options.pop("progress", None))
            return original(*arguments, **options)

        monkeypatch.setattr(fg, what, function)

    return make


@pytest.mark.parametrize("what", ["open_source", "render"])
def test_cancelling_waits_for_nothing(module, replaced, what, caplog):
    """Also while a file is read, which nobody can interrupt: the work has not ended when the render has."""
    running, released, ended = threading.Event(), threading.Event(), threading.Event()

    def work(progress):
        running.set()
        released.wait(GUARD)
        ended.set()

    replaced(what, work)
    engine = Observer(stop=running.is_set)
    try:
        module("engine.final").render(engine, bpy.context.evaluated_depsgraph_get())
        assert running.is_set() and not ended.is_set()
        assert not engine.results and not engine.reports and not caplog.records
    finally:
        released.set()
    assert ended.wait(GUARD)


def test_a_stopped_worker_ends_by_itself(module):
    worker, ended, stopped = module("engine.worker"), threading.Event(), threading.Event()

    def work(progress):
        try:
            progress(0.5)
            stopped.wait(GUARD)
            progress(0.6)
        except InterruptedError:
            ended.set()
            raise

    with pytest.raises(CancelledError):
        worker.run(work, stopped=lambda: True, report=lambda fraction: None)
    stopped.set()
    assert ended.wait(GUARD)


def test_progress_memory_and_status(module, replaced):
    engine, steps = Observer(), [0.25, 0.5, 0.75]

    def work(progress):
        for step in steps:
            progress(step)
            with engine.told:
                assert engine.told.wait_for(lambda step=step: step in engine.fractions, GUARD)

    replaced("render", work)
    module("engine.final").render(engine, bpy.context.evaluated_depsgraph_get())
    assert [fraction for fraction in engine.fractions if fraction] == steps
    assert engine.memory[0] > 40 * 64 * 48 / 2**20
    assert "Reading" in engine.stats[0] and "40 Gaussians" in engine.stats[-1] and "ViewLayer" in engine.stats[-1]


def test_what_a_first_picture_needs_is_waited_for_and_not_the_rest_of_a_compilation(module, replaced, monkeypatch):
    waited = []
    monkeypatch.setattr(module("engine.compiling"), "is_running", lambda: True)
    monkeypatch.setattr(module("fastgs_blender.kernels.cpu.cache"), "has_first", lambda: bool(waited))
    monkeypatch.setattr(module("engine.compiling").time, "sleep", lambda span: waited.append(threading.current_thread().name))
    engine = Observer()
    module("engine.final").render(engine, bpy.context.evaluated_depsgraph_get())
    assert len(waited) == 1 and waited[0] != threading.current_thread().name
    assert any("Compiling" in line for line in engine.stats)


def test_status_reaches_blender(scene, make_model, model_file, splat_object, add_camera, render):
    lines = []

    def listen(text, _):
        lines.append(text)

    splat_object(model_file(make_model()))
    add_camera()
    bpy.app.handlers.render_stats.append(listen)
    try:
        render()
    finally:
        bpy.app.handlers.render_stats.remove(listen)
    assert any("40 Gaussians | Rendering" in str(line) for line in lines)
