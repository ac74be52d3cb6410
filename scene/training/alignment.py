# SPDX-License-Identifier: GPL-3.0-or-later
"""Aligns a trained model with the scene from which its capture came."""
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .. import model_space


def world_of(scene: bpy.types.Scene, capture: str) -> str:
    """Name of the object under which the capture's cameras were imported into the scene; "" where they were not."""
    stem = Path(capture).stem
    worlds = {obj.parent for obj in scene.objects if obj.type == 'CAMERA' and obj.data.fastgs.view and obj.parent is not None}
    return next((world.name for world in worlds if world.name.partition(".")[0] == stem.partition(".")[0]), "")


def align(scene: bpy.types.Scene, obj: bpy.types.Object, world: str) -> None:
    """Give a model's object the transform of its cameras' world; without one, the file's axes are turned upright."""
    found = scene.objects.get(world) if world else None
    if found is not None:
        obj.matrix_world = found.matrix_world @ Matrix(np.linalg.inv(model_space.model_matrix(obj)).tolist())
