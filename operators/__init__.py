# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: thin modules, one a menu entry, over what scene/ and engine/ do."""
from importlib import util

import bpy

from ..scene.registration import classes_of
from . import (
    add_relight,
    align_pairs,
    align_world,
    bake,
    camera_life,
    camera_moves,
    camera_path_files,
    capture_cameras,
    capture_scene,
    capture_view,
    check_capture,
    clean_up,
    clip,
    crop,
    effects,
    example,
    export_native,
    export_page,
    export_splats,
    filters,
    fit_scene,
    gpus,
    grow,
    import_model,
    light_probe,
    look,
    maintenance,
    make_loop,
    make_mesh,
    native_copy,
    parts,
    reload,
    select_gaussians,
    select_kind,
    select_splats,
    stitch,
    sync_cameras,
    train,
    training_python,
    training_runs,
    upright,
    view_camera,
)

if util.find_spec(f"{__package__}.make_environment"):  # not in the zip for Blender's store
    from . import make_environment
    MAKING = (make_environment,)
else:
    MAKING = ()

CLASSES = classes_of(
    add_relight, align_pairs, align_world, bake, camera_life, camera_moves, camera_path_files, capture_cameras, capture_scene,
    capture_view, check_capture, clean_up, clip, crop, effects, example, export_native, export_page, export_splats, filters, fit_scene,
    gpus, grow, import_model, light_probe, look, maintenance, make_loop, make_mesh, native_copy, parts, reload, select_gaussians,
    select_kind, select_splats, stitch, sync_cameras, train, training_python, training_runs, upright, view_camera, *MAKING,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
