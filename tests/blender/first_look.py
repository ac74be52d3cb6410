# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): the first minute of a newcomer, in Blender's own startup file."""
from __future__ import annotations

from importlib import import_module

import bpy
from background import ADDON
from window import area_of, press, seen_by, settled, sidebar, turns, within


def seen():
    """What the 3D view shows, the default file's cube as it is, and the view transform."""
    scene, view = bpy.context.scene, area_of().spaces.active.region_3d
    return {**seen_by(area_of()), "cube": [scene.objects["Cube"].hide_get(), scene.objects["Cube"].hide_render],
            "transform": scene.view_settings.view_transform, "location": list(view.view_location), "distance": view.view_distance}


def newcomer():
    """File > Import > Example, and nothing else; Rendered shading; the button for colours; Numpad-period and Home."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield from turns()
    area = area_of()
    bpy.context.preferences.view.smooth_view = 0
    with within(area):
        bpy.ops.fastgs.import_example('EXEC_DEFAULT')
    yield from settled("first-solid")
    facts = {"solid": seen(), "frame": bpy.context.scene.frame_current - bpy.context.object.fastgs.start_frame}
    yield from sidebar(area)
    area.spaces.active.shading.type = 'RENDERED'
    yield from settled("first-rendered")
    facts["rendered"] = seen()
    bpy.ops.fastgs.use_standard()
    area.spaces.active.overlay.show_overlays = False  # their lines run over the splats
    yield from settled("first-standard")
    facts["standard"] = seen()
    area.spaces.active.overlay.show_overlays = True
    for key, name in (('NUMPAD_PERIOD', "period"), ('HOME', "home")):
        yield from press(key, area)
        yield from settled(f"first-{name}")
        facts[name] = seen()
    with within(area):
        bpy.ops.fastgs.set_upright('INVOKE_DEFAULT')
    yield from settled("first-upright")
    return facts


def preferences():
    """Our preferences, as Blender draws them, in the place of the 3D view."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield from turns()
    area = area_of()
    area.ui_type = 'PREFERENCES'
    bpy.context.preferences.active_section = 'ADDONS'
    bpy.data.window_managers[0].addon_search = "FAST-GS"
    with within(area):
        bpy.ops.preferences.addon_expand(module=ADDON)
    yield from settled("first-preferences")
    guide = import_module(f"{ADDON}.scene.pages").path("guide")
    return {"guide": guide.name, "words": guide.read_text("utf-8").count("FAST-GS")}
