# SPDX-License-Identifier: GPL-3.0-or-later
"""The worlds of captures in the scene, as objects to move: splats, and the empties that carry a capture's cameras."""
import bpy
import numpy as np
from mathutils import Matrix

from ...fastgs_blender.util.errors import FastGSError
from .. import model_space, objects
from .subjects import capture_cameras


def is_world(obj) -> bool:
    """Whether an object is a splat, or the empty that carries a capture's cameras."""
    return objects.is_splat(obj) or (obj.type == 'EMPTY' and any(c.type == 'CAMERA' and c.data.fastgs.view for c in obj.children))


def targets(context) -> list[bpy.types.Object]:
    """What to move: the active and the selected worlds and those that lie as they do; where there are none, all of the scene.

    Children go with their parents.
    """
    every = [obj for obj in context.scene.objects if is_world(obj)]
    chosen = dict.fromkeys(obj for obj in (context.object, *context.selected_objects) if obj is not None and is_world(obj))
    found = [obj for obj in every if any(lie_alike(obj, other) for other in chosen)] if chosen else every
    return [obj for obj in found if not any(parent in found for parent in _parents(obj))]


def lie_alike(a, b) -> bool:
    """Whether two worlds have the same place, turn and size."""
    return a == b or np.allclose(model_space.placement(a), model_space.placement(b), rtol=1e-5, atol=1e-5)


def _parents(obj):
    while obj.parent:
        obj = obj.parent
        yield obj


def points(context, count: int, of_cameras: bool = False) -> tuple[np.ndarray, list]:
    """That many points [count, 3] of the world that the user marked, and the objects that mark them.

    In Edit Mode they are the selected vertices of a splat's proxy, else the selected objects that are neither splats nor cameras of a
    capture, which an import leaves selected.  of_cameras: where nothing else is selected, these cameras are the points.
    Raises FastGSError where there are more or fewer.
    """
    if context.mode == 'EDIT_MESH':
        import bmesh

        obj = context.object
        chosen = [obj.matrix_world @ v.co for v in bmesh.from_edit_mesh(obj.data).verts if v.select]
        return _exactly(count, chosen, "vertices"), []
    cameras = capture_cameras(context.scene)
    selected = [obj for obj in context.selected_objects if not is_world(obj)]
    marks = [obj for obj in selected if obj not in cameras]
    if of_cameras:
        marks, what = marks or selected, "objects, such as empties or the capture's cameras"
    else:
        what = "objects, such as empties (the capture's cameras do not count)"
    found = _exactly(count, [obj.matrix_world.translation for obj in marks], what)
    return found, [obj for obj in marks if obj not in cameras]  # cameras go with their capture


def _exactly(count, chosen, what):
    if len(chosen) != count:
        raise FastGSError(f"mark {count} points: select {count} {what}; {len(chosen)} are selected now.")
    return np.array([list(p) for p in chosen], np.float64)


def move(context, worlds, marks, motion: np.ndarray) -> None:
    """Apply a motion of the world to objects, and to the marks on them."""
    matrix = Matrix(motion.tolist())
    for obj in [*worlds, *(m for m in marks if not any(p in worlds for p in _parents(m)))]:
        obj.matrix_world = matrix @ obj.matrix_world
    context.view_layer.update()
