# SPDX-License-Identifier: GPL-3.0-or-later
"""Crop boxes of splat objects: ordinary objects of the scene, whose extent cuts the model down."""
from __future__ import annotations

import numpy as np

from ..fastgs_blender.rendering.crops import Crop


def crops_of(obj, depsgraph) -> tuple[Crop, ...]:
    """The boxes of an evaluated splat object, where they are at the depsgraph's time.

    Instances of the object are cropped as it is itself, wherever they are.
    """
    used = [item for item in obj.fastgs.crops if item.use and item.object is not None]
    if not used:
        return ()
    world = np.array(_world(obj.original, depsgraph), np.float64)
    made = []
    for item in used:
        box = np.array(_world(item.object.original, depsgraph), np.float64) @ extent(item.object)
        flat = not (np.isfinite(box).all() and abs(np.linalg.det(box)) > 1e-30)
        made.append(Crop(np.full((4, 4), np.nan) if flat else np.linalg.inv(box) @ world, item.mode == 'REMOVE'))
    return tuple(made)


def _world(obj, depsgraph):
    """Where an original object is.  Blender does not evaluate what is disabled: that is where its own numbers put it."""
    flag = "hide_render" if depsgraph.mode == 'RENDER' else "hide_viewport"
    if not getattr(obj, flag) and not all(getattr(collection, flag) for collection in obj.users_collection):
        return obj.evaluated_get(depsgraph).matrix_world
    return obj.matrix_basis if obj.parent is None else _world(obj.parent, depsgraph) @ obj.matrix_parent_inverse @ obj.matrix_basis


def extent(obj) -> np.ndarray:
    """[4, 4] from -1 .. 1 along each axis to what an object reaches over in its own space: its bounds, or an empty's size."""
    corners = np.array(obj.bound_box) if obj.type != 'EMPTY' else np.array([[-1.0] * 3, [1.0] * 3]) * obj.empty_display_size
    low, high = corners.min(0), corners.max(0)
    out = np.diag([*(high - low) / 2, 1.0])
    out[:3, 3] = (low + high) / 2
    return out
