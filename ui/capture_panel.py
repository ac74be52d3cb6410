# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of captures and camera paths in the sidebar of the 3D view."""
import bpy


class FASTGS_PT_capture(bpy.types.Panel):
    bl_label = "Capture"
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'UI'
    bl_category = "FAST-GS"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        layout = self.layout
        col = layout.column(align=True)
        col.operator("fastgs.import_capture", icon='OUTLINER_OB_CAMERA')
        col.operator("fastgs.render_as_filmed", icon='CAMERA_DATA')
        col = layout.column(align=True)
        row = col.row(align=True)
        row.operator("fastgs.set_ground", text="Ground: Points", icon='EMPTY_AXIS').source = 'POINTS'
        row.operator("fastgs.set_ground", text="Cameras").source = 'CAMERAS'
        col.operator("fastgs.set_scale", icon='DRIVER_DISTANCE')
        col = layout.column(align=True)
        col.operator("fastgs.import_camera_path", icon='IMPORT')
        col.operator("fastgs.export_camera_path", icon='EXPORT')


CLASSES = (FASTGS_PT_capture,)
