# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that would turn a proxy into something else: the extension restores it and reports a sentence.  docs/operators.md has the
table."""
import bpy
import numpy as np
import pytest
from ordinary import edited, in_world, select

ops = bpy.ops


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
    "Convert > Mesh": lambda: ops.object.convert(target='MESH'),
    "Apply > Visual Geometry to Mesh": lambda: ops.object.convert(target='MESH'),
    "Convert > Curve": lambda: ops.object.convert(target='CURVE'),
    "Convert > Point Cloud": lambda: ops.object.convert(target='POINTCLOUD'),
    "Convert > Grease Pencil": lambda: ops.object.convert(target='GREASEPENCIL'),
    "Modifiers > Clear Object Modifiers": ops.object.modifiers_clear,
    "Modifiers > Apply": lambda: ops.object.modifier_apply(modifier="FAST-GS Proxy"),
}


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_would_break_a_proxy_is_undone_and_told(splats, where, told, module, name, hidden):
    if bpy.app.version < (4, 3, 0) and name in ("Convert > Point Cloud", "Convert > Grease Pencil"):
        pytest.skip("Blender 4.2 has no such conversion")
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


@pytest.mark.parametrize("points", ['SOME', 'ALL'])
@pytest.mark.parametrize("name", sorted(name for name in REFUSED if name.startswith("Edit Mode")))
def test_linked_duplicates_are_kept_while_one_of_them_is_edited(splats, where, told, scene, capfd, name, points):
    """Alt D, Tab: the mesh of both has no vertices to read meanwhile.  Nothing raises, and nothing is left of Separate."""
    splats.fastgs.points = points
    select(splats)
    ops.object.duplicate(linked=True)
    twin = bpy.context.object
    twin.location.x += 5
    bpy.context.view_layer.update()
    before, count = where(), len(bpy.data.objects)
    ops.object.mode_set(mode='EDIT')
    for frame in (2, 3):
        scene.frame_set(frame)
        splats.update_tag(refresh={'DATA'})
        bpy.context.view_layer.update()
    ops.object.mode_set(mode='OBJECT')
    REFUSED[name]()
    bpy.context.view_layer.update()
    after = where()
    assert len(before) == 2 and after.keys() == before.keys() and len(bpy.data.objects) == count
    for each, placement in before.items():
        np.testing.assert_allclose(after[each], placement, atol=1e-5)
    assert splats.data == twin.data and told and "Traceback" not in capfd.readouterr().err


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


def test_data_of_splats_that_show_another_file_is_not_shared(splats, second, where, told):
    before = where()
    select(splats, second)
    ops.object.make_links_data(type='OBDATA')
    bpy.context.view_layer.update()
    after = where()
    for name in before:
        np.testing.assert_allclose(after[name], before[name], atol=1e-5)
    assert splats.data != second.data and len(second.data.vertices) == 154 and len(told) == 1


def test_the_data_of_a_mesh_is_not_taken_over(splats, cube, where, told):
    before, mesh = where(), cube.data
    select(cube, splats)
    ops.object.make_links_data(type='OBDATA')
    bpy.context.view_layer.update()
    np.testing.assert_allclose(where()["model"], before["model"], atol=1e-5)
    assert cube.data == mesh and len(mesh.vertices) == 8 and len(splats.data.vertices) == 204 and len(told) == 1


@pytest.mark.parametrize("active", ["splats", "cube"])
def test_modifiers_that_are_copied_leave_ours_where_it_belongs(splats, cube, where, told, active):
    cube.modifiers.new("Bevel", 'BEVEL')
    bpy.context.view_layer.update()
    select(*((splats, cube) if active == "splats" else (cube, splats)))
    ops.object.make_links_data(type='MODIFIERS')
    bpy.context.view_layer.update()
    bpy.context.view_layer.update()
    names = {obj.name: [modifier.name for modifier in obj.modifiers] for obj in (splats, cube)}
    assert names == ({"model": ["FAST-GS Proxy"], "Cube": []} if active == "splats" else
                     {"model": ["Bevel", "FAST-GS Proxy"], "Cube": ["Bevel"]})
    assert any("put back" in text for text in told) == (active == "cube")


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
