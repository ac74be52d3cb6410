# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels and preferences."""
import bpy

from ..scene import settings
from . import (
    camera_panel,
    capture_panel,
    keymap,
    manual,
    menus,
    object_panels,
    preferences,
    render_panels,
    splats_panel,
    tools,
    training_panel,
    viewport_panel,
)

CLASSES = tuple(cls for module in (
    object_panels, render_panels, splats_panel, viewport_panel, camera_panel, capture_panel, training_panel, preferences,
) for cls in module.CLASSES)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    menus.register()
    keymap.register()
    tools.register()
    manual.register()
    training_panel.register()
    if settings.preferences():
        settings.apply(settings.preferences())


def unregister():
    training_panel.unregister()
    manual.unregister()
    tools.unregister()
    keymap.unregister()
    menus.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
