# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels Train and Capture: what a button will do, and why it cannot be pressed."""
from __future__ import annotations

import json
from types import SimpleNamespace

import bpy
import panel_recorder
import pytest
from panel_widths import REGIONS, WIDTHS


@pytest.fixture
def drawn(module, scene, monkeypatch):
    """drawn(name): all words and the operators of a panel, and which of these can be pressed."""
    def draw(name):
        layout = panel_recorder.Layout()
        panel = next(cls for cls in module("ui").CLASSES if cls.__name__ == name)
        context = SimpleNamespace(scene=scene, object=bpy.context.object, selected_objects=bpy.context.selected_objects, mode='OBJECT',
                                  region=SimpleNamespace(width=REGIONS[panel.bl_region_type]), preferences=bpy.context.preferences)
        panel.draw(SimpleNamespace(layout=layout), context)
        assert not layout.cut(WIDTHS[panel.bl_region_type])
        return " ".join(text for kind, text, _ in layout.record if kind in ("label", "progress")), layout.pressable

    return draw


@pytest.fixture
def settings(scene, tmp_path, module, monkeypatch):
    """The panel's settings, with a capture that exists; no job is on the list."""
    monkeypatch.setattr(module("scene.training.watch"), "_found", [])
    (tmp_path / "capture").mkdir()
    chosen = scene.fastgs.training
    chosen.capture = str(tmp_path / "capture")
    return chosen


def test_the_panel_says_what_becomes_of_a_run_that_is_there(settings, drawn, tmp_path):
    words, enabled = drawn("FASTGS_PT_training")
    assert "new folder" in words and enabled["fastgs.train"]
    run = tmp_path / "run"
    run.mkdir()
    settings.out = str(run)
    assert "into run." in drawn("FASTGS_PT_training")[0]
    for name, content in (("model.safetensors", ""), ("status.json", json.dumps({"iterations": 2500, "held_out_psnr": 27.79}))):
        (run / name).write_text(content)
    words, enabled = drawn("FASTGS_PT_training")
    assert "(2,500 steps, 27.79 dB)" in words and "run-2" in words and enabled["fastgs.train"]
    settings.existing = 'OVERWRITE'
    assert "deleted" in drawn("FASTGS_PT_training")[0]
    settings.existing = 'RESUME'
    words, enabled = drawn("FASTGS_PT_training")
    assert "to continue" in words and not enabled["fastgs.train"]


def test_a_button_that_cannot_be_pressed_says_why(settings, drawn, module, monkeypatch, tmp_path):
    settings.capture = ""
    words, enabled = drawn("FASTGS_PT_training")
    assert "capture is chosen" in words and not enabled["fastgs.train"] and not enabled["fastgs.train_check"]
    settings.capture = str(tmp_path / "gone")
    assert "no such capture" in drawn("FASTGS_PT_training")[0]
    settings.source = 'CAMERAS'
    words, enabled = drawn("FASTGS_PT_training")
    assert "training needs several" in words and not enabled["fastgs.train"]
    settings.source, settings.cameras = 'SCENE', 'ALL'
    words, enabled = drawn("FASTGS_PT_training")
    assert "two cameras" in words.lower() and not enabled["fastgs.capture_scene"] and not enabled["fastgs.train"]
    settings.cameras = 'DOME'
    words, enabled = drawn("FASTGS_PT_training")
    assert enabled["fastgs.capture_scene"] and enabled["fastgs.train"]
    monkeypatch.setattr(module("scene.training.installation"), "NEEDED", {"a_module_that_nobody_has": "numba"})
    words, enabled = drawn("FASTGS_PT_training")
    assert "lacks numba" in words and "needs no network" in words and not enabled["fastgs.train"]
    assert enabled["fastgs.test_training_python"] and enabled["preferences.addon_show"] and enabled["fastgs.capture_scene"]


def test_a_training_python_that_failed_its_test_is_told(settings, drawn, module, monkeypatch):
    store, pythons = module("scene.training.installation"), module("fastgs_blender.jobs.environment")
    report = pythons.Report(store.python(), "3.11", {}, {"tqdm": "ModuleNotFoundError: No module named 'tqdm'"})
    monkeypatch.setattr(store, "tested", {store.python(): report})
    words, enabled = drawn("FASTGS_PT_training")
    assert "lacks tqdm" in words and not enabled["fastgs.train"]


def test_the_estimate_includes_filming_and_learns_from_it(settings, scene, module, drawn, monkeypatch):
    progress, results = module("scene.filming.progress"), module("scene.training.results")
    monkeypatch.setattr(progress, "_measured", {})
    scene.frame_start, scene.frame_end = 1, 10
    settings.source, settings.count, settings.width, settings.height = 'SCENE', 12, 640, 480
    now = [0.0]
    monkeypatch.setattr(progress, "current", progress.Filming("dance", clock=lambda: now[0]))
    first = progress.estimate(scene, settings, 120)
    for done in range(4):  # the first two are there already
        progress.current.step(done + 2, 120)
        now[0] += 5.0
    progress.measure(scene, settings)
    assert progress.current.seconds_each == 5.0 and progress.estimate(scene, settings, 120) == 600.0 != first
    words, _ = drawn("FASTGS_PT_training_runs")
    assert "dance" in words and "Filming 4 %, 10 min left" in words and "5 of 120" in words and "Esc interrupts" in words
    monkeypatch.setattr(progress, "current", None)
    words, _ = drawn("FASTGS_PT_training")
    costs = module("fastgs_blender.training.core.costs")
    training, _ = costs.estimate(640 * 480, *costs.size_of(settings.preset, pixels=12 * 640 * 480), 120, 12)
    assert f"about {results.duration(600 + training)}" in words and "10 min of it" in words


def test_runs_are_listed_with_the_running_one_first(module, scene, drawn, monkeypatch):
    jobs, watch = module("fastgs_blender.jobs.job"), module("scene.training.watch")
    rows = [(jobs.Job(name, f"/out/{name}", "/capture", "python", scene={"blend": blend, "process": 0}), jobs.State(kind, kind.title(), {}))
            for name, kind, blend in (("old", 'FINISHED', "/films/dance.blend"), ("new", 'FAILED', ""), ("waits", 'QUEUED', ""),
                                      ("runs", 'TRAINING', ""))]
    monkeypatch.setattr(watch, "_found", rows)
    assert [job.id for job, _ in watch.ordered()] == ["runs", "waits", "new", "old"] and watch.current()[0].id == "runs"
    words, _ = drawn("FASTGS_PT_training_runs")
    assert "dance.blend" in words and "an unsaved file" in words


def test_the_capture_panel_offers_the_captures_rate_and_range(module, scene, drawn, fg):
    assert "import one first" in drawn("FASTGS_PT_capture")[0]
    clips = module("scene.cameras.clips")
    camera = bpy.data.objects.new("cam0", bpy.data.cameras.new("cam0"))
    scene.collection.objects.link(camera)
    camera.data.fastgs.view, camera.data.fastgs.width, camera.data.fastgs.height = "cam0", 320, 200
    clips.remember(camera.data, 5, fg.Clip(48, 29.97))
    bpy.context.view_layer.update()
    scene.render.fps, scene.frame_start, scene.frame_end = 24, 1, 250
    words, enabled = drawn("FASTGS_PT_capture")
    assert all(part in words for part in ("29.97", "5 to 52", "24 on", "1 to 250")) and enabled["fastgs.set_scene"]
    assert bpy.ops.fastgs.set_scene() == {'FINISHED'}
    assert (scene.render.fps / scene.render.fps_base, scene.frame_start, scene.frame_end) == (pytest.approx(29.97), 5, 52)
    assert (scene.render.resolution_x, scene.render.resolution_y, scene.camera) == (320, 200, camera)
    assert "fastgs.set_scene" not in drawn("FASTGS_PT_capture")[1]
