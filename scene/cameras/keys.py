# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth camera moves as ordinary keyframes, or as a curve that shows them first."""
from collections.abc import Callable

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

from ...fastgs_blender.cameras.moves import Path

PREVIEW = "Camera Path Preview"
NUDGE = 1e-3
"""Frames between the samples from which a key's slope is read."""


def pose(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Position [3] and unit quaternion [4] of an object in the world."""
    location, rotation, _ = obj.matrix_world.decompose()
    return np.array(location), np.array(rotation)


def curves(owner: bpy.types.ID):
    """The F-curves of a datablock; () where nothing animates it."""
    if not (owner.animation_data and owner.animation_data.action):
        return ()
    return _curves(owner.animation_data.action, getattr(owner.animation_data, "action_slot", None))


def _curves(action: bpy.types.Action, slot):
    """The F-curves of an action and its slot, where this Blender keeps them."""
    if bpy.app.version < (4, 4, 0):
        return action.fcurves
    from bpy_extras import anim_utils

    bag = anim_utils.action_get_channelbag_for_slot(action, slot)
    return () if bag is None else bag.fcurves


def curve_of(owner: bpy.types.ID, path: str) -> bpy.types.FCurve | None:
    """The F-curve that animates a property, by the property's path with an index where it has several numbers; None: no curve does."""
    animation = owner.animation_data
    if animation is None or animation.action is None:
        return None
    return curve_in(animation.action, getattr(animation, "action_slot", None), path)


def curve_in(action: bpy.types.Action, slot, path: str) -> bpy.types.FCurve | None:
    """The same of an action."""
    found = _curves(action, slot)
    return next((curve for curve in found if _animates(curve, path) and len(curve.keyframe_points) + len(curve.modifiers)), None)


def driver_of(owner: bpy.types.ID, path: str) -> bpy.types.FCurve | None:
    """The F-curve of the driver of a property, by the same path; None: it has no driver."""
    animation = owner.animation_data
    return None if animation is None else next((curve for curve in animation.drivers if _animates(curve, path)), None)


def is_animated(owner: bpy.types.ID, path: str, count: int = 0) -> bool:
    """Whether a curve or a driver animates a property, or one of its so many numbers."""
    paths = (path, *(f"{path}[{i}]" for i in range(count)))
    return any(curve_of(owner, each) is not None or driver_of(owner, each) is not None for each in paths)


def _animates(curve, path: str) -> bool:
    muted = curve.mute or (curve.group is not None and curve.group.mute)
    return not muted and path in (curve.data_path, f"{curve.data_path}[{curve.array_index}]")


def key_frames(first: float, last: float, every: float) -> np.ndarray:
    """Frames from first to last, both of them keyed, about `every` apart."""
    return np.linspace(first, last, max(round((last - first) / max(every, 1e-3)), 1) + 1)


def animate(camera: bpy.types.Object, move: Callable[[np.ndarray], Path], frames: np.ndarray) -> None:
    """Key location, rotation and focal length of a camera object; move(frames [M]) gives the Path in the world.

    Between keys the curves follow the move: each key's handles lie along its slope.  Keys within the range are replaced,
    others stay.
    """
    around = np.stack([frames - NUDGE, frames, frames + NUDGE], 1)
    around[0, 0], around[-1, 2] = frames[0], frames[-1]
    path = move(around.ravel())
    location, rotation = _local(camera, path)
    parts = [(camera, "location", location), (camera, rotation_path(camera), rotation)]
    if np.ptp(path.focal) > 1e-6 * path.focal.max() or (camera.data.animation_data and camera.data.animation_data.action):
        parts.append((camera.data, "lens", path.focal[:, None]))
    else:
        camera.data.lens = path.focal[0]
    for owner, name, values in parts:
        values = values.reshape(len(frames), 3, -1)
        slopes = (values[:, 2] - values[:, 0]) / (around[:, 2] - around[:, 0])[:, None]
        write(owner, name, frames, values[:, 1], slopes)


def write(owner: bpy.types.ID, name: str, frames: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> None:
    """Key a property [M, D] of an object or its data, by its path, with Bezier handles along slopes [M, D], per frame."""
    single = isinstance(owner.path_resolve(name), float)
    owner.keyframe_insert(name, frame=frames[0])
    found = curves(owner)
    for i in range(values.shape[1]):
        curve = found.find(name, index=0 if single else i)
        points = curve.keyframe_points
        for point in [p for p in points if frames[0] - 1e-4 <= p.co.x <= frames[-1] + 1e-4][::-1]:
            points.remove(point, fast=True)
        start = len(points)
        keys = sorted([*((p.co.x, None) for p in points), *((f, k) for k, f in enumerate(frames))])
        points.add(len(frames))
        for k in range(len(frames)):
            points[start + k].co = frames[k], values[k, i]
        points.sort()
        for position, (_, k) in enumerate(keys):
            if k is None:
                continue
            point = points[position]
            before, after = (frames[k] - frames[k - 1]) if k else 1, (frames[k + 1] - frames[k]) if k + 1 < len(frames) else 1
            point.interpolation = 'BEZIER'
            point.handle_left_type = point.handle_right_type = 'ALIGNED'
            point.handle_left = frames[k] - before / 3, values[k, i] - slopes[k, i] * before / 3
            point.handle_right = frames[k] + after / 3, values[k, i] + slopes[k, i] * after / 3
        curve.update()


def show(context, path: Path) -> bpy.types.Object:
    """A curve along the path, in place of an earlier preview."""
    hide(context)
    data = bpy.data.curves.new(PREVIEW, 'CURVE')
    data.dimensions = '3D'
    spline = data.splines.new('POLY')
    spline.points.add(len(path.position) - 1)
    spline.points.foreach_set("co", np.concatenate([path.position, np.ones((len(path.position), 1))], 1).astype(np.float32).ravel())
    obj = bpy.data.objects.new(PREVIEW, data)
    obj.hide_render = True
    obj.show_in_front = True
    context.scene.collection.objects.link(obj)
    return obj


def hide(context) -> None:
    """Remove the preview."""
    for obj in [o for o in context.scene.objects if o.name.startswith(PREVIEW)]:
        data = obj.data
        bpy.data.objects.remove(obj)
        bpy.data.curves.remove(data)


def rotation_path(obj) -> str:
    """The property that holds an object's rotation, by its mode."""
    return {'QUATERNION': "rotation_quaternion", 'AXIS_ANGLE': "rotation_axis_angle"}.get(obj.rotation_mode, "rotation_euler")


def _local(camera, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Locations and rotations in the camera's own channels."""
    base = Matrix.Identity(4)
    if camera.parent:
        base = (camera.parent.matrix_world @ camera.matrix_parent_inverse).inverted()
    turn = base.to_quaternion()
    location = path.position @ np.array(base.to_3x3()).T + np.array(base.translation)
    quaternions = [turn @ Quaternion(q) for q in path.rotation]
    if camera.rotation_mode == 'QUATERNION':
        return location, np.array(quaternions)
    if camera.rotation_mode == 'AXIS_ANGLE':
        return location, np.array([(angle, *axis) for axis, angle in (q.to_axis_angle() for q in quaternions)])
    eulers = []
    for q in quaternions:
        eulers.append(q.to_euler(camera.rotation_mode, eulers[-1]) if eulers else q.to_euler(camera.rotation_mode))
    return location, np.array(eulers)
