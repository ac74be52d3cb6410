# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera paths of other programs: imported exactly, and exported again."""
from __future__ import annotations

import json

import bpy
import by_hand
import numpy as np
import pytest
from camera_checks import assert_same, make_camera
from mathutils import Matrix


@pytest.fixture
def camera_paths(module):
    return module("fastgs_blender.cameras.paths")


FORMATS = {'FASTGS': True, 'NERFSTUDIO': False, 'INSTANT_NGP': False, 'SUPERSPLAT': False, 'CAMERAS_JSON': True, 'COLMAP': True,
           'TRANSFORMS_JSON': True}
"""Each format, and whether it holds any intrinsics."""


@pytest.fixture
def flight(scene, fg, module):
    """flight(full): a Blender camera with a key on each of ten frames from 7 on, animated focal length; full: shifted, oblong pixels."""

    def fly(full):
        scene.frame_start, scene.frame_end = 7, 16
        scene.render.resolution_x, scene.render.resolution_y = 320, 240
        scene.render.pixel_aspect_y = 1.25 if full else 1.0
        obj = bpy.data.objects.new("Flight", bpy.data.cameras.new("Flight"))
        scene.collection.objects.link(obj)
        scene.camera = obj
        obj.data.shift_x, obj.data.shift_y = (0.07, -0.04) if full else (0, 0)
        obj.rotation_mode = 'QUATERNION'
        for i, frame in enumerate(range(7, 17)):
            eye = (3 * np.cos(0.2 * i), 3 * np.sin(0.2 * i), 1 + 0.1 * i)
            obj.matrix_world = Matrix(by_hand.blender_matrix(by_hand.look_at(eye, (0, 0, 0.3))).tolist())
            obj.data.lens = 30 + 2 * i
            obj.keyframe_insert("location", frame=frame)
            obj.keyframe_insert("rotation_quaternion", frame=frame)
            obj.data.keyframe_insert("lens", frame=frame)
        return obj

    return fly


def shots_of(scene, obj, now, first=7, last=16):
    found = []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        found.append(now(obj))
    return found


@pytest.mark.parametrize("splats", [False, True])
@pytest.mark.parametrize("kind", FORMATS)
def test_a_path_goes_out_and_comes_back(scene, flight, now, tmp_path, kind, splats, make_model, model_file, splat_object):
    obj = flight(FORMATS[kind])
    if splats:
        matrix = Matrix.Translation((1, 2, 0)) @ Matrix.Rotation(0.3 if kind != 'SUPERSPLAT' else np.pi / 2, 4, 'Z')
        matrix = matrix @ Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1))) @ Matrix.Scale(2, 4)
        splat_object(model_file(make_model()), matrix=np.array(matrix))
    wanted = shots_of(scene, obj, now)
    scene.frame_set(9)
    file = tmp_path / "path.json"
    assert bpy.ops.fastgs.export_camera_path(filepath=str(file), format=kind) == {'FINISHED'}
    assert scene.frame_current == 9 and file.is_file() == (kind != 'COLMAP')
    file = tmp_path / "path" if kind == 'COLMAP' else file
    assert bpy.ops.fastgs.import_camera_path(filepath=str(file)) == {'FINISHED'}
    assert scene.camera != obj and scene.frame_current == 9
    for got, camera in zip(shots_of(scene, scene.camera, now), wanted, strict=True):
        assert_same(got, camera)


@pytest.mark.parametrize("size", [(1920, 1080), (1080, 1920), (997, 331), (4096, 2160)])
def test_cameras_as_blender_makes_them_lose_nothing(scene, add_camera, tmp_path, capfd, size):
    """Square pixels and an unshifted lens are told to be nothing else."""
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.frame_start, scene.frame_end = 1, 3
    camera = add_camera()
    for lens in (50.0, 33.3, 120.0):
        camera.data.lens = lens
        for kind in ('NERFSTUDIO', 'INSTANT_NGP', 'SUPERSPLAT'):
            assert bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"), format=kind) == {'FINISHED'}
    told = [line for line in capfd.readouterr().out.splitlines() if "Warning" in line]
    assert len(told) == 3 and all("size of pictures" in line for line in told), "SuperSplat's only"


def test_the_file_holds_what_the_engine_renders(scene, flight, now, tmp_path, camera_paths, module):
    """Not only do export and import agree: the file itself is right, in the world of the capture's axes."""
    wanted = shots_of(scene, flight(True), now)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "cameras.json"), format='CAMERAS_JSON')
    upright = np.array(module("scene.objects").axes_matrix("RDF"))
    for entry, camera in zip(json.loads((tmp_path / "cameras.json").read_text()), wanted, strict=True):
        centre = np.linalg.inv(camera.world_to_camera)[:3, 3]
        np.testing.assert_allclose(upright[:3, :3] @ entry["position"], centre, atol=1e-6)
        np.testing.assert_allclose(upright[:3, :3] @ np.array(entry["rotation"])[:, 2], camera.world_to_camera[2, :3], atol=1e-6)
        assert (entry["fx"], entry["fy"], entry["cx"]) == (camera.fx, camera.fy, camera.cx)


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != 'SUPERSPLAT'])
def test_selected_cameras_keep_their_names(scene, add_camera, now, tmp_path, camera_paths, kind):
    wanted = {}
    for i, name in enumerate(["right", "left eye", "middle"]):
        camera = add_camera((1 + i, -3, 0.5), lens=30.0 + i)
        camera.name = name
        camera.select_set(i < 2)
        wanted[name] = now(camera)
    where = tmp_path / "rig.json"
    assert bpy.ops.fastgs.export_camera_path(filepath=str(where), format=kind, selected=True, space='WORLD') == {'FINISHED'}
    path = camera_paths.load_path(tmp_path / "rig" if kind == 'COLMAP' else where)
    assert list(path.names) == ["left eye", "right"]
    for name, camera in zip(path.names, path.cameras, strict=True):
        assert (camera.width, camera.fx) == (wanted[name].width, pytest.approx(wanted[name].fx))
    bpy.ops.object.select_all(action='DESELECT')
    with pytest.raises(RuntimeError, match="camera.*selected"):
        bpy.ops.fastgs.export_camera_path(filepath=str(where), format=kind, selected=True)


def test_scaled_world_keeps_positions(scene, flight, now, tmp_path, make_model, model_file, splat_object):
    obj = flight(False)
    splats = splat_object(model_file(make_model()), matrix=np.diag([4.0, 4, 4, 1]))
    scene.frame_set(7)
    at = np.array(obj.matrix_world.translation)
    bpy.context.view_layer.objects.active = splats
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"), use_range=True, frame_start=7, frame_end=7)
    (entry,) = json.loads((tmp_path / "p.json").read_text())["frames"]
    np.testing.assert_allclose(np.linalg.inv(entry["world_to_camera"])[:3, 3], at / 4, atol=1e-6)
    splats.scale = (1, 2, 1)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="stretched"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))


def test_a_file_s_own_keys_are_fewer_and_editable(scene, fg, tmp_path, camera_paths, module):
    rng = np.random.default_rng(0)
    shots = [make_camera(fg, rng, 64, 48, full=False) for _ in range(21)]
    path = camera_paths.CameraPath(shots, 12.0, 1, "RFU", [(0.0, shots[0]), (10.0, shots[10]), (20.0, shots[20])])
    camera_paths.save_path(path, tmp_path / "p.json")
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), keys='KEYS', keep_speed=True)
    curves = list(module("scene.cameras.keys").curves(scene.camera))
    assert len(curves) == 7
    for curve in curves:
        assert [round(point.co.x, 4) for point in curve.keyframe_points] == [1, 21, 41], "twice as long at 24 frames a second"
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), set_scene=True)
    assert (scene.render.fps, scene.frame_end) == (12, 21)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)


def test_the_scenes_camera_can_take_the_path(scene, flight, now, tmp_path):
    obj = flight(False)
    wanted = shots_of(scene, obj, now)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))
    rig = bpy.data.objects.new("Rig", None)
    scene.collection.objects.link(rig)
    obj.parent = rig
    rig.location = (1, 1, 1)
    count = len(bpy.data.objects)
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), new_camera=False)
    assert scene.camera == obj and len(bpy.data.objects) == count
    for got, camera in zip(shots_of(scene, obj, now), wanted, strict=True):
        assert_same(got, camera)


def test_losses_and_errors_are_reported(scene, flight, add_camera, tmp_path, capfd):
    flight(True)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"), format='NERFSTUDIO')
    assert "shift" in capfd.readouterr().out
    (tmp_path / "bad.json").write_text('{"camera_path": []}')
    before = len(bpy.data.objects)
    for path in ("bad.json", "absent.json"):
        with pytest.raises(RuntimeError, match=path):
            bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / path))
    assert len(bpy.data.objects) == before
    with pytest.raises(RuntimeError, match="absent"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "absent" / "p.json"))
    add_camera(type='ORTHO')
    with pytest.raises(RuntimeError, match="Perspective"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))


def test_menus():
    def entries(menu):
        return [f.__name__ for f in menu.draw._draw_funcs if "fastgs" in f.__module__]

    assert entries(bpy.types.TOPBAR_MT_file_import) == ["draw_import"]
    assert entries(bpy.types.TOPBAR_MT_file_export) == ["draw_export"]
