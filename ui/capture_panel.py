# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of captures and camera paths in the sidebar of the 3D view."""
import bpy

from ..scene.cameras import clips
from ..scene.cameras.worlds import is_world
from . import facts
from .object_panels import Sidebar, draw_rows, draw_trouble, is_ours


class FASTGS_PT_capture(Sidebar, bpy.types.Panel):
    bl_label = "Capture"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        layout = self.layout
        layout.operator("fastgs.import_capture", icon='OUTLINER_OB_CAMERA')
        clip = clips.filmed(context)
        difference = "" if clip is None else clips.difference(context.scene, clip)
        if difference:
            box = layout.box()
            draw_trouble(box, context, difference, 'INFO')
            box.operator("fastgs.set_scene", icon='PREVIEW_RANGE')
        if not any(is_world(obj) for obj in context.scene.objects):
            draw_trouble(layout, context, "Ground and scale are those of a capture: import one first.", 'INFO')
        elif not (context.object is not None and context.object.type == 'CAMERA' and context.object.data.fastgs.width):
            draw_trouble(layout, context, "Render as Filmed needs a capture's camera: select one.", 'INFO')
        layout.operator("fastgs.render_as_filmed", icon='CAMERA_DATA')
        col = layout.column(align=True)
        row = col.row(align=True)
        row.operator("fastgs.set_ground", text="Ground: Points", icon='EMPTY_AXIS').source = 'POINTS'
        row.operator("fastgs.set_ground", text="Cameras").source = 'CAMERAS'
        col.operator("fastgs.set_scale", icon='DRIVER_DISTANCE')
        if is_ours(context.object):
            draw_rows(layout, facts.extent(context.object, context.scene))
        col = layout.column(align=True)
        col.operator("fastgs.import_camera_path", icon='IMPORT')
        col.operator("fastgs.export_camera_path", icon='EXPORT')
