# SPDX-License-Identifier: GPL-3.0-or-later
"""Bullet time, following, a hand's shake and keys from the view: smooth, and ordinary animation that stays editable."""
from dataclasses import replace

import bpy
import numpy as np
import pytest
from camera_tracks import assert_smooth, keyed, track
from mathutils import Euler, Matrix


@pytest.fixture
def moving_splat(scene, make_model, model_file, splat_object, fg):
    """A cloud that moves along x by 4 during a clip of 48 frames at 24 fps, and a cloud that stays."""
    model = make_model(60, spread=0.3, opacity=np.full(60, 3.0))
    model.position[30:, 2] += 5
    motion = np.zeros((60, 1, 3))
    motion[:30, 0, 0] = 4.0
    path = model_file(replace(model, motion=motion, basis=fg.Polynomial(1), clip=fg.Clip(48, 24.0)))
    obj = splat_object(path)
    obj.fastgs.fps, obj.fastgs.frame_count, obj.fastgs.start_frame = 24, 48, 1
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.context.view_layer.update()
    return obj


def shown(module, scene, obj, at):
    scene.frame_set(int(at), subframe=float(at % 1))
    settings = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    retime = module("scene.snapshot").retime_of(settings, at)
    return module("scene.time").clip_frame(at, scene.render.fps, retime, module("scene.objects").load_model(obj.fastgs.filepath).clip)


@pytest.mark.parametrize(("speed", "ramp"), [(0.0, 6), (0.25, 6), (0.0, 0)])
def test_bullet_time_slows_and_goes_on_without_a_jump(scene, module, moving_splat, speed, ramp):
    scene.render.fps = 24
    assert bpy.ops.fastgs.bullet_time(start=11, length=20, speed=speed, ramp=ramp) == {'FINISHED'}
    frames = np.arange(1, 45, 0.25)
    clip = np.array([shown(module, scene, moving_splat, at) for at in frames])
    rate = np.diff(clip) / 0.25
    np.testing.assert_allclose(rate[frames[:-1] < 11], 1, atol=1e-3)
    np.testing.assert_allclose(rate[(frames[:-1] >= 11 + ramp) & (frames[:-1] < 31 - ramp)], speed, atol=1e-2)
    np.testing.assert_allclose(rate[frames[:-1] >= 31], 1, atol=1e-3)
    if ramp:
        assert np.abs(np.diff(rate)).max() < 0.06
    with pytest.raises(RuntimeError, match="animated.*Time Shift"):
        bpy.ops.fastgs.bullet_time(start=40, length=5)


def test_bullet_time_is_keys_that_can_be_moved(scene, module, moving_splat):
    """One F-curve of the object; lowering its last two points takes as much of the clip away from then on, and nothing before."""
    scene.render.fps = 24
    bpy.ops.fastgs.bullet_time(start=11, length=20, speed=0.0, ramp=6)
    curve, = keyed(module, moving_splat)
    assert curve.data_path == "fastgs.offset" and not curve.modifiers and not moving_splat.animation_data.drivers
    assert [point.co.x for point in curve.keyframe_points] == [11, 17, 25, 31]
    frames = np.array([1, 11, 14, 17, 25, 28, 31, 40], float)
    before = np.array([shown(module, scene, moving_splat, at) for at in frames])
    for point in list(curve.keyframe_points)[2:]:
        for part in ("co", "handle_left", "handle_right"):
            getattr(point, part).y -= 2
    curve.update()
    after = np.array([shown(module, scene, moving_splat, at) for at in frames])
    np.testing.assert_allclose(after - before, [0, 0, 0, 0, -2, -2, -2, -2], atol=1e-3)


@pytest.mark.parametrize("how", ['LOOK', 'MOVE'])
def test_following_a_region(scene, module, moving_splat, add_camera, how):
    scene.render.fps = 24
    camera = add_camera(location=(0, -5, 0))
    bpy.context.view_layer.objects.active = moving_splat
    bpy.context.view_layer.update()
    scene.cursor.location = (0, 0, 0)
    scene.frame_set(1)
    bpy.ops.fastgs.follow_region(radius=1.0, how=how, frame_start=1, frame_end=41, smooth=2.0)
    rows = []
    for at in range(4, 39):
        scene.frame_set(at)
        matrix = np.array(camera.matrix_world)
        middle = np.array([4 * (at - 1) / 48, 0, 0])
        if how == 'LOOK':
            aim = middle - matrix[:3, 3]
            assert -matrix[:3, 2] @ aim / np.linalg.norm(aim) > 0.995
        rows.append(matrix[:3, 3] - middle)
    assert how == 'LOOK' or np.ptp(rows, axis=0).max() < 0.02
    scene.frame_start, scene.frame_end = 4, 38
    assert_smooth(track(scene, camera, 4), 0.15)
    empty = next(o for o in scene.objects if o.type == 'EMPTY')
    keys = module("scene.cameras.keys").curves(empty).find("location", index=0).keyframe_points
    assert [point.co.x for point in keys] == list(range(1, 42)) and not camera.animation_data
    scene.cursor.location = (0, 0, 90)
    with pytest.raises(RuntimeError, match="visible.*3D cursor"):
        bpy.ops.fastgs.follow_region(radius=1.0)


@pytest.mark.parametrize("mode", ['XYZ', 'QUATERNION'])
def test_a_hand_shakes_the_camera_and_lets_go(scene, add_camera, mode):
    camera = add_camera()
    camera.rotation_mode = mode
    scene.frame_start, scene.frame_end = 1, 121
    still = track(scene, camera, 1)
    bpy.ops.fastgs.handheld(sway=0.05, turn=0.02, seed=3)
    shaken = track(scene, camera, 4)
    off = np.abs(shaken[:, :3] - still[0, :3])
    assert 0.005 < off.max() < 0.2 and np.abs(shaken[:, 3:6] - still[0, 3:6]).max() > 0.002
    assert_smooth(shaken)
    bpy.ops.fastgs.handheld(sway=0.05, turn=0.02, seed=3)
    np.testing.assert_allclose(track(scene, camera, 4), shaken, atol=1e-6)  # the same seed, the same hand; once, not twice
    bpy.ops.fastgs.handheld(remove=True)
    np.testing.assert_allclose(track(scene, camera, 1), still, atol=1e-6)


def test_a_shake_is_a_modifier_on_curves_and_leaves_the_cameras_keys_alone(scene, module, add_camera):
    """A key of the camera that is moved moves the path; the shake, weaker or muted, is a slider of the graph editor."""
    camera = add_camera()
    scene.frame_start, scene.frame_end = 1, 61
    for at, x in ((1, 0.0), (31, 1.0), (61, 2.0)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=at)
    still = track(scene, camera, 2)
    bpy.ops.fastgs.handheld(sway=0.05, turn=0.02)
    shaken = track(scene, camera, 2)
    found = keyed(module, camera)
    assert [p.co.x for p in found.find("location", index=0).keyframe_points] == [1, 31, 61]
    point = found.find("location", index=0).keyframe_points[1]
    for part in ("co", "handle_left", "handle_right"):
        getattr(point, part).y += 0.5
    moved = track(scene, camera, 2) - shaken
    assert moved[60, 0] == pytest.approx(0.5, abs=1e-5) and abs(moved[[0, -1], 0]).max() < 1e-5 and abs(moved[:, 1:]).max() < 1e-5
    for part in ("co", "handle_left", "handle_right"):
        getattr(point, part).y -= 0.5
    shakes = [modifier for curve in found for modifier in curve.modifiers]
    assert len(shakes) == 6 and {modifier.type for modifier in shakes} == {'NOISE'}
    for modifier in shakes:
        modifier.strength /= 2
    np.testing.assert_allclose((track(scene, camera, 2) - still)[:, :3], (shaken - still)[:, :3] / 2, atol=1e-5)
    for modifier in shakes:
        modifier.mute = True
    np.testing.assert_allclose(track(scene, camera, 2), still, atol=1e-5)


@pytest.fixture
def view(scene):
    """view(turn, location, lens=50.0): a context whose 3D view looks as a camera there would, turned by Euler angles in degrees."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == 'VIEW_3D')
    space, region = area.spaces.active, next(region for region in area.regions if region.type == 'WINDOW')

    def look(turn, location, lens=50.0):
        matrix = Matrix.Translation(location) @ Euler(np.radians(turn)).to_matrix().to_4x4()
        seen = space.region_3d
        seen.view_perspective, space.lens = 'PERSP', lens
        seen.view_matrix = matrix.inverted()
        return bpy.context.temp_override(window=window, area=area, region=region, space_data=space, region_data=seen)

    return look


@pytest.mark.parametrize("mode", ['XYZ', 'QUATERNION'])
def test_keys_from_the_view_make_a_smooth_editable_move(scene, module, add_camera, view, mode):
    """More than half around, with a zoom: one key of all channels for each press, and between them the short way."""
    camera = add_camera(sensor_width=36.0)
    camera.rotation_mode = mode
    wanted = {}
    for i in range(6):
        angle = 50 * i
        at, turn = 1 + 12 * i, (80, 0, angle)
        place = (6 * np.sin(np.radians(angle)), -6 * np.cos(np.radians(angle)), 1 + 0.2 * i)
        scene.frame_set(at)
        with view(turn, place, 50 + 4 * i):
            assert bpy.ops.fastgs.key_from_view() == {'FINISHED'}
        wanted[at] = [*place, *-np.array(Euler(np.radians(turn)).to_matrix())[:, 2], 25 + 2 * i]
    scene.frame_start, scene.frame_end = 1, 61
    rows = track(scene, camera)
    for at, row in wanted.items():
        np.testing.assert_allclose(rows[8 * (at - 1)], row, atol=1e-4)
    assert_smooth(rows)
    turned = np.degrees(np.arccos(np.clip((rows[:-1, 3:6] * rows[1:, 3:6]).sum(1), -1, 1))) * 8
    assert turned.max() < 8, "about 4 degrees a frame, and never the long way around"
    names = {curve.data_path for curve in keyed(module, camera)}
    assert names == {"location", "rotation_quaternion" if mode == 'QUATERNION' else "rotation_euler"}
    assert [curve.data_path for curve in keyed(module, camera.data)] == ["lens"]
    for owner in (camera, camera.data):
        for curve in keyed(module, owner):
            assert [point.co.x for point in curve.keyframe_points] == list(wanted) and not curve.modifiers
    curve = keyed(module, camera).find("location", index=2)
    for part in ("co", "handle_left", "handle_right"):
        getattr(curve.keyframe_points[2], part).y += 1
    curve.update()
    assert track(scene, camera)[8 * 24, 2] == pytest.approx(wanted[25][2] + 1, abs=1e-4)


def test_a_key_from_the_view_says_what_other_keys_it_comes_between(scene, add_camera, view, capfd):
    add_camera()
    for frame, words in ((10, "keyed on frame 10."), (30, "after its key on frame 10"), (5, "before its key on frame 10"),
                         (20, "between its keys on frames 10 and 30"), (20, "in place of the key")):
        scene.frame_set(frame)
        with view((90, 0, frame), (0, -4, 1)):
            bpy.ops.fastgs.key_from_view()
        assert words in capfd.readouterr().out


def test_a_key_from_the_view_is_undone_in_one_step(scene, module, add_camera, view):
    assert 'UNDO' in module("operators.camera_life").FASTGS_OT_key_from_view.bl_options
    add_camera(location=(1, 2, 3), lens=35)
    bpy.ops.ed.undo_push(message="before")
    with view((90, 0, 0), (0, -4, 1)):
        bpy.ops.fastgs.key_from_view()
    bpy.ops.ed.undo_push(message="key")  # a window does this by itself; without one Blender cannot, in a 3D view's context
    assert bpy.data.objects["Camera"].animation_data.action and tuple(bpy.data.objects["Camera"].location) != (1, 2, 3)
    bpy.ops.ed.undo()
    camera = bpy.data.objects["Camera"]
    assert not (camera.animation_data and camera.animation_data.action) and not camera.data.animation_data
    assert tuple(camera.location) == (1, 2, 3) and camera.data.lens == 35


def test_a_scene_without_a_camera_gets_one_from_the_view(scene, view):
    with view((70, 0, 20), (2, -5, 4)):
        bpy.ops.fastgs.key_from_view()
    np.testing.assert_allclose(scene.camera.location, (2, -5, 4), atol=1e-4)
    assert scene.camera.animation_data.action
