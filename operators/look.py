# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that puts an object's look back to what its file says."""
from __future__ import annotations

import bpy

from ..fastgs_blender.rendering.instances import LOOKS
from ..scene import objects


class FASTGS_OT_reset_look(bpy.types.Operator):
    """Show the selected splat objects as their files say; keys of their looks stay"""

    bl_idname = "fastgs.reset_look"
    bl_label = "Reset Look"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return objects.is_splat(context.object) and context.object.is_editable

    def execute(self, context):
        for obj in {context.object, *context.selected_editable_objects}:
            if objects.is_splat(obj):
                for name in (*LOOKS, "antialias"):
                    obj.fastgs.property_unset(name)
                obj.update_tag()
        return {'FINISHED'}


CLASSES = (FASTGS_OT_reset_look,)
