# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories of captures in Blender's window (see inside.py and window.py): chosen in a full-screen file browser, corrected, scaled."""
from __future__ import annotations

import os
import threading

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d as project
from mathutils import Euler, Vector
from training_window import part
from window import area_of, press, settled, shot, sidebar, turns, until, within


def kinds():
    """The kinds of the window's areas."""
    return sorted(area.type for area in bpy.context.window_manager.windows[0].screen.areas)


def from_browser_to_frusta(capture):
    """Import Capture Cameras through Blender's full-screen browser; the view is turned meanwhile; frusta before and after Set Scale."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'
    yield from turns()
    area = area_of()
    yield from sidebar(area)
    before = kinds()
    with within(area):
        bpy.ops.fastgs.import_capture('INVOKE_DEFAULT')
    yield from turns(10)
    browser = area_of('FILE_BROWSER')
    full = kinds()
    browser.spaces.active.params.directory = f"{os.path.abspath(capture)}/".encode()
    yield from turns(10)
    undistorted = part("scene.cameras.undistorted")
    save, told, event = undistorted._save, [], threading.Event()

    def slowly(file, pixels):
        told.append(file.name)
        if len(told) > 6:
            event.wait()
        save(file, pixels)

    undistorted._save = slowly
    yield from press('RET', browser)
    yield from until(lambda: len(told) > 6)
    yield from turns()
    during = kinds()
    area = area_of()
    turn = area.spaces.active.region_3d.view_rotation.copy()
    yield from press('NUMPAD_6', area)
    turned = yield from until(lambda: turn.rotation_difference(area_of().spaces.active.region_3d.view_rotation).angle > 0.1)
    with within(area):
        bpy.ops.object.empty_add(location=(0, 0, -9))  # the scene may be edited, too
    shot("correcting")
    event.set()
    yield from until(lambda: any(obj.type == 'CAMERA' for obj in bpy.context.scene.objects))
    undistorted._save = save
    yield from turns()
    facts = {"before": before, "full": full, "during": during, "turned": turned, "frusta": {}}
    yield from settled("captured")
    bpy.context.scene.fastgs.show_pictures = True
    for name, scale in (("frusta", 1.0), ("frusta-scaled", 0.5)):
        facts["frusta"][name] = yield from frusta(name, scale)
    return facts


def frusta(name, scale):
    """Screenshots of the cameras' frusta without and with pictures; where the far corners of the first are on the screen, if they grow
    with the cameras as Blender's do."""
    scene = bpy.context.scene
    world = next(obj for obj in scene.objects if obj.type == 'EMPTY' and obj.children)
    world.scale = (scale,) * 3
    bpy.context.view_layer.update()
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_perspective = 'PERSP'
    view.view_rotation = Euler((1.2, 0, 0.35)).to_quaternion()
    view.view_location, view.view_distance = scale * Vector((0, -3.1, 0.8)), 4.0 * scale
    area.spaces.active.show_region_ui = False
    for obj in scene.objects:
        obj.select_set(False)
        if obj.type == 'CAMERA':
            obj.data.display_size = 0.9
    places = {}
    for shown in (False, True):
        scene.fastgs.show_pictures = shown
        area.tag_redraw()
        yield from settled(f"{name}-{'pictures' if shown else 'wires'}")
    region = next(region for region in area.regions if region.type == 'WINDOW')
    plane = part("engine.viewport.frusta").plane
    height = bpy.context.window_manager.windows[0].height
    for obj in scene.objects:
        if obj.type == 'CAMERA':
            matrix = obj.matrix_world.normalized()
            corners = [project(region, view, matrix @ Vector(corner)) for corner in plane(obj.data, scene, scale)]
            places[obj.name] = [[region.x + at.x, height - (region.y + at.y)] for at in corners]
    return places
