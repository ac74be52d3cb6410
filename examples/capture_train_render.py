# SPDX-License-Identifier: GPL-3.0-or-later
"""An animated .blend becomes a model, and a picture of it from a new camera:  blender -b -P THIS -- SCENE.blend FOLDER"""
import sys
from pathlib import Path

import addon_utils
import bpy

blend, out = (Path(name).resolve() for name in sys.argv[-2:])
addon_utils.enable("bl_ext.user_default.fastgs_blender")  # as a module, Blender begins without extensions
bpy.ops.wm.open_mainfile(filepath=str(blend))
bpy.ops.fastgs.capture_scene(out=str(out / "capture"), count=12, width=640, height=480)
bpy.ops.fastgs.train(capture=str(out / "capture"), out=str(out / "model"), preset='DRAFT', wait=True)

scene, model = bpy.context.scene, bpy.context.object
for obj in scene.objects:
    obj.hide_render = obj != model
bpy.ops.fastgs.camera_orbit(new_camera=True)
scene.frame_set((scene.frame_start + scene.frame_end) // 2)
scene.render.engine, scene.render.filepath = 'FASTGS', str(out / "shot")
bpy.ops.render.render(write_still=True)
