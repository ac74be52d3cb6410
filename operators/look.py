# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that puts an object's look back to what its file says."""
import bpy

from ..fastgs_blender.rendering.instances import LOOKS
from ..scene import objects
from .action import EDITABLE_SPLATS, Action


class FASTGS_OT_reset_look(Action, bpy.types.Operator):
    """Show the selected splat objects as their files say; keys of their looks stay"""

    bl_idname = "fastgs.reset_look"
    bl_label = "Reset Look"
    needs = (EDITABLE_SPLATS,)

    def act(self, context):
        for obj in {context.object, *context.selected_editable_objects}:
            if objects.is_splat(obj):
                for name in (*LOOKS, "antialias"):
                    obj.fastgs.property_unset(name)
                obj.update_tag()
