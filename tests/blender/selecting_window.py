# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): selecting things by clicks and keys, Clean Up, and Delete for Good."""
from __future__ import annotations

import os
from importlib import import_module

import bpy
from background import ADDON, bring, look
from mathutils import Euler
from tools_window import choose, drag, splat
from window import area_of, press, seen_by, settled, shot, until, within


def selected():
    """How many Gaussians are selected."""
    return int(import_module(f"{ADDON}.scene.selection").bits(splat(), "selection").sum())


def things(model):
    """In one window: each tool by what is seen and through; a click on a thing and its undo; strokes and L; keys; Clean Up; a new file."""
    scene = bring(model)
    look(scene, 640, 420)
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation, view.view_location, view.view_distance = Euler((1.1, 0, 0.3)).to_quaternion(), (0, 0, 0.6), 6.0
    scene.frame_set(12)
    yield from settled("things-before")
    with within(area):
        bpy.ops.ed.undo_push(message="Imported")
    bpy.context.view_layer.objects.active = splat()
    region = next(region for region in area.regions if region.type == 'WINDOW')
    middle = region.x + region.width / 2, region.y + region.height / 2
    at = lambda *places: [(middle[0] + dx, middle[1] + dy) for dx, dy in places]  # noqa: E731
    facts = {"frame": scene.frame_current - splat().fastgs.start_frame, **seen_by(area), "selections": {}}

    def keep(name):
        facts["selections"][name] = splat().fastgs.selection

    for tool, way in (("box", ((-60, 0), (60, 90))), ("lasso", ((-70, -10), (60, 0), (50, 80), (-50, 90))),
                      ("brush", ((-40, 30), (0, 40), (40, 30))), ("ball", ((0, 40), (40, 40)))):
        yield from choose(f"fastgs.select_{tool}", area)
        for through in (False, True):
            scene.fastgs.select_through = through
            yield from drag(at(*way))
            keep(f"{tool} {'through' if through else 'seen'}")
        shot(f"things-{tool}")
    scene.fastgs.select_through = False
    yield from press('X', area)
    facts["erased"] = splat().fastgs.mask
    shot("things-erased")
    with within(area):
        bpy.ops.ed.undo()
    yield from choose("fastgs.select_thing", area)
    before = splat().fastgs.selection
    yield from drag(at((0, 40), (0, 40)))
    facts["click grown"] = yield from until(lambda: selected() > 20)  # it touches six
    yield from settled("things-clicked")
    keep("clicked")
    with within(area):
        bpy.ops.ed.undo()
    facts["one step"] = splat().fastgs.selection == before
    yield from press('E', area)
    facts["shown erased"] = bpy.context.window_manager.fastgs.show_erased
    yield from choose("fastgs.select_brush", area)
    bpy.context.scene.fastgs.brush_radius = 12
    yield from drag(at((-70, -120), (0, -125), (70, -120)))
    yield from drag(at((-40, 20), (0, 60), (40, 30)), ctrl=True)
    keep("strokes")
    facts["refused"] = splat().fastgs.refused
    count = selected()
    yield from press('L', area)
    facts["grown by key"] = yield from until(lambda: selected() > 2 * count)
    keep("disc")
    yield from settled("things-grown")
    yield from press('X', area)
    facts["disc erased"] = splat().fastgs.mask
    yield from settled("things-shown-erased")
    with within(area):
        bpy.ops.fastgs.clean_up(strength=1.0)
    facts["cleaned"] = splat().fastgs.mask
    bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'
    target = os.path.abspath("things-left.safetensors")
    with within(area):
        bpy.ops.fastgs.delete_for_good('INVOKE_DEFAULT', filepath=target)
    facts["asks"] = yield from until(lambda: any(a.type == 'FILE_BROWSER' for a in bpy.context.window_manager.windows[0].screen.areas))
    yield from settled("things-asks")
    browser = area_of('FILE_BROWSER')
    facts["proposed"] = browser.spaces.active.params.filename
    browser.spaces.active.params.filename = os.path.basename(target)
    with within(browser):
        bpy.ops.file.execute()
    facts["written"] = yield from until(lambda: os.path.exists(target) and not splat().fastgs.mask)
    facts["kept"] = os.path.exists(model)
    facts["left"] = splat().fastgs.gaussian_count
    yield from settled("things-left")
    return facts
