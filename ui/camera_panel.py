# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of cameras and their moves in the sidebar of the 3D view."""
import bpy

from .object_panels import Sidebar


class FASTGS_PT_camera(Sidebar, bpy.types.Panel):
    bl_label = "Camera"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        layout = self.layout
        layout.operator("fastgs.camera_from_view", icon='OUTLINER_OB_CAMERA')
        col = layout.column(align=True)
        col.operator("fastgs.camera_orbit", icon='ORIENTATION_GIMBAL')
        col.operator("fastgs.camera_dolly", icon='TRACKING_FORWARDS_SINGLE')
        col.operator("fastgs.camera_through", icon='CURVE_PATH')
        col.operator("fastgs.key_from_view", icon='KEYFRAME_HLT')
        col = layout.column(align=True)
        col.operator("fastgs.handheld", icon='VIEW_PAN')
        col.operator("fastgs.follow_region", icon='CON_TRACKTO')
        col.operator("fastgs.bullet_time", icon='TIME')
