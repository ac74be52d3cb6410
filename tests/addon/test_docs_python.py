# SPDX-License-Identifier: GPL-3.0-or-later
"""The Python examples for Blender in README and docs/ run as they are written; filming and training take few pictures and steps."""
from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = [page for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
         if any("bpy." in code for code in BLOCK.findall(page.read_text("utf-8")))]
FEWER = {"count=12, width=640, height=480": "count=4, width=64, height=48, samples=1, frame_end=3",
         "preset='DRAFT'": "preset='DRAFT', iterations=3, max_gaussians=300", "count=200_000": "count=500",
         "frame_end = 1, 72": "frame_end = 1, 2"}


@pytest.fixture
def shot(scene, tmp_path, add_camera, monkeypatch):
    """A saved scene: a moving cube, selected, a light and a camera, and a model in captures/."""
    import bpy

    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "captures").mkdir()
    shutil.copy(ROOT / "examples" / "fireside.safetensors", tmp_path / "captures" / "dance.safetensors")
    bpy.ops.mesh.primitive_cube_add(size=1.5)
    cube = bpy.context.object
    for frame, place in ((1, -0.3), (4, 0.3)):
        cube.location.x = place
        cube.keyframe_insert("location", frame=frame)
    bpy.ops.object.light_add(type='SUN')
    add_camera()
    scene.frame_start, scene.frame_end = 1, 4
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == cube)
    bpy.context.view_layer.objects.active = cube
    scene.render.engine, scene.cycles.samples = 'CYCLES', 1
    scene.render.filepath = f"{tmp_path}/"  # a folder, as in the startup file: what names no file writes a hidden ".png"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_for_blender_runs(page, shot, fg):
    import bpy

    names = {"bpy": bpy, "np": np, "fg": fg}
    for code in BLOCK.findall(page.read_text("utf-8")):
        if "bpy" not in code:
            continue
        for many, few in FEWER.items():
            code = code.replace(many, few)
        exec(code, names)  # noqa: S102 (our own pages)
        assert ("write_still" not in code) or [path for path in shot.glob("*.png") if path.name != ".png"]
