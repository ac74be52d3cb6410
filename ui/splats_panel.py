# SPDX-License-Identifier: GPL-3.0-or-later
"""The first panel of the sidebar's FAST-GS tab: importing, and what is done with splats in the 3D view itself."""
import bpy

from .object_panels import Sidebar, draw_as_filmed, draw_error, is_ours


class FASTGS_PT_splats(Sidebar, bpy.types.Panel):
    bl_label = "Splats"
    bl_options = set()

    def draw(self, context):
        layout = self.layout
        if not is_ours(context.object):
            col = layout.column()
            col.operator("import_scene.fastgs", icon='IMPORT')
            col.operator("fastgs.import_example", icon='HEART')
            col.operator("fastgs.bake", icon='RENDER_ANIMATION')
            return
        layout.label(text=context.object.name, icon='OUTLINER_OB_POINTCLOUD', translate=False)
        draw_error(layout, context)
        row = layout.row(align=True)
        row.operator("fastgs.frame_capture", icon='ZOOM_SELECTED')
        if context.object.fastgs.camera_count:
            row.operator("fastgs.look_through", text="", icon='OUTLINER_OB_CAMERA')
        row.operator("fastgs.store_view", text="", icon='FILE_TICK')
        draw_settings_button(layout, context)
        draw_as_filmed(layout, context)


def draw_settings_button(layout, context):
    """Draw the button that shows the object's panel in a properties editor of the window; where there is none, its place in words."""
    for number, area in enumerate(context.screen.areas):
        if area.type == 'PROPERTIES':
            props = layout.operator("wm.context_set_enum", text="Time, Look ...", icon='OBJECT_DATA')
            props.data_path, props.value = f"screen.areas[{number}].spaces.active.context", 'OBJECT'
            return
    layout.label(text="More in Object Properties", icon='OBJECT_DATA')
