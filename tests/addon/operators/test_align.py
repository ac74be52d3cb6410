# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground and scale: objects move, model files do not change, and the objects of one capture keep their relative places."""
from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix

TILT = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.5, 4, 'X') @ Matrix.Rotation(0.3, 4, 'Y')


@pytest.fixture
def capture(scene, fg, make_model, model_file, splat_object):
    """A tilted splat object, a rig of four level cameras under an empty that lies as it does, and the floor's matrix."""
    splats = splat_object(model_file(make_model(axes="RFU")), matrix=np.array(TILT))
    splats.data.from_pydata([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 0.5, 1, 2)], [], [])
    world = bpy.data.objects.new("World", None)
    scene.collection.objects.link(world)
    world.matrix_world = TILT
    for i, angle in enumerate((0, 90, 180, 250)):
        camera = bpy.data.objects.new(f"cam{i}", bpy.data.cameras.new(f"cam{i}"))
        camera.data.fastgs.view = f"cam{i}"
        scene.collection.objects.link(camera)
        camera.parent = world
        camera.location = (3 * np.sin(np.radians(angle)), -3 * np.cos(np.radians(angle)), 1.5)
        camera.rotation_euler = np.radians((60, 0, angle))
    bpy.context.view_layer.update()
    return splats, world


def marks(scene, places):
    made = []
    for place in places:
        obj = bpy.data.objects.new("Mark", None)
        obj.location = place
        scene.collection.objects.link(obj)
        made.append(obj)
    select(made)
    bpy.context.view_layer.update()
    return made


def select(objects, active=None):
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = active


def assert_level(obj):
    np.testing.assert_allclose(np.array(obj.matrix_world)[2], [0, 0, 1, 0], atol=1e-5)


def test_ground_from_three_points(scene, capture):
    splats = capture[0]
    path = splats.fastgs.filepath
    made = marks(scene, [TILT @ Matrix.Translation(p).translation for p in ((0, 0, 0), (1, 0, 0), (0, -1, 0))])
    assert bpy.ops.fastgs.set_ground() == {'FINISHED'}
    for obj in capture:
        assert_level(obj)
    np.testing.assert_allclose([mark.matrix_world.translation.z for mark in made], 0, atol=1e-5)
    assert splats.fastgs.filepath == path
    assert bpy.data.objects["cam0"].matrix_world.translation.z == pytest.approx(1.5, abs=1e-4)


def test_ground_from_cameras(scene, capture):
    select([], capture[0])
    assert bpy.ops.fastgs.set_ground(source='CAMERAS') == {'FINISHED'}
    for obj in capture:
        assert_level(obj)


def test_no_camera_is_below_a_floor_that_nothing_shows(scene, capture, capfd):
    """Without splats the lowest camera stands on the floor, and the operator says that it is a guess."""
    bpy.data.objects.remove(capture[0])
    bpy.data.objects["cam1"].location.z -= 0.7
    bpy.context.view_layer.update()
    select([], capture[1])
    assert bpy.ops.fastgs.set_ground(source='CAMERAS') == {'FINISHED'}
    np.testing.assert_allclose(np.array(capture[1].matrix_world)[2, :3], [0, 0, 1], atol=1e-5)
    heights = [obj.matrix_world.translation.z for obj in scene.objects if obj.type == 'CAMERA']
    assert min(heights) == pytest.approx(0, abs=1e-4) and max(heights) == pytest.approx(0.7, abs=1e-4)
    assert "where the floor" in capfd.readouterr().out


def test_scale_from_two_points(scene, capture):
    a, b = marks(scene, [(1, 1, 0), (1, 3, 0)])
    assert bpy.ops.fastgs.set_scale(distance=0.5) == {'FINISHED'}
    assert (a.matrix_world.translation - b.matrix_world.translation).length == pytest.approx(0.5)
    for obj in capture:
        np.testing.assert_allclose(obj.matrix_world.to_scale(), 0.25, atol=1e-6)
        np.testing.assert_allclose(obj.matrix_world.translation, 0.25 * np.array(TILT.translation), atol=1e-6)


def test_scale_from_two_cameras_of_the_capture(scene, capture):
    """A rig whose cameras' distance was measured; with empties selected too, these are meant."""
    cameras = [bpy.data.objects[name] for name in ("cam0", "cam2")]
    select(cameras)
    assert bpy.ops.fastgs.set_scale(distance=3) == {'FINISHED'}
    assert (cameras[0].matrix_world.translation - cameras[1].matrix_world.translation).length == pytest.approx(3)
    np.testing.assert_allclose(capture[0].matrix_world.to_scale(), 0.5, atol=1e-6)
    np.testing.assert_allclose(capture[1].matrix_world.to_scale(), 0.5, atol=1e-6)
    a, b = marks(scene, [(1, 1, 0), (1, 3, 0)])
    select([a, b, *cameras])
    assert bpy.ops.fastgs.set_scale(distance=4) == {'FINISHED'}
    np.testing.assert_allclose(capture[0].matrix_world.to_scale(), 1, atol=1e-6)
    select(cameras)
    with pytest.raises(RuntimeError, match="capture's cameras"):
        bpy.ops.fastgs.set_ground()


def test_vertices_of_the_proxy_are_points_too(scene, capture):
    import bmesh

    splats = capture[0]
    select([splats], splats)
    bpy.ops.object.mode_set(mode='EDIT')
    mesh = bmesh.from_edit_mesh(splats.data)
    for vertex in mesh.verts:
        vertex.select_set(vertex.co.z == 0 and tuple(vertex.co[:2]) != (1, 1))
    assert bpy.ops.fastgs.set_ground() == {'FINISHED'}
    bpy.ops.object.mode_set(mode='OBJECT')
    for obj in capture:
        assert_level(obj)


def test_only_what_is_chosen_moves(scene, capture, splat_object, make_model, model_file):
    other = splat_object(model_file(make_model(), "other.safetensors"), name="Other")
    select([other], other)
    scene.cursor.location = (0, 0, 0)
    made = marks(scene, [(0, 0, 1), (1, 0, 1), (0, 1, 1)])
    select([*made, other], other)
    bpy.ops.fastgs.set_ground()
    assert other.matrix_world.translation.z == pytest.approx(-1, abs=1e-6)
    np.testing.assert_allclose(capture[0].matrix_world, TILT, atol=1e-6)


def test_a_child_goes_once_with_its_parent(scene, capture):
    splats, world = capture
    world.parent = splats
    world.matrix_world = TILT
    marks(scene, [(0, 0, 0), (0, 2, 0)])
    bpy.ops.fastgs.set_scale(distance=4)
    np.testing.assert_allclose(world.matrix_world, splats.matrix_world, atol=1e-5)
    np.testing.assert_allclose(splats.matrix_world.to_scale(), 2, atol=1e-5)


def test_what_is_missing_is_said(scene, capture):
    select([])
    for call, words in ((bpy.ops.fastgs.set_ground, "select 3 objects"), (bpy.ops.fastgs.set_scale, "select 2 objects")):
        with pytest.raises(RuntimeError, match=words):
            call()
    marks(scene, [(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    with pytest.raises(RuntimeError, match="on a line"):
        bpy.ops.fastgs.set_ground()
    for name in ("cam0", "cam1", "cam2", "cam3"):
        bpy.data.objects.remove(bpy.data.objects[name])
    with pytest.raises(RuntimeError, match="no cameras"):
        bpy.ops.fastgs.set_ground(source='CAMERAS')
    np.testing.assert_allclose(capture[0].matrix_world, TILT, atol=1e-6)
