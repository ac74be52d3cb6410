# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): ordinary operators on splats, clicks on them, and other engines' final renders."""
from __future__ import annotations

import os
from importlib import import_module

import bpy
from background import ADDON, bring, look
from mathutils import Euler, Vector
from window import area_of, press, seen_by, settled, turns, until, within


def operators(model):
    """Operators of the Object menu; a screenshot after each, from one side: nothing may have moved."""
    scene = bring(model)
    scene.render.film_transparent = False
    scene.frame_set(12)
    splats = next(o for o in scene.objects if o.fastgs.filepath)
    area = area_of()
    space, view = area.spaces.active, area.spaces.active.region_3d
    bpy.context.preferences.view.smooth_view = 0
    space.overlay.show_overlays = space.show_gizmo = False
    view.view_perspective = 'PERSP'
    view.view_rotation = Euler((1.1, 0, 0.3)).to_quaternion()
    view.view_location, view.view_distance = (0, 0, 0.7), 7.0
    splats.rotation_euler, splats.scale = (0.2, 0.1, 0.5), (1.2, 1.2, 1.2)
    facts = {"start": splats.fastgs.start_frame, "frame": 12}
    yield from settled("ordinary-before")
    facts["view"], facts["matrix"] = seen_by(area), [list(row) for row in splats.matrix_world]
    choose(splats)
    with within(area):
        bpy.ops.object.transform_apply('EXEC_DEFAULT', True)
    yield from settled("ordinary-applied")
    scene.cursor.location = (1, 1, 0)
    with within(area):
        bpy.ops.object.origin_set('EXEC_DEFAULT', True, type='ORIGIN_CURSOR')
    yield from settled("ordinary-origin")
    facts["origin"] = list(splats.matrix_world.translation)

    # joined with a cube that lies behind the view: both stay, and a pop-up says why
    with within(area):
        bpy.ops.mesh.primitive_cube_add(location=(3, -20, 0))
    cube = bpy.context.view_layer.objects.active
    cube.select_set(True)
    splats.select_set(True)
    bpy.context.view_layer.objects.active = splats
    with within(area):
        bpy.ops.object.join('EXEC_DEFAULT', True)
    yield from turns(10)
    facts["joined"] = sorted((o.name, len(o.data.polygons)) for o in scene.objects if o.type == 'MESH')
    yield from away(area)
    yield from settled("ordinary-joined")

    # points deleted in Edit Mode come back
    choose(splats)
    with within(area):
        bpy.ops.object.mode_set(mode='EDIT')
        bpy.ops.mesh.select_random(ratio=0.5)
        bpy.ops.mesh.delete(type='VERT')
        bpy.ops.object.mode_set(mode='OBJECT')
    yield from turns(10)
    yield from away(area)
    yield from settled("ordinary-edited")

    # clicked in the middle of the splats, in every shading
    compiling = import_module(f"{ADDON}.engine.compiling")
    yield from until(lambda: not compiling.is_running())  # before, a click finds no splats
    facts["clicked"] = {}
    yield from press('ESC', area)  # what is left of a pop-up would take the first click
    yield from click(area, (0.0, 0.0, 9.0))
    for shading in ('SOLID', 'MATERIAL', 'RENDERED'):
        space.shading.type = shading
        yield from settled(f"ordinary-{shading.lower()}")
        choose()
        yield from click(area, (0.0, 0.0, 0.02))
        facts["clicked"][shading] = [o.name for o in bpy.context.view_layer.objects if o.select_get()]
        yield from click(area, (0.0, 0.0, 9.0))
        facts["clicked"][f"{shading} beside"] = [o.name for o in bpy.context.view_layer.objects if o.select_get()]
    space.shading.type = 'SOLID'

    # hidden, shown, deleted: the picture follows
    splats.hide_set(True)
    yield from settled("ordinary-hidden")
    splats.hide_set(False)
    yield from settled("ordinary-shown")
    choose(splats)
    with within(area):
        bpy.ops.object.delete()
    yield from settled("ordinary-deleted")
    return facts


def choose(*objects):
    """Make these objects the selection."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)
    if objects:
        bpy.context.view_layer.objects.active = objects[0]


def away(area):
    """Move the mouse out of the way, which closes a pop-up."""
    window = bpy.context.window_manager.windows[0]
    for x in range(0, 300, 60):
        window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=area.x + area.width - 20 - x, y=area.y + 20)
        yield from turns()


def click(area, place):
    """A click with the left button where a place of the world is seen."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d as project

    region = next(region for region in area.regions if region.type == 'WINDOW')
    at = project(region, area.spaces.active.region_3d, Vector(place))
    x, y = region.x + round(at.x), min(region.y + round(at.y), region.y + region.height - 60)
    window = bpy.context.window_manager.windows[0]
    window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=x, y=y)
    yield from turns()
    for value in ('PRESS', 'RELEASE'):
        window.event_simulate(type='LEFTMOUSE', value=value, x=x, y=y)
        yield from turns()
    yield from turns()


def engines(model, frames):
    """Final renders of other engines; the pictures are named after the engine and the frame."""
    scene = bring(model)
    facts = {"camera": look(scene, 160, 104)}
    scene.render.film_transparent = True
    scene.render.image_settings.file_format = 'PNG'
    scene.render.image_settings.color_mode = 'RGBA'
    known = bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items.keys()
    facts["start"] = next(o for o in scene.objects if o.fastgs.filepath).fastgs.start_frame
    eevee = next((name for name in ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE") if name in known), "BLENDER_EEVEE")
    for engine, name in (("BLENDER_WORKBENCH", "workbench"), ("CYCLES", "cycles"), (eevee, "eevee")):
        scene.render.engine = engine
        if engine == 'CYCLES':
            scene.cycles.samples, scene.cycles.use_denoising = 4, False
        elif name == "eevee":
            scene.eevee.taa_render_samples = 1
        for frame in frames:
            scene.frame_set(int(frame), subframe=frame % 1)
            scene.render.filepath = os.path.abspath(f"engine-{name}-{frame:g}.png")
            bpy.ops.render.render(write_still=True)
        yield from turns(1)
    return facts
