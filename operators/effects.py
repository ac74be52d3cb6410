# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives splats an effect of Geometry Nodes."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..scene import objects
from ..scene.splats import effects


class FASTGS_OT_add_effect(bpy.types.Operator):
    """Add a modifier of Geometry Nodes that changes the active object's Gaussians, all of which become points; its values can be keyed"""

    bl_idname = "fastgs.add_effect"
    bl_label = "Add Effect"
    bl_options = {'REGISTER', 'UNDO'}

    effect: EnumProperty(
        name="Effect", description="What happens to the Gaussians",
        items=tuple((key, effect.label, effect.description, number) for number, (key, effect) in enumerate(effects.EFFECTS.items())))

    @classmethod
    def poll(cls, context):
        return context.object is not None and objects.is_splat(context.object) and context.object.is_editable

    def execute(self, context):
        modifier = effects.add(context.object, self.effect)
        context.object.modifiers.active = modifier
        return {'FINISHED'}


CLASSES = (FASTGS_OT_add_effect,)
