# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on how an object shows its splats: as the file says, and with an effect of Geometry Nodes."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..fastgs_blender.rendering.instances import LOOKS
from ..scene import objects
from ..scene.splats import effects
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


class FASTGS_OT_add_effect(Action, bpy.types.Operator):
    """Add a modifier of Geometry Nodes that changes the active object's Gaussians, all of which become points; its values can be keyed"""

    bl_idname = "fastgs.add_effect"
    bl_label = "Add Effect"
    needs = (EDITABLE_SPLATS,)

    effect: EnumProperty(
        name="Effect", description="What happens to the Gaussians",
        items=tuple((key, effect.label, effect.description, number) for number, (key, effect) in enumerate(effects.EFFECTS.items())))

    def act(self, context):
        context.object.modifiers.active = effects.add(context.object, self.effect)
