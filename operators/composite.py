# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that lets another engine render the meshes beside the splats."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..scene import composite


def _engines(self, context):
    _engines.items = composite.engines()  # Blender does not keep the strings
    return _engines.items


class FASTGS_OT_set_up_composite(bpy.types.Operator):
    """Render meshes with Cycles or EEVEE in a scene of their own and join them with the splats by depth; press it again after changes"""

    bl_idname = "fastgs.set_up_composite"
    bl_label = "Set Up Composite"
    bl_options = {'REGISTER', 'UNDO'}

    engine: EnumProperty(name="Engine", description="What renders the meshes", items=_engines)

    @classmethod
    def poll(cls, context):
        if context.scene.render.engine != 'FASTGS':
            cls.poll_message_set("the scene is not rendered by FAST-GS")
            return False
        return True

    def execute(self, context):
        other = composite.set_up(context.scene, context.view_layer, self.engine)
        self.report({'INFO'}, f'The scene "{other.name}" renders the meshes; the compositor joins them with the splats')
        return {'FINISHED'}


CLASSES = (FASTGS_OT_set_up_composite,)
