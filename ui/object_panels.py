# SPDX-License-Identifier: GPL-3.0-or-later
"""The splat object's panel 4D Gaussians, in the object's properties, and its sub-panels."""
from itertools import groupby

import bpy

from ..fastgs_blender.rendering.instances import LOOKS
from ..operators.action import draw_column
from ..scene import holdout, lamps, light_probe, objects, speeds, startup
from ..scene.notices import draw_trouble
from . import facts


def is_ours(obj) -> bool:
    """Whether an object shows splats, or did until its path was cleared."""
    return obj is not None and bool(obj.fastgs.filepath or obj.fastgs.file_hash)


def split(layout, decorate: bool = True):
    """The layout, with the names of properties beside them; decorate: with a dot that keys them."""
    layout.use_property_split, layout.use_property_decorate = True, decorate
    return layout


def draw_rows(layout, rows):
    """Draw pairs of text in two columns, aligned with properties."""
    col = layout.column(align=True)
    for what, value in rows:
        split = col.split(factor=0.4)
        sub = split.row()
        sub.alignment = 'RIGHT'
        sub.label(text=what)
        split.label(text=value)


def draw_error(layout, context):
    """Draw why the object's file cannot be shown, and the button that reads it again."""
    error = objects.error_of(context.object)
    if error:
        box = layout.box()
        col = box.column()
        col.alert = True
        draw_trouble(col, context, error)
        box.operator("fastgs.reload", icon='FILE_REFRESH')


def draw_other_engine(layout, context):
    """Draw the button that makes FAST-GS the scene's engine, where it is not."""
    if context.engine != 'FASTGS':
        props = layout.operator("wm.context_set_enum", text="Render with FAST-GS", icon='SCENE')
        props.data_path, props.value = "scene.render.engine", 'FASTGS'


def draw_as_filmed(layout, context):
    """Draw the buttons with which the scene shows captures as they were filmed: its view transform and its engine, where they do not."""
    if startup.dulls_colours(context.scene):
        layout.operator("fastgs.use_standard", icon='COLOR')
    draw_other_engine(layout, context)


def draw_look(layout, context):
    """Draw how the model's colours, opacity and sizes are changed."""
    split(layout)
    groups = [list(names) for group, names in groupby(LOOKS, lambda name: LOOKS[name].group) if group != "LIGHT"]
    for names in (*groups[:-1], ["antialias", *groups[-1]], ["viewport_density", "density"]):
        draw_column(layout, context.object.fastgs, *names, align=True)
    if is_ours(context.object):
        layout.operator("fastgs.reset_look", icon='LOOP_BACK')


def draw_size(self, context):
    """How large a splat object is, below its scale in Blender's panel Transform."""
    if is_ours(context.object):
        draw_rows(self.layout, list(zip(("Size X", "Y", "Z"), facts.sides(context.object, context.scene), strict=False)))


class Sidebar:
    """A panel in the sidebar of the 3D view."""

    bl_space_type, bl_region_type, bl_category = 'VIEW_3D', 'UI', "FAST-GS"
    bl_options = {'DEFAULT_CLOSED'}


class _Splat:
    bl_space_type, bl_region_type, bl_context = 'PROPERTIES', 'WINDOW', "object"

    @classmethod
    def poll(cls, context):
        return is_ours(context.object)


class _Part(_Splat):
    bl_parent_id = "FASTGS_PT_object"
    bl_options = {'DEFAULT_CLOSED'}


class _Moving(_Part):
    @classmethod
    def poll(cls, context):
        return is_ours(context.object) and context.object.fastgs.frame_count != 1


class _OfTime(_Moving):
    bl_parent_id = "FASTGS_PT_object_time"


class FASTGS_PT_object(_Splat, bpy.types.Panel):
    bl_label = "4D Gaussians"

    def draw(self, context):
        layout, obj = self.layout, context.object
        row = layout.row(align=True)
        sub = row.row(align=True)
        sub.alert = objects.error_of(obj) is not None
        sub.use_property_split = True
        sub.prop(obj.fastgs, "filepath")
        row.operator("fastgs.reload", text="", icon='FILE_REFRESH')
        draw_error(layout, context)
        if not obj.fastgs.filepath:
            layout.label(text="No file is chosen", icon='INFO')
        elif facts.known(obj):
            draw_rows(layout, facts.object_facts(obj) + facts.extent(obj, context.scene))
        elif objects.error_of(obj) is None:
            layout.label(text="Not read yet", icon='INFO')
        if obj.fastgs.has_backdrop:
            split(layout.column()).prop(obj.fastgs, "backdrop")
        row = layout.row(align=True)
        row.operator("fastgs.frame_capture", icon='ZOOM_SELECTED')
        row.operator("fastgs.set_upright", icon='EMPTY_SINGLE_ARROW')
        draw_as_filmed(layout, context)


class FASTGS_PT_object_time(_Moving, bpy.types.Panel):
    bl_label = "Time"
    bl_options = set()

    def draw(self, context):
        layout, settings = split(self.layout), context.object.fastgs
        draw_column(layout, settings, "start_frame", "speed", active=not settings.use_capture_frame)
        if text := speeds.trouble(context.object):
            draw_trouble(layout, context, text)
        draw_column(layout, settings, "before", "after")
        if facts.known(context.object):
            draw_rows(layout, [("Shown Now", facts.shown_now(context.object, context.scene))])
            layout.operator("fastgs.fit_scene", icon='PREVIEW_RANGE')


class FASTGS_PT_object_trim(_OfTime, bpy.types.Panel):
    bl_label = "Trim, Shift and Fade"

    def draw(self, context):
        layout, settings = split(self.layout), context.object.fastgs
        draw_column(layout, settings, "trim_start", align=True).prop(settings, "trim_end", text="End")
        col = layout.column()
        draw_column(col, settings, "offset", active=not settings.use_capture_frame)
        draw_column(col, settings, "fade", active='LOOP' in (settings.before, settings.after))
        if objects.is_sequence(context.object):
            col.prop(settings, "subframes")


class FASTGS_PT_object_capture_frame(_OfTime, bpy.types.Panel):
    bl_label = "Key the Capture Frame"

    def draw_header(self, context):
        self.layout.prop(context.object.fastgs, "use_capture_frame", text="")

    def draw(self, context):
        layout, settings = split(self.layout), context.object.fastgs
        layout.active = settings.use_capture_frame
        layout.prop(settings, "capture_frame")


class FASTGS_PT_object_echoes(_OfTime, bpy.types.Panel):
    bl_label = "Echoes"

    def draw(self, context):
        layout, settings = split(self.layout), context.object.fastgs
        layout.prop(settings, "echoes")
        col = layout.column(align=True)
        col.active = settings.echoes > 0
        col.prop(settings, "echo_spacing", text="Spacing")
        col.prop(settings, "echo_fade", text="Fade")


class FASTGS_PT_object_cut(_OfTime, bpy.types.Panel):
    bl_label = "Loop, Split and Markers"

    def draw(self, context):
        self.layout.operator("fastgs.make_loop", icon='FILE_REFRESH')
        row = self.layout.row(align=True)
        row.operator("fastgs.split", icon='PIVOT_CURSOR')
        row.operator("fastgs.mark_clip", icon='MARKER_HLT')


class FASTGS_PT_object_sound(_Moving, bpy.types.Panel):
    bl_label = "Sound"

    def draw(self, context):
        self.layout.operator("fastgs.add_sound", icon='SOUND')


class FASTGS_PT_object_look(_Part, bpy.types.Panel):
    bl_label = "Look"

    def draw(self, context):
        draw_look(self.layout, context)


class FASTGS_PT_object_light(_Part, bpy.types.Panel):
    bl_label = "Scene Light"

    def draw(self, context):
        layout, scene = split(self.layout), context.scene.fastgs
        draw_column(layout, context.object.fastgs, *(name for name in LOOKS if LOOKS[name].group == "LIGHT"))
        draw_column(layout, scene, "shadow_samples", "shadow_bias", active=lamps.takes_light(context.object), align=True)
        layout.prop(scene, "contact_distance")
        layout.operator("fastgs.add_relight", icon='NODE_COMPOSITING')


class FASTGS_PT_object_points(_Part, bpy.types.Panel):
    bl_label = "Effects and Modifiers"

    def draw(self, context):
        layout, settings = split(self.layout), context.object.fastgs
        layout.operator_menu_enum("fastgs.add_effect", "effect", icon='GEOMETRY_NODES')
        layout.prop(settings, "points")
        draw_column(layout, settings, "follow_points", "still_frame", active=settings.points == 'ALL')


class FASTGS_PT_object_engines(_Part, bpy.types.Panel):
    bl_label = "Other Render Engines"

    def draw(self, context):
        self.layout.operator("fastgs.make_mesh", icon='MESH_DATA')
        self.layout.operator_menu_enum("fastgs.native_copy", "kind", icon='POINTCLOUD_DATA')


class FASTGS_PT_light_probe(_Splat, bpy.types.Panel):
    bl_label = "Light Probe"

    @classmethod
    def poll(cls, context):
        return context.object is not None and light_probe.is_one(context.object)

    def draw(self, context):
        layout, probe, scene = split(self.layout), context.object.fastgs.probe, context.scene
        draw_column(layout, probe, "strength", "highlights", "width")
        layout.prop(context.object, "empty_display_size", text="Radius")
        if not holdout.with_meshes(scene):
            draw_trouble(layout, context, "Choose Render With Meshes in the render properties", 'INFO')
        elif light_probe.all_of(scene)[:1] != [context.object]:
            draw_trouble(layout, context, f"{light_probe.all_of(scene)[0].name} counts: the first one by name that is rendered", 'INFO')


class FASTGS_PT_instances(_Splat, bpy.types.Panel):
    bl_label = "Look of Instanced Splats"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context):
        return context.object is not None and objects.instances_splats(context.object)

    def draw(self, context):
        draw_look(self.layout, context)
