# SPDX-License-Identifier: GPL-3.0-or-later
"""What users do with 4D Gaussians in Blender: import, reload, fit the scene to a capture, bake."""
import bpy

from . import maintenance, menus
from .bake import FASTGS_OT_bake
from .fit_scene import FASTGS_OT_fit_scene
from .import_model import FASTGS_FH_import, FASTGS_OT_import
from .reload import FASTGS_OT_reload

CLASSES = (
    FASTGS_OT_import,
    FASTGS_FH_import,
    FASTGS_OT_reload,
    FASTGS_OT_fit_scene,
    FASTGS_OT_bake,
    *maintenance.CLASSES,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    menus.register()


def unregister():
    menus.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
