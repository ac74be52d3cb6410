# SPDX-License-Identifier: GPL-3.0-or-later
"""Knows what of a scene is as Blender's startup file has it, and nobody's choice yet."""
import bpy
import numpy as np
from mathutils import Matrix, Vector

DULL = "AgX"
"""The view transform of new scenes: it takes colours for light of a scene and compresses them once more."""
ENGINES = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT")
"""The render engine of new scenes, in all releases."""
CLOCK = {"frame_start": 1, "frame_end": 250, "frame_current": 1}
PLACES = {"Light": ((4.0762, 1.0055, 5.9039), (0.6503, 0.0552, 1.8664)), "Camera": ((7.3589, -6.9258, 4.9583), (1.1093, 0.0, 0.8149))}
"""Where the startup file's other objects stand, and how they are turned."""
REMARK = (f"The scene's view transform is Blender's usual {DULL}, which dulls captured colours; Standard shows them as they were filmed "
          "(a button in the FAST-GS tab sets it)")


def dulls_colours(scene: bpy.types.Scene) -> bool:
    """Whether a scene has the view settings of a new one, with which captures look duller than they were filmed."""
    view = scene.view_settings
    return (view.view_transform == DULL and view.look in ("", "None") and view.exposure == 0 and view.gamma == 1
            and not view.use_curve_mapping)


def is_untouched(scene: bpy.types.Scene) -> bool:
    """Whether a scene is a new one: it holds what the startup file holds, or less, as it is there, and has a new one's engine and clock."""
    render = scene.render
    return (not bpy.data.filepath and len(bpy.data.scenes) == 1 and render.engine in ENGINES and (render.fps, render.fps_base) == (24, 1)
            and all(getattr(scene, name) == value for name, value in CLOCK.items()) and scene.animation_data is None
            and all(_is_startup_cube(obj) or _stands_as_in_startup(obj) for obj in scene.objects))


def _stands_as_in_startup(obj) -> bool:
    """Whether an object is the startup file's lamp or camera, as it is there."""
    if obj.name not in PLACES or _has_more(obj) or any(abs(x - 1) > 1e-6 for x in obj.scale):
        return False
    known, there = np.ravel(PLACES[obj.name]), np.ravel([obj.location, obj.rotation_euler])
    if np.abs(known - there).max() > 1e-3 or obj.data.animation_data:
        return False
    return obj.data.type == 'PERSP' and obj.data.lens == 50 if obj.type == 'CAMERA' else obj.type == 'LIGHT' and obj.data.type == 'POINT'


def _has_more(obj) -> bool:
    return bool(obj.modifiers or obj.constraints or obj.children or obj.parent or obj.animation_data)


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
    if _has_more(obj) or len(obj.data.vertices) != 8:
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
