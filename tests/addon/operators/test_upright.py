# SPDX-License-Identifier: GPL-3.0-or-later
"""Which axis of a file points up can be chosen after the import, for each object, and the file's own axes come first."""
import bpy
import numpy as np
import pytest

UP = {"POS_X": (1, 0, 0), "NEG_X": (-1, 0, 0), "POS_Y": (0, 1, 0), "NEG_Y": (0, -1, 0), "POS_Z": (0, 0, 1), "NEG_Z": (0, 0, -1)}


@pytest.fixture
def placement(module):
    return module("scene.model_space").placement


@pytest.mark.parametrize("axis", UP)
def test_each_axis_can_point_up(make_model, model_file, module, placement, axis):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes="RUB")))
    obj = bpy.context.object
    before = obj.matrix_world.copy()
    assert bpy.ops.fastgs.set_upright(axis=axis) == {'FINISHED'}
    turn = placement(obj)[:3, :3]
    assert np.allclose(turn @ UP[axis], (0, 0, 1), atol=1e-5) and np.linalg.det(turn) == pytest.approx(1)
    assert obj.matrix_world == before and module("scene.upright").axis_of(obj) == axis
    assert bpy.ops.fastgs.set_upright() == {'FINISHED'}  # as the file says
    assert np.allclose(placement(obj)[:3, :3] @ (0, 1, 0), (0, 0, 1), atol=1e-5)


@pytest.mark.parametrize("axis", UP)
def test_an_import_asks_for_the_axis_of_files_that_do_not_say_it(fg, make_model, model_file, placement, tmp_path, axis):
    """In the panel of the last operation another choice imports again; files that say their axes win."""
    still = make_model(40, clip=fg.Clip(1), features=np.zeros((40, 3)), appearance=fg.SH(0))
    fg.save(still, tmp_path / "still.ply")
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "still.ply"), orientation=axis)
    assert np.allclose(placement(bpy.context.object)[:3, :3] @ UP[axis], (0, 0, 1), atol=1e-5)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes="RUB")), orientation=axis)
    assert np.allclose(placement(bpy.context.object)[:3, :3] @ (0, 1, 0), (0, 0, 1), atol=1e-5)


def test_what_was_applied_stays_and_crop_boxes_come_along(make_model, model_file, placement, scene):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes="RDF")))
    obj = bpy.context.object
    obj.scale, obj.location = (2, 2, 2), (1, 2, 3)
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    bpy.ops.fastgs.add_crop_box()
    box = obj.fastgs.crops[0].object
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    before = np.linalg.inv(placement(obj)) @ np.array(box.matrix_world)
    bpy.ops.fastgs.set_upright(axis='POS_Z')
    bpy.context.view_layer.update()
    after = placement(obj)
    assert np.allclose(after[:3, :3], 2 * np.eye(3), atol=1e-4)
    assert np.allclose(np.linalg.inv(after) @ np.array(box.matrix_world), before, atol=1e-4)


def test_another_object_with_the_same_mesh_stays(make_model, model_file, placement, scene):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes="RFU")))
    obj = bpy.context.object
    other = obj.copy()
    scene.collection.objects.link(other)
    bpy.ops.fastgs.set_upright(axis='NEG_Z')
    assert np.allclose(placement(other), np.eye(4), atol=1e-5) and placement(obj)[2, 2] == pytest.approx(-1)


def test_pictures_turn_with_it(fg, make_model, model_file, add_camera, render, scene):
    """A red Gaussian along the file's x axis is above the middle once that axis points up."""
    model = make_model(2, position=[[0.8, 0, 0], [0, 0, 0]], features=[[1, 0, 0], [0, 0, 1]], opacity=[9, 9], scale=np.full((2, 3), -2.0),
                       rotation=[[1, 0, 0, 0]] * 2, axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    add_camera(location=(0, -5, 0), rotation=(90, 0, 0))
    rows = []
    for axis in ('POS_X', 'NEG_X'):
        bpy.ops.fastgs.set_upright(axis=axis)
        red = render("PNG")[..., :3].astype(float)
        rows.append(np.argmax((red[..., 0] - red[..., 2]).max(1)))
    assert rows[0] < 24 < rows[1]


def test_the_popup_offers_all_axes(module):
    drawn = []

    class Layout:
        def label(self, text):
            pass

        def row(self, align):
            return self

        def prop_enum(self, data, name, value):
            drawn.append(value)

    module("operators.upright").FASTGS_OT_set_upright.draw(type("Shown", (), {"layout": Layout()})(), None)
    assert drawn[0] == 'FILE' and set(drawn[1:]) == set(UP)
