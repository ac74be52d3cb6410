# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's object operators on splats: they act as on a mesh, or refuse with a sentence.  docs/operators.md has the table.

test_related_objects.py has those that take a second object, test_kept_proxies.py those that are refused.
"""
import re
import sys
from pathlib import Path

import bpy
import numpy as np
import object_menus
import pytest
import test_kept_proxies
import test_related_objects
from mathutils import Matrix
from ordinary import POSE, as_a_mesh, edited, in_view, select

ops = bpy.ops


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


def around_cursor(operator):
    """An operator whose pivot is the 3D cursor: one object around itself would stay as it is."""
    def run():
        scene = bpy.context.scene
        scene.cursor.location, scene.tool_settings.transform_pivot_point = (-1, 3, 0.5), 'CURSOR'
        in_view(operator)()

    return run


def to_collection(name):
    def run():
        scene, operator = bpy.context.scene, getattr(ops.object, name)
        by_uid = "collection_uid" in operator.get_rna_type().properties
        operator(**({"collection_uid": scene.collection.session_uid} if by_uid else {"collection_index": 0}), is_new=True)

    return run


def in_collection(operator):
    """An operator on an object that lies in a collection of its own as well."""
    def run():
        ops.collection.create(name="Own")
        operator()

    return run


def mirrored(axis, space):
    return lambda: ops.transform.mirror(constraint_axis=[each == axis for each in "XYZ"], orient_type=space.upper())


def applied(*what):
    return lambda: ops.object.transform_apply(**{each: each in what for each in ("location", "rotation", "scale")})


def sheared(by):
    name = "angle" if "angle" in ops.transform.shear.get_rna_type().properties else "value"
    ops.transform.shear(**{name: by}, orient_axis='Z', orient_axis_ortho='X')


def single_user(*what):
    names = "object", "obdata", "material", "animation", "obdata_animation"
    return lambda: ops.object.make_single_user(**{each: each in what for each in names})


MOVED = {
    "Transform > Move": lambda: ops.transform.translate(value=(1, 2, 3)),
    "Transform > Rotate": lambda: ops.transform.rotate(value=0.5, orient_axis='X'),
    "Transform > Scale": lambda: ops.transform.resize(value=(2, -1, 1)),
    "Transform > Shear": around_cursor(lambda: sheared(0.4)),
    "Transform > Push/Pull": around_cursor(lambda: ops.transform.push_pull(value=0.5)),
    "Transform > Align to Transform Orientation": lambda: ops.transform.transform(mode='ALIGN'),
    "Transform > Randomize Transform": lambda: ops.object.randomize_transform(loc=(1, 1, 1), rot=(1, 1, 1), scale=(2, 2, 2)),
    "Set Origin > Geometry to Origin": lambda: ops.object.origin_set(type='GEOMETRY_ORIGIN'),
    "Mirror > Interactive Mirror": lambda: ops.transform.mirror(constraint_axis=(True, True, False), orient_type='GLOBAL'),
    **{f"Mirror > {axis} {space}": mirrored(axis, space) for space in ("Global", "Local") for axis in "XYZ"},
    "Clear > Location": ops.object.location_clear,
    "Clear > Rotation": ops.object.rotation_clear,
    "Clear > Scale": ops.object.scale_clear,
    "Clear > Origin": parented(ops.object.origin_clear),
    "Parent > Clear and Keep Transformation": parented(lambda: ops.object.parent_clear(type='CLEAR_KEEP_TRANSFORM')),
    "Apply > Visual Transform": parented(ops.object.visual_transform_apply),
    "Apply > Parent Inverse": parented(ops.object.parent_inverse_apply),
    "Snap > Selection to Grid": lambda: (ops.transform.translate(value=(0.7, 0.7, 0.7)), in_view(ops.view3d.snap_selected_to_grid)()),
    "Snap > Selection to Cursor": in_view(ops.view3d.snap_selected_to_cursor),
    "Snap > Selection to Cursor (Keep Offset)": in_view(lambda: ops.view3d.snap_selected_to_cursor(use_offset=True)),
    "Edit Mode > Move": edited(lambda: ops.transform.translate(value=(1, 2, 3))),
    "Edit Mode > Rotate": edited(lambda: ops.transform.rotate(value=0.5, orient_axis='Y')),
    "Edit Mode > Scale": edited(lambda: ops.transform.resize(value=(2, 1, 3))),
    "Edit Mode > Mirror": edited(lambda: ops.transform.mirror(constraint_axis=(True, False, False))),
}
"""What moves, turns or scales splats as it does a mesh."""
KEPT = {
    "Transform > To Sphere": around_cursor(lambda: ops.transform.tosphere(value=0.5)),
    "Transform > Bend": around_cursor(lambda: ops.transform.bend(value=(0.5,))),
    "Transform > Move Texture Space": lambda: ops.transform.translate(value=(1, 2, 3), texture_space=True),
    "Transform > Scale Texture Space": lambda: ops.transform.resize(value=(2, 1, 1), texture_space=True),
    "Set Origin > Origin to Geometry": lambda: ops.object.origin_set(type='ORIGIN_GEOMETRY'),
    "Set Origin > Origin to 3D Cursor": lambda: ops.object.origin_set(type='ORIGIN_CURSOR'),
    "Set Origin > Origin to Center of Mass (Surface)": lambda: ops.object.origin_set(type='ORIGIN_CENTER_OF_MASS'),
    "Set Origin > Origin to Center of Mass (Volume)": lambda: ops.object.origin_set(type='ORIGIN_CENTER_OF_VOLUME'),
    "Apply > Location": applied("location"),
    "Apply > Rotation": applied("rotation"),
    "Apply > Scale": applied("scale"),
    "Apply > All Transforms": applied("location", "rotation", "scale"),
    "Apply > Rotation & Scale": applied("rotation", "scale"),
    "Apply > Location to Deltas": lambda: ops.object.transforms_to_deltas(mode='LOC'),
    "Apply > Rotation to Deltas": lambda: ops.object.transforms_to_deltas(mode='ROT'),
    "Apply > Scale to Deltas": lambda: ops.object.transforms_to_deltas(mode='SCALE'),
    "Apply > All Transforms to Deltas": lambda: ops.object.transforms_to_deltas(mode='ALL'),
    "Snap > Cursor to Selected": in_view(ops.view3d.snap_cursor_to_selected),
    "Snap > Cursor to World Origin": in_view(ops.view3d.snap_cursor_to_center),
    "Snap > Cursor to Grid": in_view(ops.view3d.snap_cursor_to_grid),
    "Snap > Cursor to Active": in_view(ops.view3d.snap_cursor_to_active),
    "Parent > Clear Parent": parented(lambda: ops.object.parent_clear(type='CLEAR')),
    "Collection > Move to Collection": to_collection("move_to_collection"),
    "Collection > Link to Collection": to_collection("link_to_collection"),
    "Collection > Create New Collection": in_collection(lambda: None),
    "Collection > Remove from Collection": in_collection(lambda: ops.collection.objects_remove(collection=test_related_objects.own())),
    "Relations > Make Local > Selected Objects": lambda: ops.object.make_local(type='SELECT_OBJECT'),
    "Relations > Make Local > Selected Objects and Data": lambda: ops.object.make_local(type='SELECT_OBDATA'),
    "Relations > Make Local > Selected Objects, Data and Materials": lambda: ops.object.make_local(type='SELECT_OBDATA_MATERIAL'),
    "Relations > Make Local > All": lambda: ops.object.make_local(type='ALL'),
    "Relations > Make Single User > Object": single_user("object"),
    "Relations > Make Single User > Object & Data": single_user("object", "obdata"),
    "Relations > Make Single User > Object & Data & Materials": single_user("object", "obdata", "material"),
    "Relations > Make Single User > Materials": single_user("material"),
    "Relations > Make Single User > Object Animation": single_user("animation"),
    "Relations > Make Single User > Object Data Animation": single_user("obdata", "obdata_animation"),
    "Constraints > Clear Object Constraints": ops.object.constraints_clear,
    "Track > Clear Track": lambda: ops.object.track_clear(type='CLEAR'),
    "Track > Clear and Keep Transformation (Clear Track)": lambda: ops.object.track_clear(type='CLEAR_KEEP_TRANSFORM'),
    "Rigid Body > Add Active": lambda: ops.rigidbody.objects_add(type='ACTIVE'),
    "Rigid Body > Add Passive": lambda: ops.rigidbody.objects_add(type='PASSIVE'),
    "Shade Smooth": ops.object.shade_smooth,
    "Shade Flat": ops.object.shade_flat,
    "Clean Up > Clean Vertex Group Weights": lambda: (ops.object.vertex_group_add(), in_view(ops.object.vertex_group_clean)()),
    "Clean Up > Limit Total Vertex Groups": lambda: (ops.object.vertex_group_add(), in_view(ops.object.vertex_group_limit_total)()),
    "Clean Up > Remove Unused Material Slots": lambda: (ops.object.material_slot_add(), ops.object.material_slot_remove_unused()),
    "Clean Up > Remove All Materials": lambda: (ops.object.material_slot_add(), ops.object.material_slot_remove_all()),
    "Asset > Mark as Asset": lambda: asset("mark"),
    "Asset > Clear Asset": lambda: asset("clear"),
    "Asset > Clear Asset (Set Fake User)": lambda: asset("clear", set_fake_user=True),
}
"""What leaves splats, like a mesh, where they are."""


def asset(what, **options):
    obj = bpy.context.object
    if what == "clear":
        obj.asset_mark()
    with bpy.context.temp_override(id=obj, selected_ids=[obj]):
        getattr(ops.asset, what)(**options)
    assert (obj.asset_data is not None) == (what == "mark")


NOT_IN_4_2 = {"Transform > Shear", "Transform > Push/Pull", "Transform > To Sphere", "Transform > Bend", "Clean Up > Remove All Materials"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*MOVED, *KEPT])
def test_what_operators_do_to_a_mesh_they_do_to_splats(splats, where, told, name):
    if bpy.app.version < (4, 3, 0) and name in NOT_IN_4_2:
        pytest.skip("Blender 4.2 has no such operator, or it ends Blender as a module, with a plain mesh too")
    before, after = as_a_mesh(splats, where, (MOVED | KEPT)[name])
    moved = np.abs(after - before).max()
    assert moved > 1e-3 if name in MOVED else moved < 2e-5
    assert not told


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


def test_visual_geometry_to_objects_makes_nothing_else_of_splats(splats, where, told):
    if "visual_geometry_to_objects" not in dir(ops.object):
        pytest.skip("this Blender has no such operator")
    before, names = where()["model"], set(bpy.data.objects.keys())
    ops.object.visual_geometry_to_objects()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(where()["model"], before, atol=1e-6)
    made = set(bpy.data.objects.keys()) - names
    assert len(made) == 1 and not bpy.data.objects[made.pop()].fastgs.filepath and len(where()) == 1


def test_convert_to_curves_does_nothing(splats, where, told):
    before = where()["model"]
    ops.object.convert(target='CURVES')
    bpy.context.view_layer.update()
    assert splats.type == 'MESH' and not told
    np.testing.assert_array_equal(where()["model"], before)


def test_hidden_and_excluded_splats_are_not_shown(splats, where):
    collection = bpy.data.collections.new("Group")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(splats)
    bpy.context.scene.collection.objects.unlink(splats)
    layer = bpy.context.view_layer.layer_collection.children["Group"]
    for operator, shown in ((lambda: ops.object.hide_view_set(unselected=True), True), (ops.object.hide_view_set, False),
                            (ops.object.hide_view_clear, True)):
        in_view(operator)()
        bpy.context.view_layer.update()
        assert bool(where()) == shown
    for hide in (lambda on: setattr(splats, "hide_viewport", on), lambda on: setattr(layer, "exclude", on)):
        hide(True)
        bpy.context.view_layer.update()
        assert not where()
        hide(False)
        bpy.context.view_layer.update()
        assert where()


def rows() -> dict[str, str]:
    """The table in the docs: what an operator is called, what happens."""
    text = (Path(__file__).parents[3] / "docs" / "operators.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| (.+?) \| (.+) \|$", text, re.MULTILINE)
    return {name: what for name, what in found if name != "Operator"}


@pytest.mark.skipif(bpy.app.version < (4, 3, 0), reason="Blender 4.2 has other entries")
def test_each_entry_of_the_object_menu_has_a_row(splats):
    missing = {name: operator for name, operator in object_menus.entries().items() if name not in rows() and name not in FOR_OTHERS}
    assert not missing


FOR_OTHERS = {
    **{f"Animation > In-Betweens > {name}": "bones" for name in (
        "Blend Pose with Rest Pose", "Push Pose from Breakdown", "Relax Pose to Breakdown", "Pose Breakdowner", "Blend to Neighbor")},
    "Animation > Bake Object Transform to Grease Pencil": "strokes",
}
"""Entries that are greyed out where a mesh is selected, and what they are for."""


def test_the_table_in_the_docs_is_tested():
    """Each row of docs/operators.md names an operator of the tables here, or has a test of its own."""
    here, there = (set(module.MOVED) | set(module.KEPT) for module in (sys.modules[__name__], test_related_objects))
    tested = [here, there, {*test_related_objects.TOLD, *test_related_objects.NEWER}, set(test_kept_proxies.REFUSED), set(ELSEWHERE)]
    assert set(rows()) == set().union(*tested) and len(rows()) == sum(map(len, tested))
    modules = sys.modules[__name__], test_related_objects, test_kept_proxies
    assert all(any(hasattr(module, name) for module in modules) for name in ELSEWHERE.values())


ELSEWHERE = {
    "Transform > Align Objects": "test_align_objects_moves_splats_alone",
    "Apply > Animated Transforms to Deltas": "test_animation_can_be_moved_to_deltas",
    "Apply > Make Instances Real": "test_instances_and_copies",
    "Apply > Visual Geometry to Objects": "test_visual_geometry_to_objects_makes_nothing_else_of_splats",
    "Duplicate Objects": "test_instances_and_copies",
    "Duplicate Linked": "test_instances_and_copies",
    "Copy Objects": "test_copied_and_pasted_splats_are_shown",
    "Paste Objects": "test_copied_and_pasted_splats_are_shown",
    "Join": "test_splats_joined_with_splats_stay_apart",
    "Join, with a mesh": "test_splats_joined_with_a_mesh_stay_apart",
    "Collection > Remove from All Collections": "test_removed_from_all_collections_it_is_not_shown",
    **dict.fromkeys(("Library Override > Make", "Library Override > Reset", "Library Override > Clear"),
                    "test_splats_of_another_file_are_linked_and_overridden"),
    "Relations > Make Instance Face": "test_an_instance_on_a_face_shows_the_splats",
    "Convert > Mesh (Keep Original)": "test_converting_a_copy_leaves_both",
    "Convert > Curves": "test_convert_to_curves_does_nothing",
    "Link/Transfer Data > Link Objects to Scene": "test_objects_are_linked_to_another_scene",
    "Link/Transfer Data > Link Object Data": "test_data_of_splats_that_show_another_file_is_not_shared",
    "Link/Transfer Data > Link Object Data, of a mesh": "test_the_data_of_a_mesh_is_not_taken_over",
    "Link/Transfer Data > Link Object Data, to a mesh": "test_a_mesh_that_is_linked_to_splats_shows_them",
    "Link/Transfer Data > Copy Modifiers": "test_modifiers_that_are_copied_leave_ours_where_it_belongs",
    **dict.fromkeys(("Animation > Insert Keyframe", "Animation > Insert Keyframe with Keying Set", "Animation > Change Keying Set",
                     "Animation > Delete Keyframes", "Animation > Clear Keyframes", "Animation > Bake Action"),
                    "test_keys_are_set_baked_and_deleted"),
    **dict.fromkeys(("Animation > Replace Action", "Animation > Replace with New Action", "Animation > Replace with Duplicate Action"),
                    "test_actions_are_replaced"),
    "Animation > Convert Rotation Mode": "test_turning_otherwise_turns_no_splats",
    **dict.fromkeys(("Rigid Body > Remove", "Rigid Body > Change Shape", "Rigid Body > Calculate Mass", "Rigid Body > Apply Transformation",
                     "Rigid Body > Bake to Keyframes"), "test_a_rigid_body_falls_and_is_baked"),
    "Rigid Body > Connect": "test_rigid_bodies_are_connected",
    "Rigid Body > Copy from Active": "test_settings_of_a_rigid_body_are_copied",
    "Quick Effects > Quick Fur": "test_fur_grows_on_faces_alone",
    **dict.fromkeys(("Show/Hide > Hide Selected", "Show/Hide > Hide Unselected", "Show/Hide > Show Hidden Objects"),
                    "test_hidden_and_excluded_splats_are_not_shown"),
    "Delete": "test_deleting_an_object_brings_nothing_back",
    "Delete Global": "test_deleting_an_object_brings_nothing_back",
}
