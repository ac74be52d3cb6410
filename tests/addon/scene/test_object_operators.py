# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's object operators on splats: they do what they do to a mesh, or refuse with a sentence.  docs/operators.md has the table."""
from pathlib import Path

import bpy
import numpy as np
import pytest
import test_kept_proxies
from mathutils import Matrix
from ordinary import POSE, edited, in_world, select


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


def with_empty(operator):
    """An operator on the object, with an empty as the active one."""
    def run():
        empty = bpy.data.objects.new("Empty", None)
        bpy.context.scene.collection.objects.link(empty)
        empty.matrix_world = POSE
        bpy.context.view_layer.update()
        empty.select_set(True)
        bpy.context.view_layer.objects.active = empty
        operator()

    return run


def constrained():
    obj, empty = bpy.context.object, bpy.data.objects.new("Target", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location = (4, 5, 6)
    bpy.context.view_layer.update()
    empty.select_set(True)
    bpy.context.view_layer.objects.active = obj
    ops.object.constraint_add_with_targets(type='COPY_LOCATION')


def moved_to_collection():
    scene = bpy.context.scene
    by_uid = "collection_uid" in ops.object.move_to_collection.get_rna_type().properties
    ops.object.move_to_collection(**({"collection_uid": scene.collection.session_uid} if by_uid else {"collection_index": 0}), is_new=True)


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
LIKE_A_MESH |= {
    "Transform > To Sphere": lambda: ops.transform.tosphere(value=0.5),
    "Transform > Push/Pull": lambda: ops.transform.push_pull(value=0.5),
    "Transform > Move Texture Space": lambda: ops.transform.translate(value=(1, 2, 3), texture_space=True),
    "Transform > Scale Texture Space": lambda: ops.transform.resize(value=(2, 1, 1), texture_space=True),
    "Transform > Align to Transform Orientation": lambda: ops.transform.transform(mode='ALIGN'),
    "Rigid Body > Add Passive": lambda: ops.rigidbody.object_add(type='PASSIVE'),
    "Parent > Object": with_empty(lambda: ops.object.parent_set(type='OBJECT')),
    "Parent > Object (Keep Transform)": with_empty(lambda: ops.object.parent_set(type='OBJECT', keep_transform=True)),
    "Constraints > Add Constraint (with Targets)": constrained,
    "Track > Track to Constraint": with_empty(lambda: ops.object.track_set(type='TRACKTO')),
    "Rigid Body > Add Active": lambda: ops.rigidbody.object_add(type='ACTIVE'),
    "Shade Smooth": ops.object.shade_smooth,
    "Shade Flat": ops.object.shade_flat,
    "Collection > Move to Collection": moved_to_collection,
    "Relations > Make Single User": lambda: ops.object.make_single_user(object=True, obdata=True),
    "Relations > Make Local": lambda: ops.object.make_local(type='SELECT_OBDATA'),
}
STILL = ("Transform > Move Texture", "Transform > Scale Texture", "Transform > To Sphere", "Transform > Push", "Parent > Object", "Rigid",
         "Shade", "Collection", "Relations")
"""These leave a single object where it is."""
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
    if not name.startswith(STILL + ("Apply", "Parent > Clear", "Set Origin > Origin")):
        assert np.abs(after - before).max() > 1e-3, "the operator did nothing, so the test shows nothing"


def test_instances_and_copies(splats, where):
    """Duplicate, Duplicate Linked and Make Instances Real."""
    before = where()["model"]
    for duplicate in (ops.object.duplicate, lambda: ops.object.duplicate(linked=True)):
        select(splats)
        duplicate()
        bpy.ops.transform.translate(value=(5, 0, 0))
        bpy.context.view_layer.update()
        copy = where()[bpy.context.object.name]
        np.testing.assert_allclose(copy, np.array(Matrix.Translation((5, 0, 0))) @ before, atol=1e-5)
        bpy.data.objects.remove(bpy.context.object)
    collection = bpy.data.collections.new("Group")
    collection.objects.link(splats)
    empty = bpy.data.objects.new("Instance", None)
    empty.instance_type, empty.instance_collection = 'COLLECTION', collection
    empty.location = (0, 0, 4)
    bpy.context.scene.collection.objects.link(empty)
    select(empty)
    bpy.ops.object.duplicates_make_real()
    bpy.context.view_layer.update()
    real = next(item for name, item in where().items() if name != "model")
    np.testing.assert_allclose(real, np.array(Matrix.Translation((0, 0, 4))) @ before, atol=1e-5)


def test_animation_can_be_moved_to_deltas(splats, where, scene):
    splats.keyframe_insert("location", frame=1)
    splats.location.x += 4
    splats.keyframe_insert("location", frame=11)
    seen = []
    for operator in (None, ops.object.anim_transforms_to_deltas):
        if operator:
            select(splats)
            operator()
        for frame in (1, 6, 11):
            scene.frame_set(frame)
            seen.append(where()["model"])
    np.testing.assert_allclose(seen[:3], seen[3:], atol=1e-6)
    assert seen[2][0, 3] - seen[0][0, 3] == pytest.approx(4, abs=1e-5)


def test_align_objects_moves_splats_alone(splats, where):
    before = where()["model"]
    ops.object.align(align_mode='OPT_2', relative_to='OPT_1', align_axis={'X', 'Z'})
    bpy.context.view_layer.update()
    after = where()["model"]
    np.testing.assert_allclose(after[:3, :3], before[:3, :3], atol=1e-6)
    assert abs(after[0, 3] - before[0, 3]) > 0.1 and after[1, 3] == pytest.approx(before[1, 3])


def test_hidden_and_excluded_splats_are_not_shown(splats, where):
    collection = bpy.data.collections.new("Group")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(splats)
    bpy.context.scene.collection.objects.unlink(splats)
    layer = bpy.context.view_layer.layer_collection.children["Group"]
    # the eye is each viewport's own affair, which ordinary.py looks at in a window
    for hide in (lambda on: setattr(splats, "hide_viewport", on), lambda on: setattr(layer, "exclude", on)):
        hide(True)
        bpy.context.view_layer.update()
        assert not where()
        hide(False)
        bpy.context.view_layer.update()
        assert where()


def test_the_table_in_the_docs_is_tested():
    """Each row of docs/operators.md names operators of the tables here, or a test of its own."""
    text = (Path(__file__).parents[3] / "docs" / "operators.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| ") and not line.startswith("| Operator")]
    tested = {*LIKE_A_MESH, *test_kept_proxies.REFUSED, *ELSEWHERE}
    assert len(rows) > 50 and set(rows) == tested
    assert all(name in globals() or hasattr(test_kept_proxies, name) for name in ELSEWHERE.values())


ELSEWHERE = {
    "Transform > Align Objects": "test_align_objects_moves_splats_alone",
    "Apply > Animated Transform to Deltas": "test_animation_can_be_moved_to_deltas",
    "Apply > Make Instances Real": "test_instances_and_copies",
    "Duplicate Objects": "test_instances_and_copies",
    "Duplicate Linked": "test_instances_and_copies",
    "Join, splats with splats": "test_splats_joined_with_splats_stay_apart",
    "Join, splats with a mesh": "test_splats_joined_with_a_mesh_stay_apart",
    "Convert > Mesh (Keep Original)": "test_converting_a_copy_leaves_both",
    "Link/Transfer Data > Link Object Data": "test_data_of_splats_that_show_another_file_is_not_shared",
    "Link/Transfer Data > Link Object Data, of a mesh": "test_the_data_of_a_mesh_is_not_taken_over",
    "Link/Transfer Data > Copy Modifiers": "test_modifiers_that_are_copied_leave_ours_where_it_belongs",
    "Modifiers > Add": "test_modifiers_that_do_not_act_on_splats_are_told",
    "Show/Hide": "test_hidden_and_excluded_splats_are_not_shown",
    "Delete": "test_deleting_an_object_brings_nothing_back",
}
