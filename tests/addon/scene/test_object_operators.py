# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's object operators on splats: they do what they do to a mesh, or refuse with a sentence.  docs/operators.md has the table."""
import bpy
import numpy as np
import pytest
from mathutils import Matrix

POSE = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, (1, 2, 3)) @ Matrix.Diagonal((2, 1, 1.5, 1))


@pytest.fixture
def splats(make_model, model_file):
    """A splat object, turned, moved and stretched, alone selected."""
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(200, seed=2)))
    obj = bpy.context.object
    obj.matrix_world = POSE
    bpy.context.view_layer.update()
    return obj


@pytest.fixture
def where(module):
    """where(): the placement of each splat that is rendered, by name."""
    take = module("scene.snapshot").take

    def read():
        return {item.name: item.placement for item in take(bpy.context.evaluated_depsgraph_get()).instances}

    return read


@pytest.fixture
def twin():
    """twin(object): a mesh of the same points at the same place, which knows nothing of splats."""
    def make(obj):
        mesh = bpy.data.meshes.new("Twin")
        mesh.from_pydata([v.co for v in obj.data.vertices], [], [])
        other = bpy.data.objects.new("Twin", mesh)
        bpy.context.scene.collection.objects.link(other)
        other.matrix_world = obj.matrix_world
        bpy.context.view_layer.update()
        return other

    return make


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


def parented(operator):
    """An operator on a child."""
    def run():
        obj = bpy.context.object
        parent = bpy.data.objects.new("Parent", None)
        bpy.context.scene.collection.objects.link(parent)
        parent.matrix_world = POSE
        bpy.context.view_layer.update()
        obj.parent = parent
        bpy.context.view_layer.update()
        operator()

    return run


ops = bpy.ops
LIKE_A_MESH = {
    "Transform > Move": lambda: ops.transform.translate(value=(1, 2, 3)),
    "Transform > Rotate": lambda: ops.transform.rotate(value=0.5, orient_axis='X'),
    "Transform > Scale": lambda: ops.transform.resize(value=(2, -1, 1)),
    "Transform > Randomize Transform": lambda: ops.object.randomize_transform(loc=(1, 1, 1), rot=(1, 1, 1), scale=(2, 2, 2)),
    "Set Origin > Geometry to Origin": lambda: ops.object.origin_set(type='GEOMETRY_ORIGIN'),
    "Set Origin > Origin to Geometry": lambda: ops.object.origin_set(type='ORIGIN_GEOMETRY'),
    "Set Origin > Origin to 3D Cursor": lambda: ops.object.origin_set(type='ORIGIN_CURSOR'),
    "Set Origin > Origin to Center of Mass": lambda: ops.object.origin_set(type='ORIGIN_CENTER_OF_MASS'),
    "Mirror > X Global": lambda: ops.transform.mirror(constraint_axis=(True, False, False), orient_type='GLOBAL'),
    "Mirror > Z Local": lambda: ops.transform.mirror(constraint_axis=(False, False, True), orient_type='LOCAL'),
    "Clear > Location": ops.object.location_clear,
    "Clear > Rotation": ops.object.rotation_clear,
    "Clear > Scale": ops.object.scale_clear,
    "Clear > Origin": parented(ops.object.origin_clear),
    "Apply > Location": lambda: ops.object.transform_apply(location=True, rotation=False, scale=False),
    "Apply > Rotation": lambda: ops.object.transform_apply(location=False, rotation=True, scale=False),
    "Apply > Scale": lambda: ops.object.transform_apply(location=False, rotation=False, scale=True),
    "Apply > All Transforms": ops.object.transform_apply,
    "Apply > Rotation & Scale": lambda: ops.object.transform_apply(location=False),
    "Apply > Location to Deltas": lambda: ops.object.transforms_to_deltas(mode='LOC'),
    "Apply > Rotation to Deltas": lambda: ops.object.transforms_to_deltas(mode='ROT'),
    "Apply > Scale to Deltas": lambda: ops.object.transforms_to_deltas(mode='SCALE'),
    "Apply > All Transforms to Deltas": lambda: ops.object.transforms_to_deltas(mode='ALL'),
    "Apply > Visual Transform": parented(ops.object.visual_transform_apply),
    "Apply > Parent Inverse": parented(ops.object.parent_inverse_apply),
    "Parent > Clear": parented(lambda: ops.object.parent_clear(type='CLEAR')),
    "Parent > Clear and Keep Transformation": parented(lambda: ops.object.parent_clear(type='CLEAR_KEEP_TRANSFORM')),
    "Snap > Selection to Cursor": ops.view3d.snap_selected_to_cursor,
    "Edit Mode > Move": edited(lambda: ops.transform.translate(value=(1, 2, 3))),
    "Edit Mode > Rotate": edited(lambda: ops.transform.rotate(value=0.5, orient_axis='Y')),
    "Edit Mode > Scale": edited(lambda: ops.transform.resize(value=(2, 1, 3))),
    "Edit Mode > Mirror": edited(lambda: ops.transform.mirror(constraint_axis=(True, False, False))),
}
NEEDS_WINDOW = {"Snap > Selection to Cursor"}


@pytest.mark.parametrize("name", sorted(LIKE_A_MESH))
def test_what_operators_do_to_a_mesh_they_do_to_splats(splats, where, twin, name):
    other, before = twin(splats), where()["model"]
    local = np.linalg.inv(before) @ np.c_[in_world(splats), np.ones(len(splats.data.vertices))].T
    for obj in (splats, other):
        select(obj)
        try:
            LIKE_A_MESH[name]()
        except RuntimeError as error:
            if name in NEEDS_WINDOW and "context is incorrect" in str(error):
                pytest.skip("the operator needs a window")
            raise
        bpy.context.view_layer.update()
    after = where()["model"]
    np.testing.assert_allclose((after @ local).T[:, :3], in_world(other), atol=2e-5)
    if not name.startswith(("Apply", "Parent > Clear", "Set Origin > Origin")):
        assert np.abs(after - before).max() > 1e-3, "the operator did nothing, so the test shows nothing"
