# SPDX-License-Identifier: GPL-3.0-or-later
"""The splat object's panels, in the object's properties and in the sidebar of the 3D view."""
from __future__ import annotations

from itertools import groupby

import bpy

from ..fastgs_blender.rendering.instances import LOOKS
from ..scene import objects, startup
from . import facts


def is_ours(obj) -> bool:
    """Whether an object shows splats, or did until its path was cleared."""
    return obj is not None and bool(obj.fastgs.filepath or obj.fastgs.file_hash)


def draw_rows(layout, rows):
    """Draw pairs of text in two columns, aligned with properties."""
    col = layout.column(align=True)
    for what, value in rows:
        split = col.split(factor=0.4)
        sub = split.row()
        sub.alignment = 'RIGHT'
        sub.label(text=what)
        split.label(text=value)


def draw_trouble(col, context, text, icon='ERROR'):
    """Draw the error message, on several lines if it is long."""
    for i, line in enumerate(facts.lines(text, context.region.width, context.preferences.system.ui_scale or 1.0)):
        col.label(text=line, icon='BLANK1' if i else icon)


def draw_model(layout, context):
    """Draw the file, its error if there is one, and its contents."""
    obj = context.object
    error = objects.error_of(obj)
    row = layout.row(align=True)
    sub = row.row(align=True)
    sub.alert = error is not None
    sub.use_property_split = True
    sub.prop(obj.fastgs, "filepath")
    row.operator("fastgs.reload", text="", icon='FILE_REFRESH')
    if error:
        box = layout.box()
        col = box.column(align=True)
        col.alert = True
        draw_trouble(col, context, error)
        box.operator("fastgs.reload", icon='FILE_REFRESH')
    if not obj.fastgs.filepath:
        layout.label(text="No file is chosen", icon='INFO')
    elif facts.known(obj):
        draw_rows(layout, facts.object_facts(obj))
    elif not error:
        layout.label(text="Not read yet", icon='INFO')
    if obj.fastgs.has_backdrop:
        col = layout.column()
        col.use_property_split = True
        col.prop(obj.fastgs, "backdrop")
    row = layout.row(align=True)
    row.operator("fastgs.frame_capture", icon='ZOOM_SELECTED')
    if obj.fastgs.camera_count:
        row.operator("fastgs.look_through", text="", icon='OUTLINER_OB_CAMERA')
    row.operator("fastgs.store_view", text="", icon='FILE_TICK')
    layout.operator("fastgs.set_upright", icon='EMPTY_SINGLE_ARROW')
    if startup.dulls_colours(context.scene):
        layout.operator("fastgs.use_standard", icon='COLOR')
    if context.engine != 'FASTGS':
        props = layout.operator("wm.context_set_enum", text="Render with FAST-GS", icon='SCENE')
        props.data_path = "scene.render.engine"
        props.value = 'FASTGS'


def draw_time(layout, context):
    """Draw the clip's timing: start, speed, offset, before and after."""
    obj = context.object
    settings = obj.fastgs
    layout.use_property_split = True
    col = layout.column()
    col.active = not settings.use_capture_frame
    col.prop(settings, "start_frame")
    col.prop(settings, "speed")
    col.prop(settings, "offset")
    row = layout.row(heading="Capture Frame", align=True)
    row.prop(settings, "use_capture_frame", text="")
    sub = row.row()
    sub.active = settings.use_capture_frame
    sub.prop(settings, "capture_frame", text="")
    col = layout.column(align=True)
    col.prop(settings, "trim_start", text="Trim Start")
    col.prop(settings, "trim_end", text="End")
    col = layout.column()
    col.prop(settings, "before")
    col.prop(settings, "after")
    if 'LOOP' in (settings.before, settings.after):
        col.prop(settings, "fade")
    col = layout.column(align=True)
    col.prop(settings, "echoes")
    if settings.echoes:
        col.prop(settings, "echo_spacing", text="Spacing")
        col.prop(settings, "echo_fade", text="Fade")
    if objects.is_sequence(obj):
        col.prop(settings, "subframes")
    if facts.known(obj):
        draw_rows(layout, [("Shown Now", facts.shown_now(obj, context.scene))])
        layout.operator("fastgs.fit_scene", icon='PREVIEW_RANGE')
        row = layout.row(align=True)
        row.operator("fastgs.split", icon='PIVOT_CURSOR')
        row.operator("fastgs.mark_clip", icon='MARKER_HLT')
        layout.operator("fastgs.add_sound", icon='SOUND')
        layout.operator_menu_enum("fastgs.native_copy", "kind", icon='POINTCLOUD_DATA')


def draw_look(layout, context):
    """Draw how the model's colours, opacity and sizes are changed."""
    settings = context.object.fastgs
    layout.use_property_split = True
    groups = [list(names) for _, names in groupby(LOOKS, lambda name: LOOKS[name].group)]
    for names in (*groups[:-1], ["antialias", *groups[-1]], ["viewport_density", "density"]):
        col = layout.column(align=True)
        for name in names:
            col.prop(settings, name)
    if is_ours(context.object):
        layout.operator("fastgs.reset_look", icon='LOOP_BACK')


def draw_points(layout, context):
    """Draw what the points of the object's mesh are, and the effects that change them."""
    settings = context.object.fastgs
    layout.use_property_split = True
    layout.prop(settings, "points")
    col = layout.column()
    col.active = settings.points == 'ALL'
    col.prop(settings, "follow_points")
    col.prop(settings, "still_frame")
    layout.operator_menu_enum("fastgs.add_effect", "effect", icon='GEOMETRY_NODES')


def draw_crop(layout, context):
    """Draw the shapes that crop the model."""
    layout.use_property_decorate = False
    boxes = context.object.fastgs.crops
    for index, item in enumerate(boxes):
        row = layout.row(align=True)
        row.prop(item, "use", text="")
        row.prop(item, "object", text="")
        row.prop(item, "shape", text="", icon_only=True)  # with their words, names of objects are cut
        row.prop(item, "mode", text="", icon_only=True)
        row.prop(item, "soft", text="Soft")
        row.operator("fastgs.remove_crop_box", text="", icon='X').index = index
    layout.operator_menu_enum("fastgs.add_crop_box", "shape", icon='ADD')
    if boxes:
        layout.operator("fastgs.apply_crop", icon='FILE_TICK')


def draw_filters(layout, context, brush: bool):
    """Draw the filters that hide Gaussians for what they are, and the brush that hides them by hand in a 3D view."""
    layout.use_property_decorate = False
    for index, item in enumerate(context.object.fastgs.filters):
        col = layout.column(align=True)
        row = col.row(align=True)
        row.prop(item, "use", text="")
        row.prop(item, "mode", text="")
        row.prop(item, "kind", text="")
        row.operator("fastgs.separate", text="", icon='MOD_EXPLODE').index = index
        row.operator("fastgs.remove_filter", text="", icon='X').index = index
        row = col.row(align=True)
        if item.kind == 'COLOUR':
            row.prop(item, "colour", text="")
        row.prop(item, "low")
        row.prop(item, "high")
    layout.operator_menu_enum("fastgs.add_filter", "preset", icon='ADD')
    if brush:
        col = layout.column()
        col.operator_context = 'INVOKE_REGION_WIN'
        col.operator("fastgs.brush", icon='BRUSH_DATA')
    if context.object.fastgs.mask:
        row = layout.row(align=True)
        row.operator("fastgs.show_hidden", icon='HIDE_OFF')
        row.operator("fastgs.invert_hidden", icon='ARROW_LEFTRIGHT')


class _Splat:
    @classmethod
    def poll(cls, context):
        return is_ours(context.object)


class _Moving:
    @classmethod
    def poll(cls, context):
        return is_ours(context.object) and context.object.fastgs.frame_count != 1


class _Properties(_Splat):
    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    bl_context = "object"


class _Sidebar(_Splat):
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'UI'
    bl_category = "FAST-GS"


class FASTGS_PT_object(_Properties, bpy.types.Panel):
    bl_label = "4D Gaussians"

    def draw(self, context):
        draw_model(self.layout, context)


class FASTGS_PT_object_time(_Moving, _Properties, bpy.types.Panel):
    bl_label = "Time"
    bl_parent_id = "FASTGS_PT_object"

    def draw(self, context):
        draw_time(self.layout, context)


class FASTGS_PT_object_look(_Properties, bpy.types.Panel):
    bl_label = "Look"
    bl_parent_id = "FASTGS_PT_object"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_look(self.layout, context)


class FASTGS_PT_instances(_Properties, bpy.types.Panel):
    bl_label = "Look of 4D Gaussians"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context):
        return context.object is not None and objects.instances_splats(context.object)

    def draw(self, context):
        draw_look(self.layout, context)


class FASTGS_PT_object_points(_Properties, bpy.types.Panel):
    bl_label = "Points"
    bl_parent_id = "FASTGS_PT_object"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_points(self.layout, context)


class FASTGS_PT_object_crop(_Properties, bpy.types.Panel):
    bl_label = "Crop"
    bl_parent_id = "FASTGS_PT_object"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_crop(self.layout, context)


class FASTGS_PT_object_filters(_Properties, bpy.types.Panel):
    bl_label = "Filters"
    bl_parent_id = "FASTGS_PT_object"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_filters(self.layout, context, False)


class FASTGS_PT_sidebar(_Sidebar, bpy.types.Panel):
    bl_label = "4D Gaussians"

    @classmethod
    def poll(cls, context):
        return True

    def draw(self, context):
        layout = self.layout
        if is_ours(context.object):
            draw_model(layout, context)
        else:
            col = layout.column()
            col.operator("import_scene.fastgs", icon='IMPORT')
            col.operator("fastgs.import_example", icon='HEART')
            col.operator("fastgs.bake", icon='RENDER_ANIMATION')


class FASTGS_PT_sidebar_time(_Moving, _Sidebar, bpy.types.Panel):
    bl_label = "Time"
    bl_parent_id = "FASTGS_PT_sidebar"

    def draw(self, context):
        draw_time(self.layout, context)


class FASTGS_PT_sidebar_look(_Sidebar, bpy.types.Panel):
    bl_label = "Look"
    bl_parent_id = "FASTGS_PT_sidebar"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_look(self.layout, context)


class FASTGS_PT_sidebar_points(_Sidebar, bpy.types.Panel):
    bl_label = "Points"
    bl_parent_id = "FASTGS_PT_sidebar"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_points(self.layout, context)


class FASTGS_PT_sidebar_crop(_Sidebar, bpy.types.Panel):
    bl_label = "Crop"
    bl_parent_id = "FASTGS_PT_sidebar"

    def draw(self, context):
        draw_crop(self.layout, context)


class FASTGS_PT_sidebar_filters(_Sidebar, bpy.types.Panel):
    bl_label = "Filters"
    bl_parent_id = "FASTGS_PT_sidebar"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        draw_filters(self.layout, context, True)


CLASSES = (FASTGS_PT_object, FASTGS_PT_object_time, FASTGS_PT_object_look, FASTGS_PT_object_crop, FASTGS_PT_object_filters,
           FASTGS_PT_object_points, FASTGS_PT_instances, FASTGS_PT_sidebar, FASTGS_PT_sidebar_time, FASTGS_PT_sidebar_look,
           FASTGS_PT_sidebar_crop, FASTGS_PT_sidebar_filters, FASTGS_PT_sidebar_points)
