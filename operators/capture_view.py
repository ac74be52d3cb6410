# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that show a capture from a good side, and store such a side in its file."""
from __future__ import annotations

import bpy
from bpy.props import IntProperty

from ..fastgs_blender.formats.annotate import annotate
from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects
from ..scene.cameras import framing
from ..scene.splats import splat_object


def _splat(context) -> bool:
    return context.object is not None and objects.is_splat(context.object)


class FASTGS_OT_frame_capture(bpy.types.Operator):
    """Show the active splat object in the 3D views: as its file's author wants it, from where it was filmed, or framed from this side"""

    bl_idname = "fastgs.frame_capture"
    bl_label = "Frame Capture"

    @classmethod
    def poll(cls, context):
        return _splat(context)

    def execute(self, context):
        try:
            shown = framing.show(context, [context.object])
        except FastGSError as error:
            self.report({'ERROR'}, splat_object.sentence(error))
            return {'CANCELLED'}
        if not shown:
            self.report({'WARNING'}, "No 3D view is open that does not look through a camera")
            return {'CANCELLED'}
        return {'FINISHED'}


class FASTGS_OT_look_through(bpy.types.Operator):
    """Make a camera where one stood that filmed the capture, and look through it"""

    bl_idname = "fastgs.look_through"
    bl_label = "Look through a Capture Camera"
    bl_options = {'REGISTER', 'UNDO'}

    index: IntProperty(name="Camera", description="Number of the camera, as the file lists them; -1: the one in their middle",
                       default=-1, min=-1)

    @classmethod
    def poll(cls, context):
        return _splat(context)

    def execute(self, context):
        try:
            camera = framing.look_through(context, context.object, None if self.index < 0 else self.index)
        except FastGSError as error:
            self.report({'ERROR'}, splat_object.sentence(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f'Looking through "{camera.name}"')
        return {'FINISHED'}


class FASTGS_OT_store_view(bpy.types.Operator):
    """Write this 3D view into the active splat object's file: whoever imports the file sees the capture like this first"""

    bl_idname = "fastgs.store_view"
    bl_label = "Store View in File"

    @classmethod
    def poll(cls, context):
        if context.space_data is None or context.space_data.type != 'VIEW_3D':
            cls.poll_message_set("A 3D view is needed")
            return False
        return _splat(context)

    def execute(self, context):
        obj = context.object
        path = objects.abspath(obj)
        try:
            annotate(path, view=framing.viewpoint_of_view(context, obj))
            objects.reload(path)
            splat_object.write_facts(obj, objects.load_model(path), path)
        except FastGSError as error:
            self.report({'ERROR'}, splat_object.sentence(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f"{path} is shown like this from now on")
        return {'FINISHED'}


class FASTGS_OT_use_standard(bpy.types.Operator):
    """Set the scene's view transform to Standard, which shows captured colours as they were filmed"""

    bl_idname = "fastgs.use_standard"
    bl_label = "Use Standard Colours"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return context.scene.view_settings.view_transform != 'Standard'

    def execute(self, context):
        context.scene.view_settings.view_transform = 'Standard'
        return {'FINISHED'}


CLASSES = (FASTGS_OT_frame_capture, FASTGS_OT_look_through, FASTGS_OT_store_view, FASTGS_OT_use_standard)
