# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels about splats and pictures in viewports, in the sidebar of the 3D view."""
import bpy

from ..engine.viewport.spaces import viewports
from ..scene import objects, unshown
from . import facts
from .object_panels import Sidebar, draw_rows, draw_trouble, split
from .render_panels import draw_unshown


class FASTGS_PT_viewport(Sidebar, bpy.types.Panel):
    bl_label = "Splats in Viewports"
    bl_options = {'DEFAULT_CLOSED'}

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
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context):
        return any(obj.type == 'CAMERA' and obj.data.background_images for obj in context.scene.objects)

    def draw_header(self, context):
        self.layout.prop(context.scene.fastgs, "show_pictures", text="")

    def draw(self, context):
        layout = split(self.layout, decorate=False)
        layout.prop(context.scene.fastgs, "picture_size")
