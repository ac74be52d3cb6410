# SPDX-License-Identifier: GPL-3.0-or-later
"""Helpers of the tests of Blender's operators on objects."""
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


def twin_of(obj):
    """A mesh of the same points at the same place, which knows nothing of splats."""
    mesh = bpy.data.meshes.new("Twin")
    mesh.from_pydata([v.co for v in obj.data.vertices], [], [])
    other = bpy.data.objects.new("Twin", mesh)
    bpy.context.scene.collection.objects.link(other)
    other.matrix_world = obj.matrix_world
    bpy.context.view_layer.update()
    return other


def as_a_mesh(splats, where, operator):
    """Run an operator on splats and on a mesh like them: both lie alike after it.  Returns the splats' placement before and after it."""
    other, before = twin_of(splats), where()["model"]
    local = np.linalg.inv(before) @ np.c_[in_world(splats), np.ones(len(splats.data.vertices))].T
    for obj in (splats, other):
        select(obj)
        operator()
        bpy.context.view_layer.update()
    after = where()["model"]
    np.testing.assert_allclose((after @ local).T[:, :3], in_world(other), atol=2e-5)
    return before, after


def edited(*operators):
    """The same in Edit Mode, with all vertices selected."""
    def run():
        bpy.ops.object.mode_set(mode='EDIT')
        bpy.ops.mesh.select_all(action='SELECT')
        for operator in operators:
            operator()
        bpy.ops.object.mode_set(mode='OBJECT')

    return run


def in_view(operator):
    """The same with the mouse over the 3D view, which the first window has without a screen too."""
    def run():
        window = bpy.context.window_manager.windows[0]
        area = next(area for area in window.screen.areas if area.type == 'VIEW_3D')
        region = next(region for region in area.regions if region.type == 'WINDOW')
        with bpy.context.temp_override(window=window, area=area, region=region):
            operator()

    return run


def with_other(kind, operator):
    """An operator on the object, with another one as the active one: a kind of ADDED, or a function that makes it."""
    def run():
        chosen = bpy.context.object
        other = ADDED[kind]()
        other.matrix_world = POSE @ POSE
        bpy.context.view_layer.update()
        select(other, chosen)
        operator()

    return run


def _new(name, data=None):
    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _by(operator):
    def make():
        operator()
        return bpy.context.object

    return make


ADDED = {
    "empty": lambda: _new("Other"),
    "lattice": lambda: _new("Other", bpy.data.lattices.new("Other")),
    "cube": _by(bpy.ops.mesh.primitive_cube_add),
    "curve": _by(bpy.ops.curve.primitive_bezier_curve_add),
    "armature": _by(bpy.ops.object.armature_add),
}
