# SPDX-License-Identifier: GPL-3.0-or-later
"""New Camera from View: a camera that sees what the 3D view shows."""
from __future__ import annotations

import bpy
from bpy.props import EnumProperty

from ..scene.cameras.from_view import camera_from_view, take_shape


class FASTGS_OT_camera_from_view(bpy.types.Operator):
    """Make a camera here: it sees what this 3D view shows, becomes the scene's camera, and the view looks through it"""

    bl_idname = "fastgs.camera_from_view"
    bl_label = "New Camera from View"
    bl_options = {'REGISTER', 'UNDO'}

    shape: EnumProperty(
        name="Picture", description="The shape of the picture",
        items=(
            ('SCENE', "As in the Scene", "The resolution stays. All of the view is in the picture, and more at two of its sides", 0),
            ('VIEW', "As the View", "The resolution changes, so that the picture ends where the view does", 1),
        ), default='SCENE')

    @classmethod
    def poll(cls, context):
        if context.mode != 'OBJECT' or context.space_data is None or context.space_data.type != 'VIEW_3D':
            cls.poll_message_set("Works in a 3D view, in Object Mode")
            return False
        return context.region_data is not None

    def execute(self, context):
        area, view = context.area, context.region_data
        if self.shape == 'VIEW' and view.view_perspective != 'CAMERA':
            take_shape(context.scene.render, area)
        camera = camera_from_view(context, area, view)
        for other in context.selected_objects:
            other.select_set(False)
        camera.select_set(True)
        context.view_layer.objects.active = camera
        view.view_perspective = 'CAMERA'
        self.report({'INFO'}, f'"{camera.name}" is the scene\'s camera now; it sees what the view showed')
        return {'FINISHED'}


CLASSES = (FASTGS_OT_camera_from_view,)
