# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels and preferences."""
import bpy

from ..scene import settings
from ..scene.registration import classes_of
from . import (
    menus,
    object_panels,
    parts_panel,
    preferences,
    render_panels,
    sidebar,
    splats_panel,
    tools,
    training_panel,
)

CLASSES = classes_of(object_panels, render_panels, splats_panel, parts_panel, sidebar, training_panel, preferences)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register():
    register_classes()
    menus.register()
    tools.register()
    training_panel.register()
    if settings.preferences():
        settings.apply(settings.preferences())


def unregister():
    training_panel.unregister()
    tools.unregister()
    menus.unregister()
    unregister_classes()
