# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's range and frame rate from a capture."""
from __future__ import annotations

from math import ceil

import bpy

from ..scene.objects import is_splat


def frame_rate(fps: float) -> tuple[int, float]:
    """Blender's way to write any frame rate: a whole number and what it is divided by."""
    whole = min(max(round(fps), 1), 32767)
    return whole, whole / fps


def fit_scene(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Give the scene the frame rate of the object's capture, and a range in which its clip plays once."""
    settings = obj.fastgs
    scene.render.fps, scene.render.fps_base = frame_rate(settings.fps)
    speed = settings.speed or 1.0
    frames = (settings.frame_count - settings.offset) if speed > 0 else (settings.frame_count + settings.offset)
    start = max(round(settings.start_frame), 0)
    scene.frame_start = start
    scene.frame_end = start + max(ceil(frames / abs(speed)), 1) - 1


class FASTGS_OT_fit_scene(bpy.types.Operator):
    """Set the scene's first and last frame and its frame rate from the active object's capture"""

    bl_idname = "fastgs.fit_scene"
    bl_label = "Fit Scene to Capture"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        obj = context.object
        return obj is not None and is_splat(obj) and obj.fastgs.frame_count > 0 and obj.fastgs.fps > 0

    def execute(self, context):
        fit_scene(context.scene, context.object)
        return {'FINISHED'}
