# SPDX-License-Identifier: GPL-3.0-or-later
"""Check Capture: in a process of its own, with a text and a page; it can be interrupted."""
from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import panel_recorder
import pytest


@pytest.fixture
def capture(module, tmp_path):
    """Two cameras of three frames."""
    write_png = module("fastgs_blender.util.picture_files").write_png
    folder = tmp_path / "capture"
    rng = np.random.default_rng(3)
    cameras = []
    for i, name in enumerate(("Left", "Right")):
        matrix = np.diag([1.0, 1, 1, 1])
        matrix[:3, 3] = 0.5 - i, 0.3, 4
        (folder / name).mkdir(parents=True)
        for k in range(3):
            write_png(folder / name / f"{k + 1:04}.png", rng.integers(0, 255, (96, 128, 3)).astype(np.uint8))
        cameras.append(dict(name=name, width=128, height=96, fx=120.0, fy=120.0, cx=64.0, cy=48.0, world_to_camera=matrix))
    module("fastgs_blender.captures.layouts.fastgs").write_cameras(folder, cameras, frame_count=3, fps=24)
    return folder


@pytest.mark.slow
def test_a_check_leaves_a_text_and_a_page(module, scene, capture, monkeypatch):
    """What is wrong stands in the text, on the page and in the panel; undo has nothing to take back."""
    (capture / "Left" / "0002.png").unlink()
    module("fastgs_blender.util.picture_files").write_png(capture / "Left" / "0003.png", np.zeros((9, 9, 3), np.uint8))
    scene.fastgs.training.capture = str(capture)
    monkeypatch.setattr(module("fastgs_blender.jobs.capture_check"), "latest", None)
    assert bpy.ops.fastgs.check_capture() == {'FINISHED'}
    text = bpy.data.texts["FAST-GS Check"].as_string()
    page = capture.with_name("capture-check") / "check.html"
    assert "WRONG: Left" in text and "9 x 9" in text and "frame 2" in text
    assert str(page) in text and "2 training cameras" in text
    assert page.read_text("utf-8").startswith("<!DOCTYPE html>")
    assert json.loads(page.with_name("check.json").read_text("utf-8"))["findings"]
    assert bpy.ops.fastgs.check_capture(capture=str(capture), out=str(capture / "page")) == {'FINISHED'}
    assert (capture / "page" / "check.html").is_file() and len(bpy.data.texts) == 1, "the text is used again"
    layout = panel_recorder.Layout()
    panel = next(cls for cls in module("ui").CLASSES if cls.__name__ == "FASTGS_PT_training")
    context = SimpleNamespace(scene=scene, region=SimpleNamespace(width=600), preferences=bpy.context.preferences)
    panel.draw(SimpleNamespace(layout=layout), context)
    drawn = " ".join(text for _, text, _ in layout.record)
    assert "Left" in drawn and "9 x 9" in drawn


def test_what_cannot_be_checked_is_one_sentence(scene, tmp_path):
    with pytest.raises(RuntimeError, match="capture.*chosen"):
        bpy.ops.fastgs.check_capture()
    with pytest.raises(RuntimeError, match="no such capture"):
        bpy.ops.fastgs.check_capture(capture=str(tmp_path / "none"))
    with pytest.raises(RuntimeError, match=r"(?i)no capture"):
        bpy.ops.fastgs.check_capture(capture=str(tmp_path))


def test_an_interrupted_check_ends_its_process(module, capture, tmp_path):
    """Esc closes the work's generator."""
    checks = module("fastgs_blender.jobs.capture_check")
    running = checks.CaptureCheck(module("scene.training.installation").python(), str(capture), str(tmp_path / "page"))
    steps = module("operators.stepwise").watched(running, lambda: running.progress)
    share, whole, stage = next(steps)
    assert 0 <= share <= whole == 1 and stage
    steps.close()
    assert running.done and running.values is None and running._process.poll() is not None
    assert not Path(running._status).parent.exists()
