# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts two splat objects together: which is moved onto which, moving it, keys that fade one into the other, and the settings of a loop."""
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ..fastgs_blender.rendering.instances import Instance
from ..fastgs_blender.stitching.loops import Loop
from ..fastgs_blender.util.errors import FastGSError
from . import model_space, objects, parts, snapshot
from .cameras import keys, worlds

PLACES = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale", "delta_location", "delta_rotation_euler",
          "delta_rotation_quaternion", "delta_scale")
"""What moves an object by keys or drivers."""
CLOSE = 1e-4
"""Share of its size by which an object may stand elsewhere than it was put."""


def pair(context) -> tuple[bpy.types.Object, bpy.types.Object] | None:
    """(the other, the active) of exactly two selected splat objects; None where it is not so."""
    chosen = [obj for obj in context.selected_objects if objects.is_splat(obj)]
    if len(chosen) != 2 or context.object not in chosen:
        return None
    return next(obj for obj in chosen if obj != context.object), context.object


def shown(obj, depsgraph) -> Instance:
    """What an object shows on the frame, in the world, as the library's instance.  Raises FastGSError where it shows nothing."""
    evaluated = obj.evaluated_get(depsgraph)
    item = snapshot.instance_of(evaluated, depsgraph, model_space.placement(evaluated), final=True)
    found, left_out = snapshot.Snapshot([replace(item, retime=replace(item.retime, echoes=0))], *snapshot.clock(depsgraph.scene)).load()
    if left_out:
        raise FastGSError(f'"{obj.name}": {left_out[0][1]}')
    if not found:
        raise FastGSError(f'"{obj.name}" shows nothing on this frame; go to a frame of its clip.')
    return max(found, key=lambda instance: instance.settings.opacity)


def check_movable(obj, fixed) -> None:
    """Raise FastGSError where an object cannot be moved onto another, or would not stay there."""
    objects.check_editable(obj, "moved")
    above = fixed
    while above is not None:
        if above == obj:
            raise FastGSError(f'"{fixed.name}" is a child of "{obj.name}" and would move with it; align the other way round.')
        above = above.parent
    for path in PLACES:
        if keys.is_animated(obj, path, 4):
            raise FastGSError(f'the place of "{obj.name}" is animated, so it would not stay where it is put; parent it to an empty, '
                              "and clear its keys and drivers.")


def move(context, obj, fixed, motion: np.ndarray) -> None:
    """Move an object by a motion [4, 4] of the world, and the cameras of its capture with it.

    Raises FastGSError, and moves nothing, where its constraints or parents let it stand elsewhere.
    """
    check_movable(obj, fixed)
    matrix, before = Matrix(motion.tolist()), obj.matrix_world.copy()
    wanted, basis = matrix @ before, obj.matrix_basis.copy()
    with_it = [other for other in context.scene.objects if other.type == 'EMPTY' and worlds.is_world(other) and other.parent is None
               and worlds.lie_alike(other, obj) and not worlds.lie_alike(other, fixed)]
    obj.matrix_world = wanted
    context.view_layer.update()
    size = max(np.abs(np.array(wanted)[:3, :3]).max(), np.abs(np.array(wanted)[:3, 3]).max() * 0.1, 1e-6)
    if np.abs(np.array(obj.matrix_world) - np.array(wanted)).max() > CLOSE * size:
        obj.matrix_basis = basis
        context.view_layer.update()
        raise FastGSError(f'"{obj.name}" does not stay where it is put: a constraint holds it, or a parent stretches it; clear that first.')
    for other in with_it:
        other.matrix_world = matrix @ other.matrix_world
    context.view_layer.update()


def grade(obj, looks: dict) -> None:
    """Give an object looks.  Raises FastGSError where keys or drivers hold one of them, or it is linked."""
    objects.check_editable(obj, "graded")
    for name in looks:
        if keys.is_animated(obj, f"fastgs.{name}", 3):
            raise FastGSError(f'the {name} of "{obj.name}" is animated and would not stay; clear its keys first.')
    for name, value in looks.items():
        setattr(obj.fastgs, name, value)
    obj.update_tag()


def cross_fade(before, after, first: float, frames: float, overlap: float) -> None:
    """Key the opacities of two objects so that from a frame on the one goes and the other comes, in so many frames; other keys stay.

    overlap  share of the time in which both are shown fully: 0 fades both over all of it, 1 shows both in the middle

    Keys are linear, so that sub-frames are exact.  Raises FastGSError where an opacity has a driver.
    """
    for obj in (before, after):
        if keys.driver_of(obj, "fastgs.opacity"):
            raise FastGSError(f'a driver sets the opacity of "{obj.name}"; remove it, so that it can be keyed.')
        objects.check_editable(obj, "keyed")
    long = frames * (1 - overlap / 2)  # of each fade: with an overlap of 1 the one ends where the other begins
    for obj, begins, values in ((before, first + frames - long, (1.0, 0.0)), (after, first, (0.0, 1.0))):
        full = _full(obj, first if obj == before else first + frames)
        curve = keys.curve_of(obj, "fastgs.opacity")
        if curve is not None:
            for point in [p for p in curve.keyframe_points if first - 1e-4 <= p.co.x <= first + frames + 1e-4][::-1]:
                curve.keyframe_points.remove(point)
        for frame, value in zip((begins, begins + long), values, strict=True):
            obj.fastgs.opacity = value * full
            obj.keyframe_insert("fastgs.opacity", frame=frame)
        for point in keys.curve_of(obj, "fastgs.opacity").keyframe_points:
            if first - 1e-4 <= point.co.x <= first + frames - 1e-4:
                point.interpolation = 'LINEAR'
        obj.update_tag()


def _full(obj, frame: float) -> float:
    """The opacity that an object has on a frame, beside a fade; 1 where that is nothing."""
    curve = keys.curve_of(obj, "fastgs.opacity")
    value = obj.fastgs.opacity if curve is None else curve.evaluate(frame)
    return value if value > 1e-6 else max([1.0] if curve is None else [p.co.y for p in curve.keyframe_points] + [1e-6])


def check_loop(obj) -> None:
    """Raise FastGSError where a loop's settings would not show."""
    for name in ("trim_start", "trim_end", "fade"):
        if keys.is_animated(obj, f"fastgs.{name}"):
            raise FastGSError(f'the {name.replace("_", " ")} of "{obj.name}" is animated; clear its keys and drivers first.')


def loop(obj, found: Loop) -> None:
    """Let an object play a loop of its clip over and over, before its start frame as well as after its end."""
    settings = obj.fastgs
    settings.trim_start, settings.fade = found.start, found.fade
    # Retime counts the frames from the first to the last one that is left: a loop of n frames that fades over c has n + c
    settings.trim_end = max(settings.frame_count - (found.start + found.length + found.fade), 0.0)
    settings.before = settings.after = 'LOOP'
    obj.update_tag()


def playing(obj, scene) -> tuple[list, list]:
    """The other objects of a scene that show the same file: those that play it as this one does and can be looped, and all others."""
    path, now = objects.abspath(obj), snapshot.clock(scene)[0]
    same, left = [], []
    for other in scene.objects:
        if other == obj or not objects.is_splat(other) or objects.abspath(other) != path:
            continue
        alike = other.is_editable and snapshot.retime_of(other, now) == snapshot.retime_of(obj, now)
        try:
            check_loop(other)
        except FastGSError:
            alike = False
        (same if alike else left).append(other)
    return same, left


def looped(obj, depsgraph):
    """What find_loop() looks at of an object: what it and those that play alike show of the file, and its settings.  Raises FastGSError."""
    settings = replace(snapshot.settings_of(obj.evaluated_get(depsgraph), depsgraph, True), opacity=1.0)
    every = [obj, *(other for other in playing(obj, depsgraph.scene)[0] if not other.hide_render)]
    own = "" if any(not each.fastgs.part for each in every) else parts.union(*(each.fastgs.part for each in every))
    erased = parts.union(*(each.fastgs.mask for each in every))
    return parts.part_of(objects.load_model(objects.abspath(obj)), own), replace(settings, mask=parts.within(own, erased))
