# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that hide Gaussians for what they are."""
import bpy
from bpy.props import EnumProperty

from ..fastgs_blender.selecting.kinds import KINDS
from ..scene import objects
from .action import EDITABLE_SPLATS, Action, Remove, listed

PRESETS = [(key, kind.label, f"Begin with {kind.meaning}", number) for number, (key, kind) in enumerate(KINDS.items())]


class FASTGS_OT_add_filter(Action, bpy.types.Operator):
    """Hide or show Gaussians of the active object by size, opacity, speed, lifetime, colour or neighbours"""

    bl_idname = "fastgs.add_filter"
    bl_label = "Add Filter"
    needs = (EDITABLE_SPLATS,)

    preset: EnumProperty(name="Filter", description="What the filter begins with; every value can be changed", items=PRESETS)

    def act(self, context):
        found = KINDS[self.preset].filter(objects.load_model(objects.abspath(context.object)))
        item = context.object.fastgs.filters.add()
        item.kind, item.low, item.high, item.mode = found.kind, found.low, found.high, 'KEEP' if found.keep else 'HIDE'


class FASTGS_OT_remove_filter(Remove, bpy.types.Operator):
    """Remove this filter: what it hides is shown again"""

    bl_idname = "fastgs.remove_filter"
    bl_label = "Remove Filter"
    items, needs = "filters", listed("filters")
