# SPDX-License-Identifier: GPL-3.0-or-later
"""The button that compares the clocks of a capture's cameras: what it finds, and what it says where it finds nothing."""
from __future__ import annotations

import json

import bpy
import numpy as np
import pytest

FRAMES, LATE = 40, 5


@pytest.fixture
def capture(module, tmp_path):
    """Three cameras without poses film a patch that darts about; the last one's pictures are LATE frames ahead."""
    write_png = module("fastgs_blender.util.picture_files").write_png
    rng = np.random.default_rng(2)
    step = rng.uniform(0, 1, FRAMES + LATE) ** 3 * 14
    place = 4 + np.abs(np.cumsum(step) % 80 - 40)
    for view in range(3):
        folder = tmp_path / "capture" / f"cam{view}"
        folder.mkdir(parents=True)
        for frame in range(FRAMES):
            x = int(place[frame + LATE * (view == 2)])
            pixels = np.full((36, 64, 3), 40, np.uint8)
            pixels[10 + view:20 + view, x:x + 10] = 220
            write_png(folder / f"{frame + 1:04}.png", pixels)
    return tmp_path / "capture"


def test_the_clocks_are_compared_and_written(module, capture, scene):
    scene.fastgs.training.capture = str(capture)
    assert bpy.ops.fastgs.sync_cameras() == {'FINISHED'}
    values = json.loads((capture / "sync.json").read_text("utf-8"))
    assert values["found_by"] == "motion" and values["offsets"] == pytest.approx({"cam0": 0, "cam1": 0, "cam2": LATE}, abs=0.3)
    text = bpy.data.texts["Clocks of capture"].as_string()
    assert "cam2" in text and "sync.json" in text and (capture / "sync.png").exists()
    bpy.ops.fastgs.sync_cameras()
    assert len([text for text in bpy.data.texts if text.name.startswith("Clocks of")]) == 1


def test_what_cannot_be_compared_is_told(capture, scene, tmp_path):
    scene.fastgs.training.capture = ""
    with pytest.raises(RuntimeError, match="capture.*chosen"):
        bpy.ops.fastgs.sync_cameras()
    with pytest.raises(RuntimeError, match="no such capture"):
        bpy.ops.fastgs.sync_cameras(capture=str(tmp_path / "gone"))
    for view in range(3):
        first = (capture / f"cam{view}" / "0001.png").read_bytes()
        for frame in range(FRAMES):
            (capture / f"cam{view}" / f"{frame + 1:04}.png").write_bytes(first)
    with pytest.raises(RuntimeError, match="[Nn]othing moves"):
        bpy.ops.fastgs.sync_cameras(capture=str(capture))
    assert not (capture / "sync.json").exists()
