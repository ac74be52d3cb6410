# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): the ways in which users look at things."""
from __future__ import annotations

import sys

import bpy
from background import ADDON, bring, look
from mathutils import Euler, Vector
from window import area_of, press, seen_by, settled, turns, until, within


def drawn():
    """Of each viewport that shows splats: how many in its order, and the size of its picture."""
    viewports = sys.modules[f"{ADDON}.engine.viewport.spaces"].viewports
    return [(view._order[1].count, *view.picture.size) for view in viewports.views.values() if view._order]


def ways(model):
    """Two instances of a model, side by side; screenshots and facts of each way to look at them."""
    scene = bring(model)
    look(scene, 320, 210)
    scene.render.film_transparent = False
    scene.frame_set(12)
    first = next(o for o in scene.objects if o.fastgs.filepath)
    second = first.copy()
    second.location.x = 5.0
    scene.collection.objects.link(second)
    preferences = bpy.context.preferences.view
    preferences.smooth_view = 0
    area = area_of()
    space = area.spaces.active
    view = space.region_3d
    space.overlay.show_overlays = space.show_gizmo = False
    with within(area):  # a timer may have no window, and Blender crashes without one
        space.show_region_header = space.show_region_tool_header = space.show_region_toolbar = False
    space.shading.type = 'RENDERED'
    facts = {"start": first.fastgs.start_frame, "frame": 12, "second": list(second.location)}

    # from the front, orthographic: by its key
    yield from press('NUMPAD_1', area)
    view.view_location, view.view_distance = (2.5, 0, 0.7), 8.0
    yield from settled("front")
    facts["front"] = seen_by(area)

    # one of both alone, framed by its key
    bpy.ops.object.select_all(action='DESELECT')
    second.select_set(True)
    bpy.context.view_layer.objects.active = second
    with within(area):
        bpy.ops.view3d.localview(frame_selected=False)
    yield from press('NUMPAD_PERIOD', area)
    yield from settled("local")
    facts["local"] = seen_by(area)
    box = [second.matrix_world @ Vector(corner) for corner in second.bound_box]
    facts["framed"] = [list(view.view_location), [sum(c[i] for c in box) / 8 for i in range(3)]]
    with within(area):
        bpy.ops.view3d.localview(frame_selected=False)

    # four views, one of them free
    with within(area):
        bpy.ops.screen.region_quadview()
    yield from turns()
    for quad in space.region_quadviews:
        quad.view_location, quad.view_distance = (2.5, 0, 0.7), 9.0
    yield from settled("quad")
    windows = [region for region in area.regions if region.type == 'WINDOW']
    facts["quad"] = [seen_by(area, region, quad) for region, quad in zip(windows, space.region_quadviews)]
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=windows[-1]):
        bpy.ops.screen.region_quadview()
    yield from turns()

    # through the camera with a border to render
    view = space.region_3d
    view.view_perspective = 'PERSP'
    view.view_rotation = Euler((1.1, 0, 0)).to_quaternion()
    view.view_location, view.view_distance = (2.5, 0, 0.7), 9.0
    space.use_render_border = True
    space.render_border_min_x, space.render_border_min_y, space.render_border_max_x, space.render_border_max_y = 0.25, 0.25, 0.625, 0.75
    yield from settled("border")
    facts["border"] = seen_by(area)
    space.use_render_border = False

    # Solid, alone, through it, and its wires
    space.shading.type = 'SOLID'
    for name, shading, xray in (("solid-both", 'SOLID', False), ("xray", 'SOLID', True), ("wireframe", 'WIREFRAME', False)):
        space.shading.type = shading
        if shading == 'SOLID':
            space.shading.show_xray, space.shading.xray_alpha = xray, 0.5
        yield from settled(name)
    space.shading.type, space.shading.show_xray = 'SOLID', False
    scene.fastgs.show_splats = False
    first.hide_viewport = second.hide_viewport = True
    yield from settled("without")
    scene.fastgs.show_splats = True
    first.hide_viewport = second.hide_viewport = False

    # clicked at the edge of its box
    bpy.ops.object.select_all(action='DESELECT')
    from bpy_extras.view3d_utils import location_3d_to_region_2d as project

    space.overlay.show_overlays = True
    yield from settled("solid-again")
    region = next(region for region in area.regions if region.type == 'WINDOW')
    at = project(region, view, (box[0] + box[4]) / 2)
    with within(area):
        bpy.ops.view3d.select(location=(round(at.x), round(at.y)))
    facts["clicked"] = [obj.name for obj in bpy.context.view_layer.objects if obj.select_get()]
    facts["wanted"] = [second.name]

    # coarser, and fewer while it plays
    space.overlay.show_overlays = False
    space.shading.type = 'RENDERED'
    scene.fastgs.viewport_pixels = '4'
    yield from settled("coarse")
    facts["whole"] = drawn()
    scene.fastgs.viewport_density = 0.25
    with within(area):
        bpy.ops.screen.animation_play()
    yield from until(lambda: drawn()[0][0] < 0.5 * facts["whole"][0][0])
    facts["playing"] = drawn()
    with within(area):
        bpy.ops.screen.animation_cancel()
    yield from settled("rested")
    facts["rested"] = drawn()
    return facts
