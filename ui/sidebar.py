# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the sidebar's FAST-GS tab: splats and pictures in viewports, cameras and their moves, captures and camera paths."""
import bpy

from ..engine.viewport.spaces import viewports
from ..scene import objects, unshown
from ..scene.cameras import clips
from ..scene.cameras.worlds import is_world
from . import facts
from .object_panels import Sidebar, draw_rows, draw_trouble, is_ours, split
from .render_panels import draw_unshown


class FASTGS_PT_viewport(Sidebar, bpy.types.Panel):
    bl_label = "Splats in Viewports"

    @classmethod
    def poll(cls, context):
        return any(objects.is_splat(obj) for obj in context.scene.objects)

    def draw_header(self, context):
        self.layout.prop(context.scene.fastgs, "show_splats", text="")

    def draw(self, context):
        layout, settings = split(self.layout, decorate=False), context.scene.fastgs
        layout.prop(settings, "viewport_density", text="In Motion")
        layout.prop(settings, "viewport_pixels")
        draw_rows(layout, [("GPU Memory", f"{facts.size(viewports.memory())} of at most {facts.size(viewports.most_memory())}")])
        if context.engine == 'FASTGS':
            draw_unshown(layout, context)
            text = unshown.in_viewports(context.scene)
            if text:
                draw_trouble(layout, context, text, 'INFO')
        trouble = viewports.trouble()
        if trouble:
            draw_trouble(layout, context, trouble)


class FASTGS_PT_viewport_pass(bpy.types.Panel):
    """In the popover of the viewport's shading, where other engines have it."""

    bl_label = "Render Pass"
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'HEADER'
    bl_parent_id = "VIEW3D_PT_shading"

    @classmethod
    def poll(cls, context):
        return context.engine == 'FASTGS' and context.space_data.shading.type == 'RENDERED'

    def draw(self, context):
        self.layout.prop(context.space_data.shading.fastgs, "render_pass", text="")


class FASTGS_PT_pictures(Sidebar, bpy.types.Panel):
    bl_label = "Pictures on Cameras"

    @classmethod
    def poll(cls, context):
        return any(obj.type == 'CAMERA' and obj.data.background_images for obj in context.scene.objects)

    def draw_header(self, context):
        self.layout.prop(context.scene.fastgs, "show_pictures", text="")

    def draw(self, context):
        layout = split(self.layout, decorate=False)
        layout.prop(context.scene.fastgs, "picture_size")


class FASTGS_PT_camera(Sidebar, bpy.types.Panel):
    bl_label = "Camera"

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


class FASTGS_PT_capture(Sidebar, bpy.types.Panel):
    bl_label = "Capture"

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
