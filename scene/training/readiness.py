# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks before a run is started whether it can be started; reads no pictures, so that a panel can ask at each redraw."""
import bpy

from ...fastgs_blender.util.errors import FastGSError
from ..filming import progress
from . import installation, plates


def source_trouble(context: bpy.types.Context) -> str:
    """What is wrong with the panel's source; "" where nothing is known to be."""
    settings = context.scene.fastgs.training
    if settings.source == 'SCENE':
        return filming_trouble(context, settings.cameras)
    if settings.source == 'CAMERAS':
        count = plates.count(context.scene)
        return "" if count > 1 else (f"{count or 'none'} of the scene's cameras has a film or an image sequence as background, and "
                                     "training needs several; import a capture's cameras, or give the cameras background images.")
    try:
        installation.capture_path(settings.capture)
    except FastGSError as error:
        return str(error)
    return ""


def filming_trouble(context: bpy.types.Context, cameras: str) -> str:
    """Why the open scene cannot be filmed now by those cameras of CaptureOptions; "" where it can."""
    if progress.current is not None:
        return "the scene is being filmed."
    if context.mode != 'OBJECT':
        return "filming begins in Object Mode; go there first."
    if count_of_cameras(context, cameras, 2) < 2:
        return "fewer than two cameras are chosen, and a capture needs several; select more, or choose new cameras."
    return ""


def count_of_cameras(context: bpy.types.Context, cameras: str, new: int) -> int:
    """How many cameras film: of the scene's own as CaptureOptions.cameras has it, else that many new ones."""
    pool = {'SELECTED': context.selected_objects, 'ALL': context.scene.objects}.get(cameras)
    return new if pool is None else sum(obj.type == 'CAMERA' for obj in pool)
