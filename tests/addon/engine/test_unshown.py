# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects and settings that FAST-GS does not render are reported."""
from __future__ import annotations

import bpy
import pytest


def test_meshes_that_are_not_rendered_are_named_once(scene, screen, add, add_camera, warned, tmp_path):
    add_camera()
    for name in ("Chair", "Table", "Lamp", "Door", "Helper", "Hidden", "Dark"):
        add("cube").name = name
    bpy.data.objects["Helper"].display_type = 'WIRE'
    bpy.data.objects["Hidden"].hide_render = True
    bpy.data.objects["Dark"].visible_camera = False
    box = screen.fastgs.crops.add()
    box.object = bpy.data.objects["Door"]
    scene.frame_start, scene.frame_end, scene.render.filepath = 1, 3, str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    text, = warned()
    assert "meshes: Chair, Lamp, Table." in text or "Chair, Table, Lamp." in text
    box.object = None
    bpy.ops.render.render()
    assert "and 1 more" in warned()[0]


def test_settings_that_do_nothing_are_told(scene, screen, add_camera, warned):
    add_camera()
    bpy.ops.render.render()
    assert warned() == []
    screen.is_holdout = True
    bpy.ops.render.render()
    text, = warned()
    assert "Holdout" in text and screen.name in text
    screen.is_holdout = False
    inside = bpy.data.collections.new("Inside")
    scene.collection.children.link(inside)
    inside.objects.link(screen)
    bpy.context.view_layer.layer_collection.children["Inside"].holdout = True
    bpy.ops.render.render()
    assert "Holdout" in warned()[0]


@pytest.mark.parametrize("instanced", [False, True])
def test_ray_visibility(scene, screen, add_camera, render, module, instanced):
    """Off for the object, or for the one that instances it; Solid shading shows it all the same, as it shows meshes."""
    add_camera()
    scene.render.film_transparent = True
    maker = screen
    if instanced:
        inside = bpy.data.collections.new("Inside")
        inside.objects.link(screen)
        scene.collection.objects.unlink(screen)
        maker = bpy.data.objects.new("Maker", None)
        maker.instance_type, maker.instance_collection = 'COLLECTION', inside
        scene.collection.objects.link(maker)
    assert render()["ViewLayer.Combined"][..., 3].min() > 0.9
    maker.visible_camera = False
    assert not render()["ViewLayer.Combined"].any()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    take = module("scene.snapshot").take
    assert len(take(depsgraph, rendered=False).instances) == 1 and not take(depsgraph).instances
