# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories in Blender's window (see inside.py): viewports beside renders, and work that a viewport avoids."""
from __future__ import annotations

import itertools
import os
import sys

import bpy
from background import ADDON, bring, look
from looking import drawn
from mathutils import Euler, Matrix, Vector
from window import area_of, f12, seen_by, settled, shot, through_camera, turns, until, within


def part(name):
    """A module of the extension that runs here."""
    return sys.modules[f"{ADDON}.{name}"]


def evening():
    """A world of nodes: an orange horizon below a blue sky."""
    world = bpy.context.scene.world = bpy.data.worlds.new("Evening")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    place, split, ramp = (tree.nodes.new(f'ShaderNode{kind}') for kind in ("TexCoord", "SeparateXYZ", "ValToRGB"))
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (0.35, 0.12, 0.04, 1), (0.03, 0.09, 0.3, 1)
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.0, 0.7
    for source, target in ((place.outputs["Generated"], split.inputs[0]), (split.outputs["Z"], ramp.inputs[0]),
                           (ramp.outputs["Color"], tree.nodes["Background"].inputs["Color"])):
        tree.links.new(source, target)


def bone(name, place):
    """A large bone."""
    with within(area_of()):
        bpy.ops.object.armature_add(location=place)
    obj = bpy.context.object
    obj.name, obj.scale = name, (1.2, 1.2, 1.2)
    return obj


def rendered(model):
    """Rendered shading with all overlays: a bone before the splats, one behind them, the floor's grid; then a world; then F12."""
    scene = bring(model)
    look(scene, 640, 420)
    scene.frame_set(12)
    scene.render.film_transparent, scene.world = False, None
    area = area_of()
    space, view = area.spaces.active, area.spaces.active.region_3d
    splats = next(o for o in scene.objects if o.fastgs.filepath)
    splats.location.z = 0.05
    view.view_rotation = Euler((1.0, 0, -0.35)).to_quaternion()
    view.view_location, view.view_distance = (0, 0, 0.6), 6.5
    yield from turns()
    towards = view.view_rotation @ Vector((0, 0, 1))
    side = view.view_rotation @ Vector((1, 0, 0))
    middle = Vector((0, 0, 0.05))
    bone("Before", middle + 3.2 * towards - 0.35 * side)
    bone("Behind", middle - 2.5 * towards + 0.2 * side - Vector((0, 0, 1.2)))
    bpy.ops.object.select_all(action='DESELECT')
    scene.cursor.location = (0, 0, 8)
    space.shading.type = 'RENDERED'
    yield from settled("overlays")
    facts = {**seen_by(area), "frame": 12, "start": splats.fastgs.start_frame}
    space.overlay.show_overlays = False
    yield from settled("without-overlays")
    evening()
    sky = part("scene.sky").sky
    yield from turns()
    began = yield from until(lambda: sky.latest() is not None)
    yield from settled("world")
    return {**facts, "sky": bool(began)}


def world(model):
    """The world through the camera in Rendered shading, and F12 of the same."""
    area, facts = yield from through_camera(model, 12)
    evening()
    sky = part("scene.sky").sky
    yield from turns()
    yield from until(lambda: sky.latest() is not None)
    yield from settled("world-rendered")
    yield from f12(area)
    bpy.data.images["Render Result"].save_render(os.path.abspath("world-f12.png"))
    return {**facts, "wheels": os.path.exists(sys.modules["numba"].__file__)}


def sparing(model):
    """Solid shading with a mesh: what redraws cost at rest, while the view turns and while the time changes; then the object is deleted."""
    scene = bring(model)
    scene.frame_set(12)
    area = area_of()
    space, view = area.spaces.active, area.spaces.active.region_3d
    space.shading.type = 'SOLID'
    view.view_location, view.view_distance = (0, 0, 0.6), 6.5
    wall = bpy.data.meshes.new("Wall")
    wall.from_pydata([(-3, 0, -1), (3, 0, -1), (3, 0, 3), (-3, 0, 3)], [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("Wall", wall))
    yield from settled("wall")
    shaders, spaces = part("engine.viewport.shaders"), part("engine.viewport.spaces")
    blended, read, counts = [], [], []
    splats, depth = shaders.splats, spaces.scene_depth

    def blending(*kind):
        blended.append(kind)
        counts.extend(count for count, *_ in drawn())
        return splats(*kind)

    shaders.splats = blending
    spaces.scene_depth = lambda *given: read.append(given) or depth(*given)
    facts = {}

    def redraw(times):
        blended.clear(), read.clear()
        with within(area):
            for _ in range(times):
                area.tag_redraw()
                bpy.ops.wm.redraw_timer(type='DRAW', iterations=1)
        return len(blended), len(read)

    facts["still"] = redraw(5)
    with within(area):
        for _ in range(4):
            view.view_rotation = view.view_rotation @ Euler((0, 0, 0.05)).to_quaternion()
            view.update()
            count = redraw(1)
            facts.setdefault("turning", []).append(count)
    yield from settled("turned")
    whole, frames = drawn()[0][0], itertools.cycle((13, 15, 17, 14))
    counts.clear()
    facts["scrubbing"] = []

    def scrubbed():
        scene.frame_set(next(frames))
        facts["scrubbing"].append(redraw(1))
        return min(counts) < 0.9 * whole  # the order of fewer may have been drawn between two frames

    facts["fewer"] = yield from until(scrubbed)
    scene.frame_set(12)
    yield from settled("scrubbed")
    facts["rested"] = [whole, drawn()[0][0], *redraw(3)]
    shaders.splats, spaces.scene_depth = splats, depth
    obj = next(o for o in scene.objects if o.fastgs.filepath)
    with within(area):
        bpy.ops.object.select_all(action='DESELECT')
        obj.select_set(True)
        bpy.ops.object.delete()
        bpy.ops.wm.redraw_timer(type='DRAW_WIN_SWAP', iterations=1)
    shot("deleted")
    yield from settled("nothing-left")
    return {**facts, **seen_by(area), "matrix": [list(row) for row in Matrix.Identity(4)]}
