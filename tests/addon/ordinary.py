# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of Blender's operators on objects share."""
import bpy
import numpy as np
from mathutils import Matrix

POSE = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, (1, 2, 3)) @ Matrix.Diagonal((2, 1, 1.5, 1))


def select(*chosen):
    bpy.ops.object.select_all(action='DESELECT')
    for obj in chosen:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = chosen[0]


def in_world(obj):
    return np.array([obj.matrix_world @ v.co for v in obj.data.vertices])


def edited(*operators):
    """The same in Edit Mode, with all vertices selected."""
    def run():
        bpy.ops.object.mode_set(mode='EDIT')
        bpy.ops.mesh.select_all(action='SELECT')
        for operator in operators:
            operator()
        bpy.ops.object.mode_set(mode='OBJECT')

    return run
