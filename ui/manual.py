# SPDX-License-Identifier: GPL-3.0-or-later
"""Online Manual, in the context menu of buttons and with F1, opens the page of the documentation that comes with the extension."""
import bpy

from ..scene import pages as documentation

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


def register():
    bpy.utils.register_manual_map(pages)


def unregister():
    bpy.utils.unregister_manual_map(pages)
