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
    composite,
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

CLASSES = (
    FASTGS_OT_import,
    FASTGS_FH_import,
    FASTGS_OT_import_example,
    FASTGS_OT_reload,
    *fit_scene.CLASSES,
    FASTGS_OT_bake,
    *camera_moves.CLASSES,
    *camera_life.CLASSES,
    *capture_cameras.CLASSES,
    *capture_view.CLASSES,
    *check_capture.CLASSES,
    *camera_path_files.CLASSES,
    *align_world.CLASSES,
    *clip.CLASSES,
    *crop.CLASSES,
    *brush.CLASSES,
    *effects.CLASSES,
    *export_splats.CLASSES,
    *export_native.CLASSES,
    *filters.CLASSES,
    *gpus.CLASSES,
    *composite.CLASSES,
    *look.CLASSES,
    *maintenance.CLASSES,
    *native_copy.CLASSES,
    *select_splats.CLASSES,
    *training_python.CLASSES,
    *capture_scene.CLASSES,
    *sync_cameras.CLASSES,
    *train.CLASSES,
    *training_runs.CLASSES,
    *upright.CLASSES,
    *view_camera.CLASSES,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
