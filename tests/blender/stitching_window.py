# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): Align by Pairs with the mouse."""
from __future__ import annotations

import bpy
from background import bring, look
from bpy_extras.view3d_utils import location_3d_to_region_2d as project
from mathutils import Euler, Matrix, Vector
from tools_window import drag
from window import area_of, press, settled, shot, turns, within


def pairs(model, corners):
    """Two objects that show one model: a click beside the view, and one that is taken back, do nothing; six put one on the other.

    corners  [3, 3]: places on the model's surface
    """
    scene = bring(model)
    look(scene, 640, 420)
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation, view.view_location, view.view_distance = Euler((0.7, 0, 0)).to_quaternion(), (2, 0, 0), 11.0
    fixed = next(o for o in scene.objects if o.fastgs.filepath)
    moving = fixed.copy()
    scene.collection.objects.link(moving)
    yield from turns()
    place = lambda x: Matrix.LocRotScale((x, 0.5, 0), Euler((0, 0, 0.3)), (0.8, 0.8, 0.8))  # noqa: E731
    region = next(region for region in area.regions if region.type == 'WINDOW')
    at_edge = [project(region, view, place(x) @ Vector(corners[1])).x for x in (3, 4)]
    moving.matrix_world = place(3 + (region.width - 30 - at_edge[0]) / (at_edge[1] - at_edge[0]))  # it goes on beside the view
    with within(area):
        bpy.ops.object.select_all(action='DESELECT')
    moving.select_set(True)
    fixed.select_set(True)
    bpy.context.view_layer.objects.active = fixed
    yield from settled("pairs-before")
    with within(area):
        bpy.ops.ed.undo_push(message="Two captures")
    name, before = moving.name, [list(row) for row in moving.matrix_world]
    sides = [[project(region, view, obj.matrix_world @ Vector(corner)) + Vector((region.x, region.y)) for obj in (moving, fixed)]
             for corner in corners]
    with within(area):
        bpy.ops.fastgs.align_pairs('INVOKE_DEFAULT')
    yield from turns()
    for at in (sides[1][0] + Vector((50, 0)), sides[1][0]):
        yield from drag([at, at])
    yield from press('BACK_SPACE', area)
    for number, at in enumerate(at for pair in sides for at in pair):
        yield from drag([at, at])
        if number == 3:
            shot("pairs-half")
    yield from settled("pairs-after")
    moved = [list(row) for row in bpy.data.objects[name].matrix_world]
    with within(area):
        bpy.ops.ed.undo()
    return {"moved": moved, "undone": [list(row) for row in bpy.data.objects[name].matrix_world] == before}
