# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render engine: in the render and in the view layer properties."""
import bpy

from ..fastgs_blender.rendering.passes import PASSES
from ..fastgs_blender.util.backends import describe_backend
from ..fastgs_blender.util.threads import available
from ..scene import devices, holdout, mesh_scene, objects, settings, shadows, unshown
from . import facts
from .object_panels import draw_column, draw_other_engine, draw_rows, draw_trouble, split

MESH_PASSES = {
    'CYCLES': ("mist", "position", "normal", "vector", "uv", "object_index", "material_index", "diffuse_direct", "diffuse_indirect",
               "diffuse_color", "glossy_direct", "glossy_indirect", "glossy_color", "transmission_direct", "transmission_indirect",
               "transmission_color", "emit", "ambient_occlusion", "cryptomatte_object", "cryptomatte_material", "cryptomatte_asset"),
    'EEVEE': ("mist", "position", "normal", "vector", "diffuse_direct", "diffuse_color", "glossy_direct", "glossy_color", "emit", "shadow",
              "ambient_occlusion", "cryptomatte_object", "cryptomatte_material", "cryptomatte_asset"),
}
"""Blender's passes that the engines of meshes deliver, besides those that every picture with meshes has."""


class _Engine:
    bl_space_type, bl_region_type, bl_context = 'PROPERTIES', 'WINDOW', "render"
    COMPAT_ENGINES = {'FASTGS'}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


def draw_unshown(layout, context):
    """Draw what of the scene FAST-GS does not render, and the button that helps with meshes."""
    scene, layer = context.scene, context.view_layer
    meshes = unshown.meshes(scene, layer)
    if meshes:
        col = layout.box().column(align=True)
        draw_trouble(col, context, meshes)
        col.prop_menu_enum(scene.fastgs, "render_meshes", icon='NODE_COMPOSITING')
    for text in unshown.settings(scene, layer):
        draw_trouble(layout, context, text, 'INFO')


def draw_device(layout, context):
    """Draw which device renders and trains, and why."""
    layout.prop(context.scene.fastgs, "device")
    if context.scene.fastgs.device == 'CPU':
        return
    if devices.found() is None or devices.line():
        draw_rows(layout, [("GPU", devices.line() or "being looked for")])
        return
    name, remark = devices.backend(devices.wanted(context.scene))
    if name != "auto":
        draw_rows(layout, [("GPU", describe_backend(name))])
    if remark:
        draw_trouble(layout, context, remark, 'INFO')


def draw_meshes(layout, scene):
    """Draw what renders the meshes, with the settings of that engine that matter most."""
    col = layout.column(align=True)
    col.use_property_split = False
    col.label(text="Render With Meshes")
    col.row(align=True).prop(scene.fastgs, "render_meshes", expand=True)
    other = mesh_scene.of(scene)
    if other is not None and other.render.engine == 'CYCLES':
        col = layout.column(align=True)
        col.prop(other.cycles, "samples", text="Mesh Samples")
        col.prop(other.cycles, "use_denoising", text="Denoise Meshes")
    elif other is not None:
        layout.prop(other.eevee, "taa_render_samples", text="Mesh Samples")
    if other is not None:
        layout.operator("fastgs.add_light_probe", text="Add Light Probe", icon='LIGHTPROBE_SPHERE')
        layout.prop(scene.fastgs, "write_passes")


def draw_threads(layout, render):
    """Blender's own setting, which no panel of its own shows under our engine, and what it means."""
    col = layout.column()
    col.prop(render, "threads_mode")
    if render.threads_mode == 'FIXED':
        col.prop(render, "threads")
    elif settings.threads:
        draw_rows(col, [("Threads", f"{settings.threads} (preferences)")])
    else:
        draw_rows(col, [("Threads", f"{available()} (all)")])


class FASTGS_PT_render(_Engine, bpy.types.Panel):
    bl_label = "FAST-GS"

    def draw(self, context):
        layout = split(self.layout, decorate=False)
        draw_device(layout, context)
        layout.prop(context.scene.fastgs, "depth")
        layout.prop(context.scene.fastgs, "sorting")
        draw_threads(layout, context.scene.render)
        draw_rows(layout, facts.scene_facts(context.scene))
        draw_meshes(layout, context.scene)
        draw_unshown(layout, context)


class FASTGS_PT_film(_Engine, bpy.types.Panel):
    bl_label = "Film"

    def draw(self, context):
        layout = split(self.layout)
        layout.prop(context.scene.render, "film_transparent", text="Transparent")
        draw_column(layout, context.scene.fastgs, "use_meshes", active=not holdout.with_meshes(context.scene))


class FASTGS_PT_motion_blur(_Engine, bpy.types.Panel):
    bl_label = "Motion Blur"
    bl_options = {'DEFAULT_CLOSED'}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context):
        layout, render = split(self.layout), context.scene.render
        layout.active = render.use_motion_blur
        col = layout.column()
        col.prop(render, "motion_blur_position", text="Position")
        col.prop(render, "motion_blur_shutter")
        col.prop(context.scene.fastgs, "blur_steps")


class FASTGS_PT_shutter_curve(_Engine, bpy.types.Panel):
    bl_label = "Shutter Curve"
    bl_parent_id = "FASTGS_PT_motion_blur"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        self.layout.active = context.scene.render.use_motion_blur
        self.layout.template_curve_mapping(context.scene.render, "motion_blur_shutter_curve")


class FASTGS_PT_depth_of_field(_Engine, bpy.types.Panel):
    bl_label = "Depth of Field"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        layout = split(self.layout)
        layout.prop(context.scene.fastgs, "lens_samples")
        draw_trouble(layout, context, "The camera's own settings say what is sharp", 'INFO')


class FASTGS_PT_shadows(_Engine, bpy.types.Panel):
    bl_label = "Splat Shadows"
    bl_options = {'DEFAULT_CLOSED'}

    def draw(self, context):
        layout, settings = split(self.layout), context.scene.fastgs
        lamps = sorted((obj for obj in context.scene.objects if shadows.is_lamp(obj)), key=lambda obj: obj.name_full)
        col = layout.column(heading="Of Lamps", align=True)
        for lamp in lamps:
            col.prop(lamp.fastgs, "splat_shadow", text=lamp.name)
        if not lamps:
            draw_trouble(layout, context, "The scene has no sun, spot or area light", 'INFO')
        chosen = shadows.lamps(context.scene)
        draw_column(layout, settings, "shadow_samples", "shadow_bias", active=bool(chosen))
        if chosen and not (context.view_layer.fastgs.use_pass_shadow or holdout.with_meshes(context.scene)):
            draw_trouble(layout, context, "Choose Render With Meshes, or switch on the pass Splat Shadow", 'INFO')


class FASTGS_PT_passes(_Engine, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        layout = split(self.layout, decorate=False)
        layer = context.view_layer
        col = layout.column(heading="Include")
        for switch, name in {entry.switch: entry.title or entry.blender for entry in PASSES.values() if entry.switch}.items():
            group, _, prop = switch.rpartition(".")
            col.prop(getattr(layer, group) if group else layer, prop, text=name)
        if layer.use_pass_cryptomatte_object:
            layout.prop(layer, "pass_cryptomatte_depth", text="Cryptomatte Levels")


def _mesh_layer(context):
    """The view layer of the meshes beside the open one, None where there is none."""
    other = mesh_scene.of(context.scene)
    return other and other.view_layers.get(context.view_layer.name)


class FASTGS_PT_mesh_passes(_Engine, bpy.types.Panel):
    bl_label = "Passes of Meshes"
    bl_parent_id = "FASTGS_PT_passes"
    bl_context = "view_layer"
    bl_options = {'DEFAULT_CLOSED'}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and _mesh_layer(context) is not None

    def draw(self, context):
        layout, layer = split(self.layout, decorate=False), _mesh_layer(context)
        col = layout.column(heading="Include")
        for name in MESH_PASSES[context.scene.fastgs.render_meshes] if layer else ():
            col.prop(layer, f"use_pass_{name}")
        layout.prop(context.scene.fastgs, "write_passes")


class FASTGS_PT_ray_visibility(_Engine, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_parent_id = "OBJECT_PT_visibility"
    bl_context = "object"

    def draw(self, context):
        layout = split(self.layout)
        layout.prop(context.object, "visible_camera", text="Camera")
        layout.prop(context.object, "visible_shadow", text="Shadow")
        if context.object.type in objects.MESHABLE and not objects.is_splat(context.object):
            draw_column(layout, context.object.fastgs, "hides_splats",
                        active=context.scene.fastgs.use_meshes or holdout.with_meshes(context.scene))
            draw_column(layout, context.object, "is_shadow_catcher", active=context.scene.fastgs.render_meshes == 'CYCLES')


class FASTGS_PT_other_engine(bpy.types.Panel):
    """What another engine renders of splats."""

    bl_space_type, bl_region_type, bl_context = 'PROPERTIES', 'WINDOW', "render"
    bl_label = "Splats in This Engine"

    @classmethod
    def poll(cls, context):
        return context.engine != 'FASTGS' and any(objects.is_splat(obj) for obj in context.scene.objects)

    def draw(self, context):
        layout = self.layout
        text = "This engine shows a few solid points in place of splats; FAST-GS renders the splats, and a native copy holds them all."
        draw_trouble(layout, context, text)
        draw_other_engine(layout, context)
        layout.operator("fastgs.make_mesh", icon='MESH_DATA')
        layout.operator_menu_enum("fastgs.native_copy", "kind", icon='POINTCLOUD_DATA')
