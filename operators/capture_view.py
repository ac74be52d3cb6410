# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that show a capture from a good side, and store such a side in its file."""
import bpy
from bpy.props import IntProperty

from ..fastgs_blender.formats.annotate import annotate
from ..scene import objects
from ..scene.cameras import framing
from ..scene.splats import splat_object
from .action import SPLATS, VIEW_3D, Action, Need


class FASTGS_OT_frame_capture(Action, bpy.types.Operator):
    """Show the active splat object in the 3D views: as its file's author wants it, from where it was filmed, or framed from this side"""

    bl_idname = "fastgs.frame_capture"
    bl_label = "Frame Capture"
    bl_options = {'REGISTER'}
    needs = (SPLATS,)

    def act(self, context):
        if not framing.show(context, [context.object]):
            self.warn("No 3D view is open that does not look through a camera")


class FASTGS_OT_look_through(Action, bpy.types.Operator):
    """Make a camera where one stood that filmed the capture, and look through it"""

    bl_idname = "fastgs.look_through"
    bl_label = "Look through a Capture Camera"
    needs = (SPLATS,)

    index: IntProperty(name="Camera", description="Number of the camera, as the file lists them; -1: the one in their middle",
                       default=-1, min=-1)

    def act(self, context):
        camera = framing.look_through(context, context.object, None if self.index < 0 else self.index)
        return f'Looking through "{camera.name}"'


class FASTGS_OT_store_view(Action, bpy.types.Operator):
    """Write this 3D view into the active splat object's file: whoever imports the file sees the capture like this first"""

    bl_idname = "fastgs.store_view"
    bl_label = "Store View in File"
    bl_options = {'REGISTER'}
    needs = (VIEW_3D, SPLATS)

    def act(self, context):
        obj = context.object
        path = objects.abspath(obj)
        annotate(path, view=framing.viewpoint_of_view(context, obj))
        objects.reload(path)
        splat_object.write_facts(obj, objects.source_of(obj), path)
        return f"{path} is shown like this from now on"


class FASTGS_OT_use_standard(Action, bpy.types.Operator):
    """Set the scene's view transform to Standard, which shows captured colours as they were filmed"""

    bl_idname = "fastgs.use_standard"
    bl_label = "Use Standard Colours"
    needs = (Need(lambda context: context.scene.view_settings.view_transform != 'Standard', "The view transform is Standard already"),)

    def act(self, context):
        context.scene.view_settings.view_transform = 'Standard'
