# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar's panel Select and Parts: all that chooses which Gaussians of an object are shown, and by which object."""
import bpy

from ..operators.select_kind import KINDS, PLAIN
from .object_panels import Sidebar, is_ours
from .tools import ERASING, SELECTING


class FASTGS_MT_select(bpy.types.Menu):
    bl_label = "Splats"

    def draw(self, context):
        layout = self.layout
        for kind, label, _, _ in PLAIN:
            layout.operator("fastgs.select_kind", text=label).kind = kind
        layout.separator()
        layout.operator("fastgs.grow").to = 'THING'
        layout.operator("fastgs.grow", text="Connected").to = 'CONNECTED'
        layout.separator()
        for kind, label, _, _ in KINDS:
            layout.operator("fastgs.select_kind", text=label).kind = kind


class FASTGS_PT_parts(Sidebar, bpy.types.Panel):
    bl_label = "Select and Parts"
    bl_options = set()

    @classmethod
    def poll(cls, context):
        return is_ours(context.object)

    def draw(self, context):
        layout, settings, scene = self.layout, context.object.fastgs, context.scene.fastgs
        _draw_tools(layout, SELECTING, ("Thing", "Box", "Lasso", "Brush", "Sphere"))
        layout.prop(scene, "select_through")
        row = layout.row(align=True)
        row.menu("FASTGS_MT_select", text="Select")
        row.operator("fastgs.grow", text="Grow", icon='ZOOM_IN')
        row = layout.row(align=True)
        row.operator("fastgs.separate", icon='MOD_EXPLODE')
        row.operator("fastgs.join_parts")
        if settings.part:
            layout.operator("fastgs.show_whole")


class _Below(Sidebar):
    bl_parent_id = "FASTGS_PT_parts"


class FASTGS_PT_parts_erase(_Below, bpy.types.Panel):
    bl_label = "Erase"
    bl_options = set()

    def draw(self, context):
        layout = self.layout
        _draw_tools(layout, ERASING, ("Brush", "Lasso", "Box"))
        row = layout.row(align=True)
        row.operator("fastgs.erase", icon='HIDE_ON')
        row.operator("fastgs.show_hidden", icon='HIDE_OFF')
        layout.operator("fastgs.clean_up", icon='SHADERFX')
        if context.object.fastgs.mask:
            row = layout.row(align=True)
            row.prop(context.window_manager.fastgs, "show_erased", toggle=True)
            row.operator("fastgs.invert_hidden", text="Swap")
        layout.operator("fastgs.delete_for_good", icon='TRASH')


class FASTGS_PT_parts_crop(_Below, bpy.types.Panel):
    bl_label = "Crop"

    def draw(self, context):
        def first(row, item, index):
            row.prop(item, "object", text="")

        def rest(col, item):
            row = col.row(align=True)
            row.prop(item, "shape", text="", icon_only=True)  # with their words the number is cut
            row.prop(item, "mode", text="", icon_only=True)
            row.prop(item, "soft", text="Soft")

        _draw_list(self.layout, context.object.fastgs.crops, first, rest, "fastgs.remove_crop_box")
        self.layout.operator_menu_enum("fastgs.add_crop_box", "shape", icon='ADD')


class FASTGS_PT_parts_filters(_Below, bpy.types.Panel):
    bl_label = "Filters"

    def draw(self, context):
        def first(row, item, index):
            row.prop(item, "mode", text="")
            row.prop(item, "kind", text="")
            row.operator("fastgs.select_filtered", text="", icon='RESTRICT_SELECT_OFF').index = index

        def rest(col, item):
            if item.kind == 'COLOUR':
                col.prop(item, "colour", text="")
            row = col.row(align=True)
            row.prop(item, "low", text="")
            row.prop(item, "high", text="")

        _draw_list(self.layout, context.object.fastgs.filters, first, rest, "fastgs.remove_filter")
        self.layout.operator_menu_enum("fastgs.add_filter", "preset", icon='ADD')


def _draw_list(layout, items, first, rest, remove: str):
    """Draw a block for each of some items: first(row, item, index) beside the switch and the operator that removes it; rest(col, item)."""
    layout.use_property_decorate = False
    for index, item in enumerate(items):
        col = layout.column(align=True)
        row = col.row(align=True)
        row.prop(item, "use", text="")
        first(row, item, index)
        row.operator(remove, text="", icon='X').index = index
        rest(col.column(align=True), item)


class FASTGS_PT_parts_stitch(_Below, bpy.types.Panel):
    bl_label = "Stitch"

    def draw(self, context):
        layout = self.layout
        row = layout.row(align=True)
        row.operator("fastgs.align_pairs", icon='SNAP_VERTEX')
        row.operator("fastgs.align_overlap", text="by Overlap")
        row = layout.row(align=True)
        row.operator("fastgs.match_grade", icon='COLOR')
        row.operator("fastgs.cross_fade", icon='IPO_LINEAR')


def _draw_tools(layout, tools, names):
    """Draw the buttons that choose tools of the toolbar."""
    row = layout.row(align=True)
    for tool, name in zip(tools, names, strict=True):
        row.operator("wm.tool_set_by_id", text=name).name = tool.bl_idname
