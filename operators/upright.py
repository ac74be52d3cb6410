# SPDX-License-Identifier: GPL-3.0-or-later
"""Up Axis: which axis of a splat object's file points up."""
import bpy
from bpy.props import EnumProperty

from ..scene import upright
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action, Need

SIGNS = {'POS': ("+", "positive"), 'NEG': ("-", "negative")}
AXES = [(axis, SIGNS[axis[:3]][0] + axis[-1], f"The file's {SIGNS[axis[:3]][1]} {axis[-1]} axis points up", number)
        for number, axis in enumerate(upright.TURNS, 1)]


class FASTGS_OT_set_upright(Action, bpy.types.Operator):
    """Choose which axis of the active splat object's file points up; the object's own location, rotation and scale stay as they are"""

    bl_idname = "fastgs.set_upright"
    bl_label = "Up Axis"
    needs = (EDITABLE_SPLATS, OBJECT_MODE, Need(lambda context: context.object.type == 'MESH' and context.object.data.is_editable,
                                                "The object's mesh cannot be changed"))

    axis: EnumProperty(
        name="Up", description="The axis of the file that points up",
        items=[('FILE', "As in File", "What the file says, or what is usual in its format", 0), *AXES], default='FILE')

    def invoke(self, context, event):
        """A popup in which each axis shows at once, in the view, what it does."""
        self.axis = upright.axis_of(context.object)
        return context.window_manager.invoke_props_popup(self, event)

    def draw(self, context):
        layout = self.layout
        layout.label(text="Which axis of the file points up?")
        layout.prop_enum(self, "axis", 'FILE')
        for sign in SIGNS:
            row = layout.row(align=True)
            for letter in "XYZ":
                row.prop_enum(self, "axis", f"{sign}_{letter}")

    def act(self, context):
        obj = context.object
        upright.set_upright(obj, upright.recorded_axis(obj) if self.axis == 'FILE' else self.axis)
