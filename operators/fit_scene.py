# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit Scene to Capture: the scene's range and frame rate from the active object's capture."""
from __future__ import annotations

import bpy

from ..scene.frame_range import fit_scene
from ..scene.objects import is_splat


class FASTGS_OT_fit_scene(bpy.types.Operator):
    """Set the scene's first and last frame and its frame rate from the active object's capture"""

    bl_idname = "fastgs.fit_scene"
    bl_label = "Fit Scene to Capture"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        obj = context.object
        return obj is not None and is_splat(obj) and obj.fastgs.frame_count > 1

    def execute(self, context):
        fit_scene(context.scene, context.object)
        return {'FINISHED'}
