# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's entries in Blender's menus and panels."""
import bpy

from .object_panels import draw_size


def draw_import(self, context):
    """File > Import."""
    self.layout.operator("import_scene.fastgs", text="4D Gaussians (.ply/.spz/.sog/...)")
    self.layout.operator("fastgs.import_example", text="4D Gaussians: Example")
    self.layout.operator("fastgs.import_capture", text="Capture Cameras")
    self.layout.operator("fastgs.import_camera_path", text="Camera Path (.json/...)")


def draw_export(self, context):
    """File > Export."""
    self.layout.operator("export_scene.fastgs", text="4D Gaussians (.ply/.spz/.sog/...)")
    self.layout.operator("fastgs.export_page", text="4D Gaussians: Web Page (.html)")
    self.layout.operator("fastgs.export_native", text="Native Splats (.ply)")
    self.layout.operator("fastgs.export_camera_path", text="Camera Path (.json/...)")


def draw_bake(self, context):
    """The 3D view's Object menu."""
    self.layout.separator()
    self.layout.operator("fastgs.bake")


def draw_camera(self, context):
    """Where Blender adds cameras and lets them look as the view does."""
    self.layout.operator("fastgs.camera_from_view", icon='OUTLINER_OB_CAMERA')


def draw_camera_below(self, context):
    """The same, below a line."""
    self.layout.separator()
    draw_camera(self, context)


def draw_light_probe(self, context):
    """The 3D view's menu Add > Light Probe."""
    self.layout.separator()
    self.layout.operator("fastgs.add_light_probe", text="Of 4D Gaussians", icon='LIGHTPROBE_SPHERE')


def draw_sound(self, context):
    """The sequencer's Add menu."""
    self.layout.separator()
    self.layout.operator_context = 'INVOKE_DEFAULT'
    self.layout.operator("fastgs.add_sound", text="Sound of 4D Gaussians", icon='SOUND')


def draw_select(self, context):
    """The 3D view's Select menu."""
    self.layout.separator()
    self.layout.menu("FASTGS_MT_select")


MENUS = (
    (bpy.types.TOPBAR_MT_file_import, draw_import),
    (bpy.types.TOPBAR_MT_file_export, draw_export),
    (bpy.types.VIEW3D_MT_object, draw_bake),
    (bpy.types.VIEW3D_MT_select_object, draw_select),
    (bpy.types.VIEW3D_MT_camera_add, draw_camera),
    (bpy.types.VIEW3D_MT_view_cameras, draw_camera_below),
    (bpy.types.VIEW3D_MT_view_align, draw_camera_below),
    (bpy.types.VIEW3D_MT_object_context_menu, draw_camera_below),
    (bpy.types.VIEW3D_MT_lightprobe_add, draw_light_probe),
    (bpy.types.SEQUENCER_MT_add, draw_sound),
    (bpy.types.OBJECT_PT_transform, draw_size),
)


def register():
    for menu, draw in MENUS:
        menu.append(draw)


def unregister():
    for menu, draw in MENUS:
        menu.remove(draw)
