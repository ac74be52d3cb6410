# SPDX-License-Identifier: GPL-3.0-or-later
"""Knows what of a scene is as Blender's startup file has it, and nobody's choice yet."""
from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

DULL = "AgX"
"""The view transform of new scenes: it takes colours for light of a scene and compresses them once more."""
REMARK = (f"The scene's view transform is Blender's usual {DULL}, which dulls captured colours; Standard shows them as they were filmed "
          "(a button in the FAST-GS tab sets it)")


def dulls_colours(scene: bpy.types.Scene) -> bool:
    """Whether a scene has the view settings of a new one, with which captures look duller than they were filmed."""
    view = scene.view_settings
    return (view.view_transform == DULL and view.look in ("", "None") and view.exposure == 0 and view.gamma == 1
            and not view.use_curve_mapping)


def hide_cube(context, splats: list[bpy.types.Object], eyes: list[Vector]) -> bpy.types.Object | None:
    """Hide the startup file's cube, in viewports and renders, where it is untouched and stands in a splat object, or between it and one of
    the places (`eyes`) that it is looked at from; returns it."""
    if bpy.data.filepath:
        return None
    for obj in context.view_layer.objects:
        if _is_startup_cube(obj) and not obj.hide_get() and any(_in_the_way(obj, splat, eyes) for splat in splats):
            obj.hide_set(True)
            obj.hide_render = True
            return obj
    return None


def _is_startup_cube(obj) -> bool:
    if not (obj.name == "Cube" and obj.type == 'MESH' and obj.matrix_world == Matrix.Identity(4) and obj.mode == 'OBJECT'):
        return False
    if obj.modifiers or obj.constraints or obj.children or obj.parent or obj.animation_data or len(obj.data.vertices) != 8:
        return False
    return all(abs(abs(x) - 1) < 1e-6 for vertex in obj.data.vertices for x in vertex.co)


def _in_the_way(obj, splat, eyes) -> bool:
    """Whether an object's bounds meet those of a splat object, or of this and one of the eyes together."""
    corners, place = _corners(obj), _corners(splat)
    low, high = corners.min(0), corners.max(0)
    spaces = [place, *(np.array([*place, eye]) for eye in eyes)]
    return any((low <= space.max(0)).all() and (space.min(0) <= high).all() for space in spaces)


def _corners(obj) -> np.ndarray:
    return np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
