# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives splat objects a copy which other engines render."""
import bpy
from bpy.props import EnumProperty

from ..scene import objects
from ..scene.splats import native
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action


def _kinds(self, context):
    _kinds.items = native.kinds()  # Blender does not keep the strings
    return _kinds.items


class FASTGS_OT_native_copy(Action, bpy.types.Operator):
    """Make an object beside this one that holds what it shows on each frame, for EEVEE and Cycles; the file does not grow"""

    bl_idname = "fastgs.native_copy"
    bl_label = "Native Copy"
    needs = (OBJECT_MODE, EDITABLE_SPLATS)

    kind: EnumProperty(name="As", description="What the copy is made of", items=_kinds)

    def act(self, context):
        objects.source_of(context.object)  # which says what is wrong with it
        copy = native.make(context, context.object, self.kind)
        return f'"{copy.name}" follows "{context.object.name}"; other engines render it in place of its points'
