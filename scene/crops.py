# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads and makes crop boxes of splat objects: ordinary objects of the scene whose extent says which Gaussians are shown."""
from functools import lru_cache

import bpy
import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.crops import Crop
from ..fastgs_blender.rendering.instances import LIMIT
from ..fastgs_blender.rendering.volumes import Volume, mesh_volume
from . import arrays, model_space

BROKEN = (f'its crop shape "{{}}" has a transform or a vertex beyond {LIMIT:g}, or one that is no number; clear its transform, or delete '
          "that vertex.")
WIDER = 1.001
"""By this factor a new box is larger than what it surrounds, so that what lies on its sides is inside."""


def crops_of(obj, depsgraph) -> tuple[Crop, ...]:
    """The boxes of an evaluated splat object, where they are at the depsgraph's time.

    Instances of the object are cropped as it is itself, wherever they are.  Raises FastGSError where numbers of a box are none.
    """
    used = [item for item in obj.fastgs.crops if item.use and item.object is not None]
    if not used:
        return ()
    world = model_space.placement(obj, _world(obj.original, depsgraph))
    made = []
    for item in used:
        box = np.array(_world(item.object.original, depsgraph), np.float64) @ extent(item.object)
        if not (np.abs(box) <= LIMIT).all():  # neither are NaN
            raise fg.FastGSError(BROKEN.format(item.object.name))
        flat = not abs(np.linalg.det(box)) > 1e-30
        shape = item.shape
        if shape == 'MESH':
            shape = "BOX" if flat or item.object.type != 'MESH' else _volume(item.object, depsgraph)
        made.append(Crop(np.full((4, 4), np.nan) if flat else np.linalg.inv(box) @ world, item.mode == 'REMOVE', shape, item.soft))
    return tuple(made)


@lru_cache(maxsize=16)
def _made(points: bytes, triangles: bytes, low: bytes, high: bytes) -> Volume:
    return mesh_volume(np.frombuffer(points, np.float32).reshape(-1, 3), np.frombuffer(triangles, np.int32).reshape(-1, 3),
                       np.frombuffer(low), np.frombuffer(high))


def _volume(obj, depsgraph) -> Volume:
    """The inside of a mesh object as it is evaluated; made anew when its shape changes."""
    mesh = (obj.original.evaluated_get(depsgraph) if _is_evaluated(obj.original, depsgraph) else obj.original).data
    points = arrays.points(mesh)
    if not (np.abs(points) <= LIMIT).all():
        raise fg.FastGSError(BROKEN.format(obj.name))
    around = extent(obj)
    low, high = around[:3, 3] - np.diag(around)[:3], around[:3, 3] + np.diag(around)[:3]
    return _made(points.tobytes(), arrays.triangles(mesh).tobytes(), low.tobytes(), high.tobytes())


def _world(obj, depsgraph):
    """Where an original object is.  Blender does not evaluate what is disabled: that is where its own numbers put it."""
    if _is_evaluated(obj, depsgraph):
        return obj.evaluated_get(depsgraph).matrix_world
    return obj.matrix_basis if obj.parent is None else _world(obj.parent, depsgraph) @ obj.matrix_parent_inverse @ obj.matrix_basis


def _is_evaluated(obj, depsgraph) -> bool:
    flag = "hide_render" if depsgraph.mode == 'RENDER' else "hide_viewport"
    return not getattr(obj, flag) and not all(getattr(collection, flag) for collection in obj.users_collection)


def extent(obj) -> np.ndarray:
    """[4, 4] from -1 .. 1 along each axis to what an object reaches over in its own space: its bounds, or an empty's size."""
    return _around(np.array(obj.bound_box) if obj.type != 'EMPTY' else np.array([[-1.0] * 3, [1.0] * 3]) * obj.empty_display_size)


def _around(corners: np.ndarray) -> np.ndarray:
    low, high = corners.min(0), corners.max(0)
    out = np.diag([*(high - low) / 2, 1.0])
    out[:3, 3] = (low + high) / 2
    return out


def add_shape(obj, shape: str) -> bpy.types.Object:
    """A new empty, 'BOX' or 'SPHERE', around an object's splats that crops them; it is the object's child and moves with it."""
    box = bpy.data.objects.new(f"{obj.name} Crop", None)
    box.empty_display_type = 'SPHERE' if shape == 'SPHERE' else 'CUBE'
    for collection in obj.users_collection:
        collection.objects.link(box)
    around = _around(arrays.points(obj.data).astype(np.float64))  # viewports draw, and bounds hold, the subject alone
    box.parent = obj
    box.location = around[:3, 3]
    box.scale = [max(WIDER * around[i, i], 1e-3) for i in range(3)]
    item = obj.fastgs.crops.add()
    item.object, item.shape = box, shape
    return box
