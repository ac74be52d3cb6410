# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's entries in Blender's menus."""
import bpy

from ..fastgs_blender.formats import readable


def draw_import(self, context):
    """File > Import."""
    self.layout.operator("import_scene.fastgs", text=f"4D Gaussians ({'/'.join(n for n in readable() if n.startswith('.'))})")
    self.layout.operator("fastgs.import_example", text="4D Gaussians: Example")
    self.layout.operator("fastgs.import_capture", text="Capture Cameras")
    self.layout.operator("fastgs.import_camera_path", text="Camera Path (.json/.ssproj/COLMAP)")


def draw_export(self, context):
    """File > Export."""
    self.layout.operator("export_scene.fastgs", text="4D Gaussians (.ply/.spz/.sog/.splat/.glb/.safetensors/.splatv)")
    self.layout.operator("fastgs.export_native", text="Native Splats (.ply)")
    self.layout.operator("fastgs.export_camera_path", text="Camera Path (.json/COLMAP)")


def draw_bake(self, context):
    """The 3D view's Object menu."""
    self.layout.separator()
    self.layout.operator("fastgs.bake")


MENUS = (
    (bpy.types.TOPBAR_MT_file_import, draw_import),
    (bpy.types.TOPBAR_MT_file_export, draw_export),
    (bpy.types.VIEW3D_MT_object, draw_bake),
)


def register():
    for menu, draw in MENUS:
        menu.append(draw)


def unregister():
    for menu, draw in MENUS:
        menu.remove(draw)
