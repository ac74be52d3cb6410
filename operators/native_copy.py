# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that gives splat objects a copy which other engines render."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects
from ..scene.splats import native
from ..scene.splats.splat_object import sentence


def _kinds(self, context):
    _kinds.items = native.kinds()  # Blender does not keep the strings
    return _kinds.items


class FASTGS_OT_native_copy(bpy.types.Operator):
    """Make an object beside this one that holds what it shows on each frame, for EEVEE and Cycles; the file does not grow"""

    bl_idname = "fastgs.native_copy"
    bl_label = "Native Copy"
    bl_options = {'REGISTER', 'UNDO'}

    kind: EnumProperty(name="As", description="What the copy is made of", items=_kinds)

    @classmethod
    def poll(cls, context):
        return context.mode == 'OBJECT' and objects.is_splat(context.object) and context.object.is_editable

    def execute(self, context):
        try:
            objects.load_model(objects.abspath(context.object))
        except FastGSError as error:
            self.report({'ERROR'}, sentence(error))
            return {'CANCELLED'}
        copy = native.make(context, context.object, self.kind)
        self.report({'INFO'}, f'"{copy.name}" follows "{context.object.name}"; other engines render it in place of its points')
        return {'FINISHED'}


CLASSES = (FASTGS_OT_native_copy,)
