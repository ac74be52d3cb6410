# SPDX-License-Identifier: GPL-3.0-or-later
"""A story of baking in Blender's window (see inside.py and window.py): through the file browser, with stages that are told."""
from __future__ import annotations

import os

import bpy
from mathutils import Euler
from on_gpu import matter, part
from window import area_of, press, seen_by, settled, shot, turns, until, within

FRAMES = 24


def flag():
    """Two stripes that wave: a grid with a border of two materials, and a fast corner."""
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.engine = 1, FRAMES, 'FASTGS'
    scene.view_settings.view_transform = 'Standard'
    with within(area_of()):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=40, size=2, rotation=(1.3, 0, 0), location=(0, 0, 1))
        obj = bpy.context.object
        bpy.ops.object.shade_smooth()
    obj.scale.x = 1.5
    for name, colour in (("Red", (0.8, 0.05, 0.05)), ("White", (0.9, 0.9, 0.9))):
        obj.data.materials.append(matter(name, colour))
    for face in obj.data.polygons:
        face.material_index = int(face.center.y > 0)
    wave = obj.modifiers.new("Wave", 'WAVE')
    wave.use_y, wave.height, wave.width, wave.speed, wave.time_offset = False, 0.3, 0.6, 0.08, -60
    obj.name = "Flag"
    return scene, obj


def from_mesh_to_splats():
    """Object > Bake to 4D Gaussians; what the status bar says meanwhile, whether the view turns, and what is there afterwards."""
    scene, obj = flag()
    bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'
    yield from turns()
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_perspective = 'PERSP'
    view.view_rotation, view.view_distance = Euler((1.2, 0, 0.3)).to_quaternion(), 4.5
    view.view_location = (0, 0, 1)
    with within(area):
        bpy.ops.fastgs.bake('INVOKE_DEFAULT', filepath=os.path.abspath("flag.safetensors"), count=30_000, hide_source=True)
    yield from turns(10)
    stepwise, told = part("operators.stepwise").Stepwise, []
    show = stepwise._show

    def listening(self, context, done, whole, stage=""):
        told.append((stage, done))
        show(self, context, done, whole, stage)

    stepwise._show = listening
    yield from press('RET', area_of('FILE_BROWSER'))
    yield from until(lambda: any("fitting" in stage for stage, _ in told))
    shot("baking")
    yield from until(lambda: any(o.fastgs.filepath for o in scene.objects))
    stepwise._show = show
    scene.frame_set(14)
    area = area_of()
    area.spaces.active.overlay.show_overlays = area.spaces.active.show_gizmo = False
    area.spaces.active.shading.type = 'RENDERED'
    view = area.spaces.active.region_3d
    view.view_rotation, view.view_distance = Euler((1.2, 0, 0.3)).to_quaternion(), 4.5
    view.view_location = (0, 0, 1)
    yield from settled("baked")
    return {"told": told, "hidden": [obj.hide_get(), obj.hide_render], "frame": 14, **seen_by(area)}
