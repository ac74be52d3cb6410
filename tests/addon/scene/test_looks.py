# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks of objects in Blender: properties, keys, copies, the operator, and the picture that the library makes of them."""
from __future__ import annotations

import bpy
import numpy as np
import pytest
from panel_recorder import Layout

LOOK = dict(exposure=0.5, gamma=1.5, contrast=1.5, saturation=0.5, hue=0.6, tint=(1.0, 0.75, 0.5), opacity=0.75, opacity_cut=0.25,
            splat_scale=1.5, min_size=0.25, max_size=0.5, pixel_size=0.125)
"""Numbers that single precision holds, but for the hue."""


@pytest.fixture
def shown(make_model, model_file, splat_object, add_camera, scene):
    """An object before a camera, on transparent film."""
    add_camera()
    scene.render.film_transparent = True
    return splat_object(model_file(make_model()))


def settings_of(module, obj):
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return module("scene.snapshot").settings_of(obj.evaluated_get(depsgraph), depsgraph)


def test_properties_are_the_librarys_settings(module, shown):
    instances = module("fastgs_blender.rendering.instances")
    assert settings_of(module, shown) == instances.ObjectSettings()
    for name, value in LOOK.items():
        setattr(shown.fastgs, name, value)
    got = settings_of(module, shown)
    for name, value in LOOK.items():
        assert getattr(got, name) == pytest.approx(value), name
        rna = shown.fastgs.bl_rna.properties[name]
        look = instances.LOOKS[name]
        assert (rna.hard_min, rna.hard_max) == (pytest.approx(look.low), pytest.approx(look.high))
        assert (rna.name, rna.description) == (look.label, look.tooltip) and rna.is_animatable
    copy = shown.copy()
    bpy.context.scene.collection.objects.link(copy)
    assert settings_of(module, copy) == got


def test_the_panel_draws_the_librarys_looks_in_their_order(module, shown):
    bpy.context.view_layer.objects.active = shown
    layout = Layout()
    module("ui.object_panels").draw_look(layout, bpy.context)
    names = [name for kind, name, _ in layout.record if kind == "prop"]
    looks = [name for name, look in module("fastgs_blender.rendering.instances").LOOKS.items() if look.group != "LIGHT"]
    assert looks == list(LOOK) and names == [*looks[:-1], "antialias", "pixel_size", "viewport_density", "density"]


def test_f12_shows_the_look_of_each_object_and_of_its_instances(module, shown, render, scene, now):
    instances, rendering = module("fastgs_blender.rendering.instances"), module("engine.passes")
    plain = render()["ViewLayer.Combined"]
    for name, value in LOOK.items():
        setattr(shown.fastgs, name, value)
    collection = bpy.data.collections.new("Instanced")
    scene.collection.objects.unlink(shown)
    collection.objects.link(shown)
    for x in (-0.5, 0.5):
        empty = bpy.data.objects.new("Instance", None)
        empty.instance_type, empty.instance_collection, empty.location.x = 'COLLECTION', collection, x
        scene.collection.objects.link(empty)
    graded = render()["ViewLayer.Combined"]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    parts, left_out = module("scene.snapshot").take(depsgraph).load()
    assert len(parts) == 2 and not left_out and all(part.settings == parts[0].settings != instances.ObjectSettings() for part in parts)
    wanted = rendering.images(parts, now(scene.camera), [])["Combined"]
    assert np.abs(wanted - graded).max() < 1e-3 * max(1, wanted.max())  # the file's half floats
    assert np.abs(graded - plain).max() > 0.1


def test_looks_are_keyed(module, shown, render, scene):
    """A fade: opacity between two keys, at a sub-frame too."""
    for frame, value in ((1, 1.0), (5, 0.0)):
        shown.fastgs.opacity = value
        shown.fastgs.keyframe_insert("opacity", frame=frame)
    action = shown.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for point in curves[0].keyframe_points:
        point.interpolation = 'LINEAR'
    alpha = []
    for frame, subframe in ((1, 0.0), (2, 0.5), (5, 0.0)):
        scene.frame_set(frame, subframe=subframe)
        assert settings_of(module, shown).opacity == pytest.approx(1 - (frame + subframe - 1) / 4)
        scene.frame_set(frame)
        alpha.append(render()["ViewLayer.Combined"][..., 3].mean())
    assert alpha[0] > alpha[1] > alpha[2] == 0


def test_reset(shown):
    for name, value in LOOK.items():
        setattr(shown.fastgs, name, value)
    bpy.context.view_layer.objects.active = shown
    bpy.ops.fastgs.reset_look()
    assert not any(shown.fastgs.is_property_set(name) for name in LOOK)


def test_what_instances_splats_has_a_look_of_its_own(module, shown, scene):
    """Two empties with one collection, and a mesh whose Geometry Nodes instance it: each adds its look to that of the object."""
    shown.fastgs.exposure = 1.0
    collection = bpy.data.collections.new("Instanced")
    scene.collection.objects.unlink(shown)
    collection.objects.link(shown)
    for x, exposure in ((-1, 0.0), (1, -3.0)):
        empty = bpy.data.objects.new("Instance", None)
        empty.instance_type, empty.instance_collection, empty.location.x = 'COLLECTION', collection, x
        scene.collection.objects.link(empty)
        empty.fastgs.exposure, empty.fastgs.tint = exposure, (1.0, 0.5, 1.0)
    maker = bpy.data.objects.new("Maker", bpy.data.meshes.new("Maker"))
    scene.collection.objects.link(maker)
    maker.fastgs.opacity = 0.5
    tree = bpy.data.node_groups.new("Make", 'GeometryNodeTree')
    tree.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    info, out = tree.nodes.new('GeometryNodeObjectInfo'), tree.nodes.new('NodeGroupOutput')
    info.inputs["Object"].default_value = shown
    info.inputs["As Instance"].default_value = True
    tree.links.new(info.outputs["Geometry"], out.inputs[0])
    maker.modifiers.new("Make", 'NODES').node_group = tree
    bpy.context.view_layer.update()
    parts, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    found = sorted((p.settings.exposure, p.settings.tint[1], p.settings.opacity) for p in parts)
    assert np.allclose(found, [(-2.0, 0.5, 1.0), (1.0, 0.5, 1.0), (1.0, 1.0, 0.5)])
    panel = module("ui.object_panels").FASTGS_PT_instances
    for obj, drawn in ((maker, True), (scene.collection.objects["Instance"], True), (scene.camera, False)):
        bpy.context.view_layer.objects.active = obj
        assert panel.poll(bpy.context) == drawn


def test_density_for_viewports_and_for_renders(module, shown, render):
    shown.fastgs.viewport_density, shown.fastgs.density = 0.25, 0.5
    bpy.context.view_layer.update()
    depsgraph, take = bpy.context.evaluated_depsgraph_get(), module("scene.snapshot").take
    assert [take(depsgraph, final=final).instances[0].settings.density for final in (None, False, True)] == [0.25, 0.25, 0.5]
    half = render()["ViewLayer.Combined"]
    shown.fastgs.density = 1.0
    whole = render()["ViewLayer.Combined"]
    assert 0.1 < half[..., 3].sum() / whole[..., 3].sum() < 0.98
