# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels."""
import bpy

from . import object_panels, render_panels

CLASSES = object_panels.CLASSES + render_panels.CLASSES


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
