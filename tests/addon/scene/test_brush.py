# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that are hidden by hand: what F12 shows, what undo and .blend files keep, the operators."""
from __future__ import annotations

import bpy
import numpy as np
import pytest


@pytest.fixture
def row(fg, model_file, add_camera, scene):
    """Ten Gaussians along x from -0.9 to 0.9, imported, before a camera 64 pixels and 4 units wide."""
    x = np.linspace(-0.9, 0.9, 10)
    model = fg.GaussianModel(
        position=np.stack([x, 0 * x, 0 * x], 1), rotation=np.tile([1.0, 0, 0, 0], (10, 1)), scale=np.full((10, 3), np.log(0.02)),
        opacity=np.full(10, 4.0), features=np.full((10, 3), 0.8), axes="RFU")
    add_camera(type='ORTHO', ortho_scale=4.0)
    scene.render.film_transparent = True
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    return bpy.context.object


def count(render):
    columns = np.flatnonzero(render()["ViewLayer.Combined"][..., 3].max(0) > 0.2)
    return int((np.diff(columns) > 1).sum() + 1) if len(columns) else 0


@pytest.fixture
def stroke(module, row, scene, now):
    """stroke(low, high, hide=True): a box over these pixels in x, in the scene's camera."""
    brush, shapes = module("scene.brush"), module("fastgs_blender.selecting.shapes")

    def go(low, high, hide=True):
        bpy.context.view_layer.update()
        return brush.brush(row, bpy.context.evaluated_depsgraph_get(), now(scene.camera), shapes.Box((low, 0), (high, 48)), hide)

    return go


def test_hidden_shown_inverted(row, stroke, render):
    assert count(render) == 10
    assert stroke(0, 32) == 5 and count(render) == 5
    assert stroke(0, 38) == 2 and stroke(0, 38) == 0 and count(render) == 3
    assert stroke(20, 30, hide=False) == 3 and count(render) == 6
    bpy.ops.fastgs.invert_hidden()
    assert count(render) == 4
    copy = row.copy()
    assert copy.fastgs.mask == row.fastgs.mask
    bpy.ops.fastgs.show_hidden()
    assert count(render) == 10 and not bpy.ops.fastgs.show_hidden.poll()


def test_undo_and_files_keep_it(row, stroke, tmp_path, module):
    name = row.name
    bpy.ops.ed.undo_push(message="before")
    stroke(0, 32)
    bpy.ops.ed.undo_push(message="Hide Gaussians")
    kept = row.fastgs.mask
    assert kept
    bpy.ops.ed.undo()
    assert not bpy.data.objects[name].fastgs.mask
    bpy.ops.ed.redo()
    assert bpy.data.objects[name].fastgs.mask == kept
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.data.objects[name].fastgs.mask == kept and module("scene.brush").mask_of(bpy.data.objects[name]).sum() == 5


def test_the_brush_wants_a_view(row):
    with pytest.raises(RuntimeError, match="in a 3D view"):
        bpy.ops.fastgs.brush(path=[{"name": "", "loc": (1, 1), "time": 0}])
