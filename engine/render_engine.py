# SPDX-License-Identifier: GPL-3.0-or-later
"""FASTGS, the render engine.  Blender makes an instance for each frame and frees it: whatever lasts lives in modules."""
import bpy

from ..scene import objects
from . import final, passes
from .viewport.spaces import viewports


class FASTGSRenderEngine(bpy.types.RenderEngine):
    """Renders splat objects through the library; every method hands over to a module."""

    bl_idname = "FASTGS"
    bl_label = "FAST-GS"
    bl_use_preview = False
    bl_use_postprocess = True
    bl_use_eevee_viewport = True
    bl_use_shading_nodes_custom = False
    bl_use_gpu_context = False

    def update(self, data, depsgraph):
        objects.drop_unused()

    def render(self, depsgraph):
        final.render(self, depsgraph)

    def view_update(self, context, depsgraph):
        viewports.changed()

    def view_draw(self, context, depsgraph):
        viewports.view_draw(context, depsgraph)

    def update_render_passes(self, scene=None, renderlayer=None):
        passes.register(self, scene, renderlayer)


register, unregister = bpy.utils.register_classes_factory((FASTGSRenderEngine,))
