# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's entries in Blender's menus and panels, its shortcuts, and the pages that Online Manual (F1) opens for its buttons."""
import bpy

from ..scene import pages as documentation
from .object_panels import draw_size

_shortcuts = []


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

PAGES = (
    ("bpy.ops.fastgs.bake*", "baking"),
    ("bpy.ops.fastgs.train*", "training-in-blender"),
    ("bpy.ops.fastgs.*training_python*", "training-in-blender"),
    ("bpy.ops.fastgs.capture_scene*", "training-in-blender"),
    ("bpy.types.fastgs_pg_training*", "training-in-blender"),
    ("bpy.ops.fastgs.check_capture*", "captures"),
    ("bpy.ops.fastgs.import_capture*", "captures"),
    ("bpy.ops.export_scene.fastgs*", "formats"),
    ("bpy.ops.fastgs.export_native*", "formats"),
    ("bpy.ops.import_scene.fastgs*", "guide"),
    *((f"bpy.ops.fastgs.{name}*", "parts") for name in (
        "select_", "separate", "join_parts", "show_whole", "erase", "show_hidden", "invert_hidden", "delete_for_good", "clean_up", "grow",
        "add_crop", "remove_crop", "add_filter", "remove_filter")),
    ("bpy.ops.fastgs.*", "guide"),
    ("bpy.types.fastgs_*", "guide"),
)
"""Patterns of operators and properties, all in lower case, and their pages; the first that fits counts."""


def pages() -> tuple[str, tuple[tuple[str, str], ...]]:
    """What Blender's View Manual asks for: where pages lie, and which is whose."""
    return documentation.DOCS.as_uri() + "/", tuple((pattern, documentation.path(name).name) for pattern, name in PAGES)


def _add_shortcuts():
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is None:  # in background there are no shortcuts
        return
    keymap = keys.keymaps.new("Object Mode")
    for button in ('LEFTMOUSE', 'RIGHTMOUSE'):  # the operator knows which of them selects
        for shift in (False, True):
            item = keymap.keymap_items.new("fastgs.select", button, 'CLICK', shift=shift)
            item.properties.toggle = shift
            _shortcuts.append((keymap, item))
    keymap = keys.keymaps.new("3D View", space_type='VIEW_3D')
    _shortcuts.append((keymap, keymap.keymap_items.new("fastgs.key_from_view", 'K', 'PRESS', ctrl=True, alt=True)))


def register():
    for menu, draw in MENUS:
        menu.append(draw)
    _add_shortcuts()
    bpy.utils.register_manual_map(pages)


def unregister():
    bpy.utils.unregister_manual_map(pages)
    for keymap, item in _shortcuts:
        keymap.keymap_items.remove(item)
    _shortcuts.clear()
    for menu, draw in MENUS:
        menu.remove(draw)
