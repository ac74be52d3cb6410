# SPDX-License-Identifier: GPL-3.0-or-later
"""The example from an animated .blend to a picture of its model, with small numbers, in a Blender of its own."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from held_runs import GUARD
from image_files import read_png
from test_capture_scene import moving_scene  # noqa: F401 (fixtures)

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = ROOT / "examples" / "capture_train_render.py"
SMALLER = {"width=640, height=480": "width=64, height=48, samples=4",
           "preset='DRAFT'": "preset='DRAFT', iterations=250, max_gaussians=3000",
           "bpy.ops.render.render(": "scene.render.resolution_x, scene.render.resolution_y = 96, 72; bpy.ops.render.render("}
START = """
import runpy, sys
sys.path.insert(0, sys.argv[1])
from blender_setup import enable_addon
enable_addon()
sys.argv = sys.argv[2:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_it_is_short():
    assert len(SCRIPT.read_text("utf-8").splitlines()) < 25


@pytest.mark.slow
def test_from_a_scene_to_a_rendered_picture(moving_scene, tmp_path):  # noqa: F811
    """The ball of a colour of its own over a floor is in the picture, where the new camera looks, before the scene's world."""
    pytest.importorskip("torch")
    scene = moving_scene
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = 'Standard'
    scene.render.image_settings.file_format = 'PNG'
    material = bpy.data.materials.new("Red")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.9, 0.02, 0.02, 1)
    bpy.data.objects["Ball"].data.materials.append(material)
    bpy.data.objects["Floor"].hide_render = True
    scene.world = bpy.data.worlds.new("Green")
    scene.world.color = (0.0, 0.2, 0.0)
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.0, 0.2, 0.0, 1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    text = SCRIPT.read_text("utf-8")
    for there, smaller in SMALLER.items():
        assert there in text
        text = text.replace(there, smaller)
    (tmp_path / "script.py").write_text(text, "utf-8")
    command = [sys.executable, "-c", START, ROOT / "tools", tmp_path / "script.py", tmp_path / "scene.blend", tmp_path / "out"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, timeout=GUARD)
    assert done.returncode == 0, done.stdout[-3000:]
    picture = read_png(tmp_path / "out" / "shot.png")[..., :3].astype(int)
    h, w, _ = picture.shape
    red, green = (picture[..., 0] > 100) & (picture[..., 0] > 2 * picture[..., 1]), np.array([0, 124, 0])  # 0.2 as sRGB
    assert 0.02 < red.mean() < 0.6, "its lit side"
    behind = np.abs(picture - green).max(-1) < 12
    assert behind[[0, -1]].all() and behind[:, [0, -1]].all(), "the whole of it is in the picture"
    rows, columns = np.nonzero(~behind)
    middle = np.array([rows.min() + rows.max(), columns.min() + columns.max()]) / 2 / (h, w) - 0.5
    assert abs(middle[0]) < 0.1 and abs(middle[1]) < 0.25, "the camera looks at the middle of a way of which this is one end"
