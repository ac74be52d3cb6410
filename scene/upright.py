# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns the model of a splat object within the object, so that another of the file's axes points up; the object itself stays."""
import bpy
import numpy as np
from mathutils import Matrix

from ..fastgs_blender.util import rotations
from . import model_space, objects

TURNS = {
    'POS_X': ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    'NEG_X': ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    'POS_Y': ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    'NEG_Y': ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    'POS_Z': ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    'NEG_Z': ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
"""By the axis of the file that points up: the rotation from the file's axes to Blender's."""


def axis_of(obj: bpy.types.Object) -> str:
    """Which axis of the file points most nearly up in the object's own space."""
    up = _rotation(model_space.model_matrix(obj))[2]
    return max(TURNS, key=lambda axis: float(np.dot(up, TURNS[axis][2])))


def recorded_axis(obj: bpy.types.Object) -> str:
    """The axis that points up as the file says, or as its format has it.  Raises FastGSError where it cannot be read."""
    up = np.array(objects.axes_matrix(objects.load_model(objects.abspath(obj)).axes))[2, :3]
    return next(axis for axis, turn in TURNS.items() if np.allclose(turn[2], up))


def set_upright(obj: bpy.types.Object, axis: str) -> None:
    """Let an axis of the file point up.  Size and place within the object stay; crop boxes that belong to the object come along."""
    before = model_space.model_matrix(obj)
    turn = rotations.transform(np.array(TURNS[axis], np.float64) @ _rotation(before).T)
    if obj.data.users > 1:  # another object may want another axis
        obj.data = obj.data.copy()
    model_space.set_model_matrix(obj, turn @ before)
    for box in {item.object for item in obj.fastgs.crops if item.object is not None and item.object.parent == obj}:
        box.matrix_local = Matrix(turn.tolist()) @ box.matrix_local
    obj.update_tag()


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation [3, 3] in a matrix, without its stretch and mirroring (polar decomposition)."""
    u, _, v = np.linalg.svd(matrix[:3, :3])
    return u @ v * np.sign(np.linalg.det(u @ v))
