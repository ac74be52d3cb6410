# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): what of the proxies' points each redraw of the 3D view has, beside what the view shows."""
from __future__ import annotations

import bpy
from background import bring
from mathutils import Euler
from window import area_of, seen_by, settled, turns, until, within


def watched(model):
    """An import, Wireframe entered from a view that moves, and back; then without splats, under two engines, and with them again.

    Returns [whether points were there] of all redraws in each part.
    """
    parts = {}

    def look():
        context = bpy.context
        depsgraph = context.evaluated_depsgraph_get()
        for obj in context.scene.objects:
            if obj.fastgs.filepath:
                mesh = obj.evaluated_get(depsgraph).data
                now.append(len(mesh.polygons) > 0)

    def part(name):
        return parts.setdefault(name, [])

    now = part("import")
    handler = bpy.types.SpaceView3D.draw_handler_add(look, (), 'WINDOW', 'PRE_VIEW')
    scene = bring(model)
    area = area_of()
    space, view = area.spaces.active, area.spaces.active.region_3d
    space.shading.type = 'SOLID'
    view.view_location, view.view_distance = (0, 0, 0.6), 6.5
    yield from settled("stand-ins-solid")

    def turn(times):
        with within(area):
            for _ in range(times):
                view.view_rotation = view.view_rotation @ Euler((0, 0, 0.05)).to_quaternion()
                view.update()
                area.tag_redraw()
                bpy.ops.wm.redraw_timer(type='DRAW_WIN_SWAP', iterations=1)

    turn(3)
    now = part("wireframe")
    space.shading.type = 'WIREFRAME'
    turn(2)
    yield from settled("stand-ins-wireframe")
    now = part("solid again")
    space.shading.type = 'SOLID'
    turn(2)
    yield from settled("stand-ins-solid-again")
    now = part("without splats")
    scene.fastgs.show_splats = False
    yield from until(lambda: now and now[-1])
    yield from settled("stand-ins-without")
    scene.render.engine, scene.cycles.preview_samples = 'CYCLES', 2
    scene.view_settings.view_transform = 'Standard'
    space.shading.type = 'RENDERED'
    yield from settled("stand-ins-cycles")
    facts = seen_by(area)
    space.shading.type = 'SOLID'
    yield from turns()
    now = part("with splats again")
    scene.fastgs.show_splats = True
    yield from settled("stand-ins-with")
    bpy.types.SpaceView3D.draw_handler_remove(handler, 'WINDOW')
    return {**facts, "parts": parts}
