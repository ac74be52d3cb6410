# SPDX-License-Identifier: GPL-3.0-or-later
"""A story in Blender's window (see inside.py): numbered files that were chosen together, played, scrubbed and rendered."""
from __future__ import annotations

import os
import sys

import bpy
from background import ADDON, bring, look
from window import area_of, press, seen_by, settled, sidebar, until, within


def playing(folder, names, beside):
    """A sequence of files beside a still model: screenshots of frames, what played, what is kept in memory, and F12 of a frame."""
    scene = bring(beside)
    still = next(o for o in scene.objects if o.fastgs.filepath)
    still.location, still.hide_render = (5.0, 0, 0), True
    bpy.ops.import_scene.fastgs(directory=os.path.abspath(folder), files=[{"name": name} for name in names], use_engine=True,
                                set_scene_range=True)
    made = [o for o in scene.objects if o.fastgs.filepath and o is not still]
    facts = {"made": [o.fastgs.filepath for o in made], "range": [scene.frame_start, scene.frame_end], "views": {}, "kept": []}
    camera = look(scene, 200, 140, target=(0, 0, 0.9))
    scene.render.film_transparent = False
    bpy.context.preferences.view.smooth_view = 0
    area = area_of()
    space = area.spaces.active
    space.overlay.show_overlays = space.show_gizmo = False
    with within(area):
        space.show_region_header = space.show_region_tool_header = space.show_region_toolbar = False
    space.shading.type = 'RENDERED'
    yield from press('NUMPAD_1', area)
    space.region_3d.view_location, space.region_3d.view_distance = (2.0, 0, 0.9), 9.0

    # frames in any order; the file of each is what is seen
    for offset in (2, len(names) - 1, 5):
        scene.frame_set(scene.frame_start + offset)
        yield from settled(f"sequence-{offset}")
        facts["views"][str(offset)] = seen_by(area)

    # played twice around, with what is kept in memory
    sequence, spaces = (sys.modules[f"{ADDON}.{name}"] for name in ("fastgs_blender.model.sequence", "engine.viewport.spaces"))
    seen, drawn = set(), set()

    def note(*_):
        seen.add(scene.frame_current)
        facts["kept"].append(sequence.cache.nbytes())
        drawn.update(len(view._answer.instances[-1].model) for view in spaces.viewports.views.values() if view._answer)

    bpy.app.handlers.frame_change_post.append(note)
    scene.sync_mode = 'NONE'  # every frame
    with within(area):
        bpy.ops.screen.animation_play()
    yield from until(lambda: len(facts["kept"]) > 2 * len(names))
    with within(area):
        bpy.ops.screen.animation_cancel()
    bpy.app.handlers.frame_change_post.remove(note)
    facts |= {"seen": sorted(seen), "drawn": sorted(drawn), "limit": sequence.cache.limit}
    scene.frame_set(scene.frame_start + 7)
    yield from settled("sequence-7")
    facts["views"]["7"] = seen_by(area)

    # what its panel says
    made[0].select_set(True)
    bpy.context.view_layer.objects.active = made[0]
    yield from sidebar(area)
    yield from settled("sequence-panel")

    # F12
    facts |= {"camera": camera, "rendered": 9}
    scene.frame_set(scene.frame_start + 9)
    scene.render.filepath = os.path.abspath("sequence-f12.png")
    bpy.ops.render.render(write_still=True)
    return facts
