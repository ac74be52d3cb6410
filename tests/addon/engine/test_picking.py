# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks in a 3D view select the nearest object whose splats are visible there."""
from dataclasses import replace

import bpy
import by_hand
import numpy as np


def test_the_nearest_splats_at_a_pixel_are_found(scene, fg, module, make_model, model_file, splat_object):
    picking, take = module("engine.viewport.picking"), module("scene.snapshot").take
    dot = dict(rotation=np.array([[1.0, 0, 0, 0]]), scale=np.full((1, 3), np.log(0.2)), features=np.ones((1, 3)))
    solid = model_file(make_model(1, position=np.zeros((1, 3)), opacity=np.array([6.0]), **dot), "solid.safetensors")
    faint = model_file(make_model(1, position=np.zeros((1, 3)), opacity=np.array([-3.0]), **dot), "faint.safetensors")
    for name, path, y, x in (("Near", solid, -1, 0), ("Far", solid, 3, 0), ("Faint", faint, -2, 0), ("Right", solid, 0, 1.5)):
        splat_object(path, name).location = (x, y, 0)
    group = bpy.data.collections.new("Group")
    splat_object(solid, "Inside", collection=group)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection, instance.location = 'COLLECTION', group, (-1.5, 0, 0)
    scene.collection.objects.link(instance)
    camera = by_hand.camera(fg, by_hand.look_at((0, -6, 0), (0, 0, 0)), 320, 240)

    def at(place):
        x, y, z = (camera.world_to_camera @ [*place, 1])[:3]
        return round(camera.cx + camera.fx * x / z), round(camera.height - (camera.cy + camera.fy * y / z))

    shown = take(bpy.context.evaluated_depsgraph_get())
    shown.load()  # files are not read for a click
    name, depth = picking.splats_at(shown, camera, *at((0, -1, 0)))
    assert name == "Near" and abs(depth - 5) < 0.3
    assert picking.splats_at(shown, camera, *at((1.5, 0, 0)))[0] == "Right"
    assert picking.splats_at(shown, camera, *at((-1.5, 0, 0)))[0] == "Instance"
    assert picking.splats_at(shown, camera, *at((0.75, 0, 0.9))) is None
    assert picking.splats_at(shown, camera, -1, 400) is None
    bpy.data.objects["Near"].hide_viewport = True
    bpy.context.view_layer.update()
    shown = take(bpy.context.evaluated_depsgraph_get())
    assert picking.splats_at(shown, camera, *at((0, -1, 0)))[0] == "Far"


def test_a_backdrop_is_not_clicked(scene, fg, module, make_model, model_file, splat_object):
    """It is drawn behind a small subject, and a click on it goes to what Blender itself has there."""
    picking, take = module("engine.viewport.picking"), module("scene.snapshot").take
    around = module("fastgs_blender.model.surroundings")
    model = make_model(2, position=np.array([[0, 0, 0], [0, 9.0, 0]]), opacity=np.full(2, 6.0), features=np.ones((2, 3)),
                       rotation=np.array([[1.0, 0, 0, 0]] * 2), scale=np.log(np.array([[0.2] * 3, [4.0] * 3])))
    splat_object(model_file(replace(model, surroundings=around.Surroundings(around.Backdrop(radius=8.0)))))
    camera = by_hand.camera(fg, by_hand.look_at((0, -4, 0), (0, 0, 0)), 320, 240)
    shown = take(bpy.context.evaluated_depsgraph_get())
    shown.load()
    drawn = fg.render(shown.load()[0], camera, passes=["alpha"])["alpha"]
    assert drawn[120, 160] > 0.5 and drawn[60, 160] > 0.5
    assert picking.splats_at(shown, camera, 160, 120) is not None and picking.splats_at(shown, camera, 160, 180) is None
