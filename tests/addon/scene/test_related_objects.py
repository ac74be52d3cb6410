# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's operators on splats together with other objects, and those that add modifiers or keys.  docs/operators.md has the table."""
import bpy
import numpy as np
import pytest
from ordinary import POSE, as_a_mesh, in_view, select, twin_of, with_other

ops = bpy.ops


def parent(kind, type_, **options):
    return with_other(kind, lambda: ops.object.parent_set(type=type_, **options))


def link(type_):
    return with_other("cube", lambda: ops.object.make_links_data(type=type_))


def constrained():
    ops.object.constraint_add_with_targets(type='COPY_LOCATION')


def targeted(operator):
    """An operator on the object as the active one, with an empty selected as well."""
    def run():
        chosen = bpy.context.object
        empty = bpy.data.objects.new("Target", None)
        bpy.context.scene.collection.objects.link(empty)
        empty.location = (4, 5, 6)
        bpy.context.view_layer.update()
        select(chosen, empty)
        operator()

    return run


def constraints_copied():
    other = bpy.context.object
    limit = other.constraints.new('LIMIT_LOCATION')
    limit.use_max_x, limit.max_x = True, -5
    ops.object.constraints_copy()


MOVED = {
    "Parent > Path Constraint": parent("curve", 'PATH_CONST'),
    "Parent > Make Parent without Inverse": with_other("empty", ops.object.parent_no_inverse_set),
    "Constraints > Add Constraint (with Targets)": targeted(constrained),
    "Track > Damped Track Constraint": with_other("empty", lambda: ops.object.track_set(type='DAMPTRACK')),
    "Track > Track to Constraint": with_other("empty", lambda: ops.object.track_set(type='TRACKTO')),
    "Track > Lock Track Constraint": with_other("empty", lambda: ops.object.track_set(type='LOCKTRACK')),
    "Snap > Selection to Active": with_other("empty", in_view(ops.view3d.snap_selected_to_active)),
}
KEPT = {
    "Parent > Object": parent("empty", 'OBJECT'),
    "Parent > Object (Keep Transform)": parent("empty", 'OBJECT', keep_transform=True),
    "Parent > Bone": parent("armature", 'BONE'),
    "Parent > Bone Relative": parent("armature", 'BONE_RELATIVE'),
    "Parent > Follow Path": parent("curve", 'FOLLOW'),
    "Parent > Vertex": parent("cube", 'VERTEX'),
    "Parent > Vertex (Triangle)": parent("cube", 'VERTEX_TRI'),
    "Parent > Make Parent without Inverse (Keep Transform)":
        with_other("empty", lambda: ops.object.parent_no_inverse_set(keep_transform=True)),
    "Parent > Clear Parent Inverse": with_other("empty", lambda: ops.object.parent_clear(type='CLEAR_INVERSE')),
    "Collection > Add Selected to Active Object's Collection":
        with_other("empty", lambda: (in_own(), ops.collection.objects_add_active(collection=own()))),
    "Collection > Remove Selected from Active Collection":
        with_other("empty", lambda: (in_own(), ops.collection.objects_remove_active(collection=own()))),
    "Link/Transfer Data > Link Materials": link('MATERIAL'),
    "Link/Transfer Data > Link Animation Data": link('ANIMATION'),
    "Link/Transfer Data > Link Collections": link('GROUPS'),
    "Link/Transfer Data > Link Instance Collection": link('DUPLICOLLECTION'),
    "Link/Transfer Data > Link Fonts to Text": link('FONTS'),
    "Link/Transfer Data > Copy Grease Pencil Effects": link('EFFECTS'),
    "Link/Transfer Data > Copy UV Maps": with_other("cube", ops.object.join_uvs),
    "Link/Transfer Data > Transfer Mesh Data":
        with_other("cube", lambda: ops.object.data_transfer(data_type='VGROUP_WEIGHTS', layers_select_src='ALL')),
    "Link/Transfer Data > Transfer Mesh Data Layout":
        with_other("cube", lambda: ops.object.datalayout_transfer(data_type='VGROUP_WEIGHTS')),
    **{f"Link/Transfer Data > {what} to Emitter > {state.title()}": with_other("cube", lambda name=name, state=state: getattr(
        ops.object, name)(link_state=state)) for state in ('INCLUDE', 'EXCLUDE') for what, name in (
        ("Link Receivers", "light_linking_receivers_link"), ("Link Receiver Objects", "light_linking_receivers_link"),
        ("Link Blockers", "light_linking_blockers_link"))},
}
MOVED["Constraints > Copy Constraints to Selected Objects"] = with_other("cube", constraints_copied)
TOLD = {
    "Parent > Armature Deform": (parent("armature", 'ARMATURE'), "Armature"),
    "Parent > With Empty Groups": (parent("armature", 'ARMATURE_NAME'), "Armature"),
    "Parent > With Automatic Weights": (parent("armature", 'ARMATURE_AUTO'), "Armature"),
    "Parent > With Envelope Weights": (parent("armature", 'ARMATURE_ENVELOPE'), "Armature"),
    "Parent > Curve Deform": (parent("curve", 'CURVE'), "Curve"),
    "Parent > Lattice Deform": (parent("lattice", 'LATTICE'), "Lattice"),
    "Shade Auto Smooth": (ops.object.shade_auto_smooth, "Smooth by Angle"),
    "Quick Effects > Quick Explode": (in_view(ops.object.quick_explode), "Explode"),
    "Quick Effects > Quick Smoke": (in_view(ops.object.quick_smoke), "Fluid"),
    "Quick Effects > Quick Liquid": (in_view(ops.object.quick_liquid), "Fluid"),
    "Modifiers > Add Modifier": (lambda: ops.object.modifier_add(type='MIRROR'), "Mirror"),
    "Modifiers > Copy Modifiers to Selected Objects":
        (with_other("cube", lambda: (ops.object.modifier_add(type='BEVEL'), ops.object.modifiers_copy_to_selected())), "Bevel"),
}
"""What adds a modifier, and its name."""
NEWER = {"Link/Transfer Data > Copy Constraints": 'CONSTRAINTS', "Link/Transfer Data > Copy Light Linking": 'LIGHT_LINKING',
         "Link/Transfer Data > Copy Shadow Linking": 'SHADOW_LINKING'}
"""Entries of Blender 5.1 and newer."""


def in_own():
    """The active object alone in a collection."""
    chosen, active = list(bpy.context.selected_objects), bpy.context.object
    select(active)
    ops.collection.create(name="Own")
    select(active, *chosen)


def own():
    """The name of the collection that was made last for the active object."""
    return next(each.name for each in bpy.context.object.users_collection if each.name.startswith("Own"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*MOVED, *KEPT])
def test_what_operators_do_to_a_mesh_they_do_to_splats(splats, where, told, name):
    before, after = as_a_mesh(splats, where, (MOVED | KEPT)[name])
    moved = np.abs(after - before).max()
    assert moved > 1e-3 if name in MOVED else moved < 2e-5
    assert not told and len(splats.data.vertices) == 204


@pytest.mark.parametrize("name", NEWER)
def test_what_newer_blenders_copy(splats, where, told, name):
    if NEWER[name] not in ops.object.make_links_data.get_rna_type().properties["type"].enum_items:
        pytest.skip("this Blender has no such entry")
    before, after = as_a_mesh(splats, where, link(NEWER[name]))
    np.testing.assert_allclose(after, before, atol=2e-5)
    assert not told


@pytest.mark.slow
@pytest.mark.parametrize("name", TOLD)
def test_modifiers_that_operators_add_are_told(splats, where, told, name):
    """The object goes where a mesh goes, and its splats keep their shape."""
    operator, modifier = TOLD[name]
    if modifier == "Fluid" and bpy.app.version < (5, 1, 0):
        pytest.skip("this Blender's operator takes the last modifier for its own, which it is not, and stops")
    if modifier == "Smooth by Angle" and bpy.app.version < (5, 0, 0):
        pytest.skip("this Blender loads the operator's asset only where it has windows")
    as_a_mesh(splats, where, operator)
    assert any(f'"{modifier}"' in text and "Modifiers Change" in text for text in told)
    assert {modifier, "FAST-GS Proxy"} <= set(splats.modifiers.keys()) and len(splats.data.vertices) == 204


def test_a_child_follows_its_parent(splats, where, scene):
    """Bones, vertices, paths and objects that move take splats along as they take a mesh."""
    for name in ("Parent > Object", "Parent > Bone", "Parent > Vertex (Triangle)", "Parent > Follow Path"):
        before, after = as_a_mesh(splats, where, KEPT[name])
        np.testing.assert_allclose(after, before, atol=2e-5)
        splats.parent.location.x += 2
        bpy.context.view_layer.update()
        assert np.abs(where()["model"] - after).max() > 0.5
        splats.parent = None
        splats.matrix_world = POSE
        bpy.context.view_layer.update()


def placements(where, scene, *frames):
    found = []
    for frame in frames:
        scene.frame_set(frame)
        found.append(where()["model"])
    return found


def test_keys_are_set_baked_and_deleted(splats, where, scene):
    """Insert Keyframe and the rest of the menu Animation."""
    in_view(lambda: ops.anim.keying_set_active_set(type='Location'))()
    in_view(lambda: ops.anim.keyframe_insert_menu(type='Location'))()
    scene.frame_set(11)
    splats.location.x += 4
    in_view(lambda: ops.anim.keyframe_insert(type='Location'))()
    moved = placements(where, scene, 1, 6, 11)
    assert moved[2][0, 3] - moved[0][0, 3] == pytest.approx(4, abs=1e-5) and 1 < moved[1][0, 3] - moved[0][0, 3] < 3
    ops.nla.bake(frame_start=1, frame_end=11, step=1, only_selected=True, bake_types={'OBJECT'})
    np.testing.assert_allclose(placements(where, scene, 1, 6, 11), moved, atol=1e-5)
    in_view(ops.anim.keyframe_delete_v3d)()  # those of frame 11
    assert np.abs(placements(where, scene, 11)[0] - moved[2]).max() > 0.01
    in_view(ops.anim.keyframe_clear_v3d)()
    still = placements(where, scene, 1, 11)
    np.testing.assert_array_equal(*still)


def test_actions_are_replaced(splats, where, scene):
    """Blender 5.2: another action, or a new one, takes an action's place wherever that is used."""
    if "replace_action" not in dir(ops.anim):
        pytest.skip("this Blender has no such operators")
    splats.keyframe_insert("location", frame=1)
    used, other = splats.animation_data.action, bpy.data.actions.new("Other")
    in_view(lambda: ops.anim.replace_action(old_session_uid=used.session_uid, new_session_uid=other.session_uid))()
    assert splats.animation_data.action == other
    in_view(lambda: ops.anim.replace_action_new(old_session_uid=other.session_uid))()
    assert splats.animation_data.action not in (used, other)
    if "replace_action_duplicate" in dir(ops.anim):  # Blender 5.3
        now = splats.animation_data.action
        in_view(lambda: ops.anim.replace_action_duplicate(old_session_uid=now.session_uid))()
        assert splats.animation_data.action not in (None, now)
    bpy.context.view_layer.update()
    assert len(where()) == 1 and len(splats.data.vertices) == 204


def test_turning_otherwise_turns_no_splats(splats, where):
    """Blender 5.3: rotations are kept in other numbers."""
    if "rotation_mode_convert" not in dir(ops.anim):
        pytest.skip("this Blender has no such operator")
    splats.rotation_euler = 0.3, -0.4, 0.5
    bpy.context.view_layer.update()
    before = where()["model"]
    select(splats)
    in_view(lambda: ops.anim.rotation_mode_convert(mode='QUATERNION'))()
    bpy.context.view_layer.update()
    assert splats.rotation_mode == 'QUATERNION' and len(splats.data.vertices) == 204
    np.testing.assert_allclose(where()["model"], before, atol=2e-5)


def test_a_rigid_body_falls_and_is_baked(splats, where, scene):
    """And the rest of the menu Rigid Body, but for Connect."""
    scene.frame_start, scene.frame_end = 1, 12
    select(splats)
    ops.rigidbody.objects_add(type='ACTIVE')
    for operator in (lambda: ops.rigidbody.shape_change(type='BOX'), lambda: ops.rigidbody.mass_calculate(material='Air')):
        in_view(operator)()
    assert splats.rigid_body.collision_shape == 'BOX'
    select(splats)
    before = where()["model"]
    in_view(lambda: ops.rigidbody.bake_to_keyframes(frame_start=1, frame_end=12))()
    assert splats.rigid_body is None
    first, last = placements(where, scene, 1, 12)
    np.testing.assert_allclose(first, before, atol=1e-4)
    assert last[2, 3] < first[2, 3] - 0.3
    select(splats)
    ops.rigidbody.objects_add(type='ACTIVE')
    ops.object.visual_transform_apply()
    ops.rigidbody.objects_remove()
    assert splats.rigid_body is None
    np.testing.assert_allclose(where()["model"], last, atol=1e-4)


@pytest.mark.parametrize("points", ['SOME', 'ALL'])
def test_meshes_of_rigid_bodies_rest_while_simulations_measure_them(splats, scene, points):
    """Blender 5.0 crashed in simulations that measured a mesh which was evaluated anew for the same frame: those of all proxies were."""
    if points == 'ALL':
        splats.fastgs.points = 'ALL'
    scene.frame_set(1)
    evaluated = []

    def note(_, depsgraph):
        evaluated.append(any(update.id.original == splats and update.is_updated_geometry for update in depsgraph.updates))

    def played():
        evaluated.clear()
        for frame in (1, 2, 3):
            scene.frame_set(frame)
        return evaluated

    bpy.app.handlers.frame_change_post.append(note)
    try:
        assert all(played())
        ops.rigidbody.objects_add(type='ACTIVE')
        assert not any(played())
        ops.rigidbody.objects_remove()
        assert all(played())
    finally:
        bpy.app.handlers.frame_change_post.remove(note)


def test_rigid_bodies_are_connected(splats, where, told):
    """Nothing is simulated after it: Blender 5.0 can crash in a simulation from which a constraint was taken."""
    other = twin_of(splats)
    for obj in (splats, other):
        select(obj)
        ops.rigidbody.objects_add(type='ACTIVE')
    select(splats, other)
    in_view(ops.rigidbody.connect)()
    (joint,) = [obj for obj in bpy.data.objects if obj.rigid_body_constraint]
    assert {joint.rigid_body_constraint.object1, joint.rigid_body_constraint.object2} == {splats, other}
    bpy.context.view_layer.update()
    assert set(where()) == {"model"} and not told


def test_settings_of_a_rigid_body_are_copied(splats, where):
    before, after = as_a_mesh(splats, where, with_other("cube", body_copied))
    np.testing.assert_allclose(after, before, atol=2e-5)
    assert splats.rigid_body.mass == 7


def body_copied():
    for obj in [*bpy.context.selected_objects]:
        with bpy.context.temp_override(object=obj, active_object=obj, selected_objects=[obj]):
            ops.rigidbody.object_add(type='ACTIVE')
    bpy.context.object.rigid_body.mass = 7
    in_view(ops.rigidbody.object_settings_copy)()


def test_removed_from_all_collections_it_is_not_shown(splats, where, told):
    ops.collection.objects_remove_all()
    bpy.context.view_layer.update()
    assert not where() and not told


def test_copied_and_pasted_splats_are_shown(splats, where, told):
    before = where()["model"]
    in_view(ops.view3d.copybuffer)()
    in_view(ops.view3d.pastebuffer)()
    bpy.context.view_layer.update()
    found = where()
    assert len(found) == 2 and not told
    np.testing.assert_allclose(next(found[name] for name in found if name != "model"), before, atol=1e-5)


def test_an_instance_on_a_face_shows_the_splats(splats, where, told, module):
    """Blender makes a new object with the same points and takes the old one out of the scene."""
    path = splats.fastgs.filepath
    select(splats)
    ops.object.make_dupli_face()
    bpy.context.view_layer.update()
    bpy.context.view_layer.update()
    maker, child = bpy.data.objects["model_dupli"], bpy.data.objects["model.001"]
    assert child.fastgs.filepath == path and child.modifiers[-1].name == "FAST-GS Proxy"
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shown = [item.placement for item in module("scene.snapshot").take(depsgraph).instances]
    real = [np.array(item.matrix_world) for item in depsgraph.object_instances if item.is_instance]
    assert len(real) == 1 and maker.instance_type == 'FACES' and not told
    assert any(np.allclose(each[:3, 3], real[0][:3, 3], atol=1e-5) for each in shown)
    np.testing.assert_allclose(real[0][:3, 3], POSE.translation, atol=1e-4)


def test_a_mesh_that_is_linked_to_splats_shows_them(splats, where, told):
    """Until its file is cleared: then it has the points as a mesh."""
    ops.mesh.primitive_cube_add(location=(3, 0, 0))
    cube = bpy.context.object
    select(splats, cube)
    ops.object.make_links_data(type='OBDATA')
    bpy.context.view_layer.update()
    assert set(where()) == {"model", "Cube"} and cube.data == splats.data and not told
    cube.fastgs.filepath, cube.fastgs.file_hash = "", ""
    cube.update_tag(refresh={'DATA'})
    bpy.context.view_layer.update()
    bpy.context.view_layer.update()
    assert set(where()) == {"model"}


def test_fur_grows_on_faces_alone(splats, where, told):
    before, names = where()["model"], set(bpy.data.objects.keys())
    in_view(ops.object.quick_fur)()
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(where()["model"], before)
    assert set(bpy.data.objects.keys()) == names and not told


def test_splats_of_another_file_are_linked_and_overridden(splats, where, told, tmp_path):
    before, path = where()["model"], str(tmp_path / "library.blend")
    ops.wm.save_as_mainfile(filepath=path)
    ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, here):
        here.objects = ["model"]
    (linked,) = here.objects
    bpy.context.scene.collection.objects.link(linked)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(where()["model"], before, atol=1e-6)
    select(linked)
    in_view(ops.object.make_override_library)()
    own = next(obj for obj in bpy.data.objects if obj.override_library)
    own.location.x += 3
    bpy.context.view_layer.update()
    assert where()[own.name][0, 3] == pytest.approx(before[0, 3] + 3, abs=1e-5)
    own.override_library.operations_update()
    select(own)
    in_view(ops.object.reset_override_library)()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(where()[own.name], before, atol=1e-5)
    in_view(ops.object.clear_override_library)()
    bpy.context.view_layer.update()
    assert "model" in where() and not told


def test_objects_are_linked_to_another_scene(splats, where, module):
    before, scene = where()["model"], bpy.data.scenes.new("Another")
    ops.object.make_links_scene(scene=scene.name)
    layer = scene.view_layers[0]
    layer.update()
    (item,) = module("scene.snapshot").take(layer.depsgraph).instances
    np.testing.assert_allclose(item.placement, before, atol=1e-6)
