# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: thin modules, one a menu entry, over what scene/ and engine/ do."""
import bpy

from . import (
    align_world,
    brush,
    camera_life,
    camera_moves,
    camera_path_files,
    capture_cameras,
    capture_scene,
    capture_view,
    check_capture,
    clip,
    crop,
    effects,
    export_native,
    export_splats,
    filters,
    fit_scene,
    gpus,
    look,
    maintenance,
    native_copy,
    select_splats,
    sync_cameras,
    train,
    training_python,
    training_runs,
    upright,
    view_camera,
)
from .bake import FASTGS_OT_bake
from .example import FASTGS_OT_import_example
from .import_model import FASTGS_FH_import, FASTGS_OT_import
from .reload import FASTGS_OT_reload

CLASSES = (FASTGS_OT_import, FASTGS_FH_import, FASTGS_OT_import_example, FASTGS_OT_reload, FASTGS_OT_bake, *(cls for module in (
    fit_scene, camera_moves, camera_life, capture_cameras, capture_view, check_capture, camera_path_files, align_world, clip, crop,
    brush, effects, export_splats, export_native, filters, gpus, look, maintenance, native_copy, select_splats,
    training_python, capture_scene, sync_cameras, train, training_runs, upright, view_camera,
) for cls in module.CLASSES))


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
