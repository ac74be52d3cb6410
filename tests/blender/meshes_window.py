# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories in Blender's window (see inside.py): *Render With Meshes*."""
from __future__ import annotations

import os

import bpy
from background import bring, look
from window import area_of, f12, shot, until, within


def joined(model, engine):
    """Choose an engine, then add a wall and a sun with a splat shadow as a user does; F12; then Off: what both scenes hold, and files."""
    scene = bring(model)
    look(scene, 320, 240)
    scene.view_settings.view_transform = 'Raw'
    area = area_of()
    scene.fastgs.render_meshes = engine
    other = next(each for each in bpy.data.scenes if each != scene)
    other.cycles.samples, other.cycles.use_denoising, other.eevee.taa_render_samples = 4, False, 4
    with within(area):
        bpy.ops.mesh.primitive_plane_add(size=1.2, location=(1.0, -1.4, 1.2), rotation=(1.2, 0, 0.63))
    wall = bpy.context.view_layer.objects.active
    material = bpy.data.materials.new("Green")
    material.use_nodes = True
    emission = material.node_tree.nodes.new('ShaderNodeEmission')
    emission.inputs["Color"].default_value = (0, 1, 0, 1)
    material.node_tree.links.new(emission.outputs[0], material.node_tree.get_output_node('ALL').inputs["Surface"])
    wall.data.materials.append(material)
    with within(area):
        bpy.ops.object.light_add(type='SUN', rotation=(0.6, 0.4, 0))
    sun = bpy.context.view_layer.objects.active
    sun.fastgs.splat_shadow = True
    scene.render.motion_blur_shutter = 0.75
    scene.render.filepath = os.path.abspath(f"with-meshes-{engine.lower()}-")
    other.view_layers[0].use_pass_normal = scene.fastgs.write_passes = True
    followed = yield from until(lambda: sun.name in other.objects and wall.name in other.objects)
    yield from f12(area)
    shot(f"with-meshes-{engine.lower()}")
    picture = f"with-meshes-{engine.lower()}.png"
    scene.render.image_settings.file_format = 'PNG'
    bpy.data.images["Render Result"].save_render(os.path.abspath(picture), scene=scene)
    facts = {"followed": followed, "shutter": other.render.motion_blur_shutter, "picture": picture, "engine": other.render.engine,
             "shaded": [node.label for node in _tree(scene).nodes if node.name.startswith("FAST-GS Shade")]}
    scene.fastgs.render_meshes = 'OFF'
    yield from until(lambda: len(bpy.data.scenes) == 1)  # by a timer of the extension
    return {**facts, "scenes": len(bpy.data.scenes)}


def _tree(scene):
    return scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
