# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's object operators on splats: they do what they do to a mesh, or refuse with a sentence.  docs/operators.md has the table."""
from pathlib import Path

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
STILL = ("Transform > Move Texture", "Transform > To Sphere", "Transform > Push", "Parent > Object", "Rigid", "Shade",
         "Collection", "Relations")
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


@pytest.fixture
def told(module, monkeypatch):
    """The sentences that users are told."""
    found = []
    monkeypatch.setattr(module("scene.notices"), "tell", found.append)
    return found


def delete_some():
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.mesh.select_random(ratio=0.5)
    bpy.ops.mesh.delete(type='VERT')
    bpy.ops.object.mode_set(mode='OBJECT')


def delete_all():
    edited(lambda: ops.mesh.delete(type='VERT'))()


def move_some():
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.mesh.select_all(action='DESELECT')
    bpy.ops.mesh.select_random(ratio=0.3)
    bpy.ops.transform.translate(value=(1, 2, 3))
    bpy.ops.object.mode_set(mode='OBJECT')


def separate_some():
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.mesh.select_all(action='DESELECT')
    bpy.ops.mesh.select_random(ratio=0.5)
    bpy.ops.mesh.separate(type='SELECTED')
    bpy.ops.object.mode_set(mode='OBJECT')


REFUSED = {
    "Edit Mode > Delete Vertices": delete_some,
    "Edit Mode > Delete All": delete_all,
    "Edit Mode > Move Some": move_some,
    "Edit Mode > Separate": separate_some,
    "Convert > Mesh, Apply > Visual Geometry to Mesh": lambda: ops.object.convert(target='MESH'),
    "Convert > Curve": lambda: ops.object.convert(target='CURVE'),
    "Modifiers > Apply": lambda: ops.object.modifier_apply(modifier="FAST-GS Proxy"),
}


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_would_break_a_proxy_is_undone_and_told(splats, where, told, module, name, hidden):
    module("scene.proxies").hide(hidden)  # as viewports do that draw the splats themselves
    before, points, count = where(), in_world(splats), len(bpy.data.objects)
    select(splats)
    REFUSED[name]()
    bpy.context.view_layer.update()
    after = where()
    assert after.keys() == before.keys() and len(bpy.data.objects) == count
    np.testing.assert_allclose(after["model"], before["model"], atol=1e-5)
    again = bpy.data.objects["model"]  # converted into a curve, it is another one
    np.testing.assert_allclose(in_world(again), points, atol=1e-5)
    assert [m.name for m in again.modifiers] == ["FAST-GS Proxy"] and not len(again.data.polygons)
    if name == "Convert > Curve" and not hidden:  # without edges Blender converts nothing
        return
    assert told and all('"model"' in text and text.endswith(".") for text in told)


def test_converting_a_copy_leaves_both(splats, where, told):
    bpy.ops.object.convert(target='MESH', keep_original=True)
    bpy.context.view_layer.update()
    placements = list(where().values())
    assert len(placements) == 2
    np.testing.assert_allclose(placements[0], placements[1], atol=1e-5)
    assert told


@pytest.fixture
def second(make_model, model_file, splats):
    """Another splat object, elsewhere, with settings of its own and a crop box."""
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(150, seed=9), "other.safetensors"))
    obj = bpy.context.object
    obj.location = (-4, 0, 1)
    obj.fastgs.start_frame, obj.fastgs.before = 7, 'LOOP'
    box = bpy.data.objects.new("Box", None)
    bpy.context.scene.collection.objects.link(box)
    obj.fastgs.crops.add().object = box
    bpy.context.view_layer.update()
    return obj


@pytest.fixture
def cube(splats):
    bpy.ops.mesh.primitive_cube_add(location=(3, 0, 0))
    bpy.context.object.rotation_euler = (0.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    return bpy.context.object


def test_splats_joined_with_splats_stay_apart(splats, second, where, told):
    before = where()
    select(splats, second)
    bpy.ops.object.join()
    bpy.context.view_layer.update()
    after = where()
    assert after.keys() == before.keys() == {"model", "other"}
    for name in before:
        np.testing.assert_allclose(after[name], before[name], atol=1e-5)
    again = bpy.data.objects["other"].fastgs
    assert (again.start_frame, again.before, again.crops[0].object) == (7, 'LOOP', bpy.data.objects["Box"])
    assert len(splats.data.vertices) == 204 and len(bpy.data.objects["other"].data.vertices) == 154
    assert len(told) == 1 and "joined" in told[0]


@pytest.mark.parametrize("active", ["splats", "cube"])
def test_splats_joined_with_a_mesh_stay_apart(splats, cube, where, told, active):
    before, mesh = where(), np.sort(in_world(cube), axis=0)
    select(*((splats, cube) if active == "splats" else (cube, splats)))
    bpy.ops.object.join()
    bpy.context.view_layer.update()
    after = where()
    assert after.keys() == before.keys() == {"model"}
    np.testing.assert_allclose(after["model"], before["model"], atol=1e-5)
    again = bpy.data.objects["Cube"]
    assert len(again.data.polygons) == 6 and len(bpy.data.objects["model"].data.polygons) == 0
    np.testing.assert_allclose(np.sort(in_world(again), axis=0), mesh, atol=1e-5)
    assert len(told) == 1 and "joined" in told[0]


def test_deleting_an_object_brings_nothing_back(splats, second, where, told):
    bpy.data.objects.remove(second)
    bpy.context.view_layer.update()
    select(splats)
    bpy.ops.object.delete()
    bpy.context.view_layer.update()
    assert not where() and not told


def test_modifiers_that_do_not_act_on_splats_are_told(splats, where, told):
    before = where()["model"]
    splats.modifiers.new("Mirror", 'MIRROR')
    bpy.context.view_layer.update()
    assert len(told) == 1 and '"Mirror"' in told[0]
    splats.update_tag(refresh={'DATA'})
    bpy.context.view_layer.update()
    assert len(told) == 1
    np.testing.assert_array_equal(where()["model"], before)


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


def test_data_of_splats_that_show_another_file_is_not_shared(splats, second, where, told):
    before = where()
    select(splats, second)
    ops.object.make_links_data(type='OBDATA')
    bpy.context.view_layer.update()
    after = where()
    for name in before:
        np.testing.assert_allclose(after[name], before[name], atol=1e-5)
    assert splats.data != second.data and len(second.data.vertices) == 154 and len(told) == 1


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
    tested = {*LIKE_A_MESH, *REFUSED, *ELSEWHERE}
    assert len(rows) > 50 and set(rows) == tested
    assert all(name in globals() for name in ELSEWHERE.values())


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
    "Modifiers > Add": "test_modifiers_that_do_not_act_on_splats_are_told",
    "Show/Hide": "test_hidden_and_excluded_splats_are_not_shown",
    "Delete": "test_deleting_an_object_brings_nothing_back",
}
