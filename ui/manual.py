# SPDX-License-Identifier: GPL-3.0-or-later
"""Online Manual, in the context menu of buttons and with F1, opens the page of the documentation that comes with the extension."""
from __future__ import annotations

from pathlib import Path

import bpy

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = (
    ("bpy.ops.fastgs.bake*", "baking.md"),
    ("bpy.ops.fastgs.train*", "training-in-blender.md"),
    ("bpy.ops.fastgs.*training_python*", "training-in-blender.md"),
    ("bpy.ops.fastgs.capture_scene*", "training-in-blender.md"),
    ("bpy.types.fastgs_pg_training*", "training-in-blender.md"),
    ("bpy.ops.fastgs.check_capture*", "captures.md"),
    ("bpy.ops.fastgs.import_capture*", "captures.md"),
    ("bpy.ops.export_scene.fastgs*", "formats.md"),
    ("bpy.ops.fastgs.export_native*", "formats.md"),
    ("bpy.ops.import_scene.fastgs*", "guide.md"),
    ("bpy.ops.fastgs.*", "guide.md"),
    ("bpy.types.fastgs_*", "guide.md"),
)
"""Patterns of operators and properties, all in lower case, and their pages; the first that fits counts."""


def pages() -> tuple[str, tuple[tuple[str, str], ...]]:
    """What Blender's View Manual asks for: where pages lie, and which is whose."""
    return DOCS.as_uri() + "/", PAGES


def register():
    bpy.utils.register_manual_map(pages)


def unregister():
    bpy.utils.unregister_manual_map(pages)
