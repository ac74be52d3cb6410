# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render engine: in the render and in the view layer properties."""
from __future__ import annotations

import bpy

from ..fastgs_blender.rendering.passes import PASSES
from . import facts
from .object_panels import draw_rows


class _Engine:
    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    COMPAT_ENGINES = {'FASTGS'}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


class FASTGS_PT_render(_Engine, bpy.types.Panel):
    bl_label = "4D Gaussians"
    bl_context = "render"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(context.scene.fastgs, "depth")
        draw_rows(layout, facts.scene_facts(context.scene))


class FASTGS_PT_film(_Engine, bpy.types.Panel):
    bl_label = "Film"
    bl_context = "render"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(context.scene.render, "film_transparent", text="Transparent")


class FASTGS_PT_passes(_Engine, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layer = context.view_layer
        col = layout.column(heading="Include")
        for switch, name in {entry.switch: entry.title or entry.blender for entry in PASSES.values() if entry.switch}.items():
            group, _, prop = switch.rpartition(".")
            col.prop(getattr(layer, group) if group else layer, prop, text=name)
        if layer.use_pass_cryptomatte_object:
            layout.prop(layer, "pass_cryptomatte_depth", text="Cryptomatte Levels")


CLASSES = (FASTGS_PT_render, FASTGS_PT_film, FASTGS_PT_passes)
