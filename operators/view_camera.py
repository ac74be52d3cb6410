# SPDX-License-Identifier: GPL-3.0-or-later
"""New Camera from View: a camera that sees what the 3D view shows."""
import bpy
from bpy.props import EnumProperty

from ..scene import objects
from ..scene.cameras.from_view import camera_from_view, take_shape
from .action import IN_VIEW, OBJECT_MODE, Action


class FASTGS_OT_camera_from_view(Action, bpy.types.Operator):
    """Make a camera here: it sees what this 3D view shows, becomes the scene's camera, and the view looks through it"""

    bl_idname = "fastgs.camera_from_view"
    bl_label = "New Camera from View"
    needs = (OBJECT_MODE, IN_VIEW)

    shape: EnumProperty(
        name="Picture", description="The shape of the picture",
        items=(
            ('SCENE', "As in the Scene", "The resolution stays. All of the view is in the picture, and more at two of its sides", 0),
            ('VIEW', "As the View", "The resolution changes, so that the picture ends where the view does", 1),
        ), default='SCENE')

    def act(self, context):
        area, view = context.area, context.region_data
        if self.shape == 'VIEW' and view.view_perspective != 'CAMERA':
            take_shape(context.scene.render, area)
        camera = camera_from_view(context, area, view)
        objects.select_only(context, camera)
        view.view_perspective = 'CAMERA'
        return f'"{camera.name}" is the scene\'s camera now; it sees what the view showed'
