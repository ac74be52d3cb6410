# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives splats an effect of Geometry Nodes."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..scene.splats import effects
from .action import EDITABLE_SPLATS, Action


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
