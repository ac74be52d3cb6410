# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyed and driven Speed: the clip's frame is the integral of the speed, on any frame and in any order.

Expected values are sums of what Blender says the speed is, in small steps, or integrals by hand.
"""
from __future__ import annotations

import bpy
import image_files
import numpy as np
import pytest

START = 3.0


@pytest.fixture
def obj(fg, make_model, model_file, scene):
    """A clip of 400 frames at the scene's rate, which begins on frame 3."""
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(clip=fg.Clip(400, 24.0))))
    obj = bpy.context.object
    obj.fastgs.start_frame = START
    return obj


def keyed(obj, keys, kind='LINEAR', path="speed"):
    """Key the speed, [(frame, value), ...]; its curve."""
    for frame, value in keys:
        setattr(obj.fastgs, path, value)
        obj.fastgs.keyframe_insert(path, frame=frame)
    (curve,) = [c for c in image_files.fcurves(obj) if c.data_path == f"fastgs.{path}"]
    for point in curve.keyframe_points:
        point.interpolation = kind
    curve.update()
    return curve


def shown(module, scene, obj, frame):
    """The capture's frame that shows on a frame of the scene, evaluated there."""
    scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    snapshot = module("scene.snapshot").take(depsgraph)
    (instance,) = snapshot.load()[0]
    return instance.t * 400


def summed(speed, first, last, steps=400_000):
    """The integral of a function by the middles of small steps."""
    middle = first + (np.arange(steps) + 0.5) * (last - first) / steps
    return np.mean([speed(x) for x in middle]) * (last - first)


def bent(curve):
    """Handles that are long, cross each other, and stand upright."""
    for number, point in enumerate(curve.keyframe_points):
        point.handle_left_type = point.handle_right_type = 'FREE'
        x, y = point.co
        point.handle_right = (x + (30, 0, 4)[number % 3], y + 2)
        point.handle_left = (x - (25, 1, 0)[number % 3], y - 1)
    curve.update()


def repeated(curve):
    curve.modifiers.new('CYCLES')


def stepped(curve):
    modifier = curve.modifiers.new('STEPPED')
    modifier.frame_step, modifier.frame_offset = 2.5, 0.7


def straight_on(curve):
    curve.extrapolation = 'LINEAR'


KEYS = [(1, 2.0), (12, 0.5), (20, 3.0), (31, 1.0)]
CURVES = {"constant": ('CONSTANT', None), "linear": ('LINEAR', None), "bezier": ('BEZIER', None), "bent": ('BEZIER', bent),
          "eased": ('SINE', None), "bounced": ('BOUNCE', None), "repeated": ('LINEAR', repeated), "stepped": ('LINEAR', stepped),
          "straight on": ('BEZIER', straight_on)}


@pytest.mark.parametrize("name", CURVES)
def test_the_clip_has_run_as_far_as_the_curve_says(module, obj, scene, name):
    kind, change = CURVES[name]
    curve = keyed(obj, KEYS, kind)
    if change:
        change(curve)
    obj.fastgs.offset = 100
    for frame in (40.0, 7.25, 20.0, 1.0, 26.6, 3.0):  # in any order, before the start too
        wanted = 100 + summed(curve.evaluate, START, frame, 40_000 if frame > 3 else 2000)
        assert shown(module, scene, obj, frame) == pytest.approx(wanted, abs=2e-3), frame


def test_a_ramp_by_hand_at_another_rate(module, fg, obj, scene):
    """From 1 to 3 on frames 3 to 13: after s of these the clip has run s + s^2 / 10 of the scene's frames; at half of the clip's rate twice
    as many of the clip's."""
    scene.render.fps = 12
    keyed(obj, [(3, 1.0), (13, 3.0)])
    for frame in (13, 8.5, 3, 5):
        s = frame - 3
        assert shown(module, scene, obj, frame) == pytest.approx(2 * (s + s * s / 10), abs=1e-4)


def test_it_turns_around_without_a_jump_and_begins_where_it_is_negative_at_the_end(module, obj, scene):
    keyed(obj, [(3, 2.0), (23, -2.0)])
    frames = [shown(module, scene, obj, frame) for frame in (3, 13, 13.5, 23)]
    assert frames == pytest.approx([0, 10, 9.975, 0], abs=1e-4)
    for curve in image_files.fcurves(obj):
        for point in curve.keyframe_points:
            point.co.y = -1
    assert [shown(module, scene, obj, frame) for frame in (3, 13)] == pytest.approx([399, 389], abs=1e-3)


@pytest.mark.parametrize(("expression", "value"), [
    ("frame / 10", lambda f: f / 10), ("1 if frame < 10 else 0.25", lambda f: 1.0 if f < 10 else 0.25),
    ("control * 2", lambda f: 2 * np.clip(1 + (f - 1) / 20, 1, 2))])
def test_drivers_are_integrated(module, obj, scene, expression, value):
    """Simple expressions of the frame, and of a keyed property of another object."""
    empty = bpy.data.objects.new("Control", None)
    scene.collection.objects.link(empty)
    empty["control"] = 1.0
    for frame, number in ((1, 1.0), (21, 2.0)):
        empty["control"] = number
        empty.keyframe_insert('["control"]', frame=frame)
    for point in image_files.fcurves(empty)[0].keyframe_points:
        point.interpolation = 'LINEAR'
    driver = obj.driver_add("fastgs.speed").driver
    driver.expression = expression
    if "control" in expression:
        variable = driver.variables.new()
        variable.name, variable.targets[0].id, variable.targets[0].data_path = "control", empty, '["control"]'
    bpy.context.view_layer.update()
    scene.frame_set(9)
    assert obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).fastgs.speed == pytest.approx(value(9.0), abs=1e-6)
    for frame in (25.0, 12.5, 5.0):
        assert shown(module, scene, obj, frame) == pytest.approx(summed(value, START, frame, 20_000), abs=2e-3)


def test_muted_curves_and_drivers_that_need_python_count_as_no_curve(module, obj, scene):
    """The speed is then what it is on the frame, as it always was."""
    curve = keyed(obj, [(3, 2.0), (13, 2.0)])
    curve.mute = True
    obj.fastgs.speed = 1.5
    assert shown(module, scene, obj, 13) == pytest.approx(15, abs=1e-4)
    speeds = module("scene.speeds")
    obj.driver_add("fastgs.speed").driver.expression = "__import__('os').getpid()"
    assert speeds.speed_of(obj) is None


def test_f12_blurs_a_keyed_speed_as_the_capture_frames_that_it_means(module, fg, scene, model_file, add_camera, render):
    """A speed from 0 to 2 on 20 frames is a parabola of the capture's frames, which a Bezier segment holds exactly."""
    rng = np.random.default_rng(0)
    model = fg.GaussianModel(
        position=rng.uniform(-0.5, 0.5, (30, 3)), rotation=rng.normal(size=(30, 4)), scale=np.full((30, 3), -2.5), opacity=np.full(30, 3.0),
        features=rng.uniform(0, 1, (30, 3)), motion=np.tile([4.0, 0, 0], (30, 1, 1)), basis=fg.Polynomial(1), mu_tau=np.zeros(30),
        clip=fg.Clip(40, 24.0), axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    obj = bpy.context.object
    obj.fastgs.start_frame = 1
    add_camera()
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    keyed(obj, [(1, 0.0), (21, 2.0)])
    frames = (6, 17)
    pictures = []
    for frame in frames:
        scene.frame_set(frame)
        pictures.append(render()["ViewLayer.Combined"])
    obj.animation_data_clear()
    obj.fastgs.use_capture_frame = True
    curve = keyed(obj, [(1, 0.0), (21, 20.0)], 'BEZIER', "capture_frame")
    for point, slope in zip(curve.keyframe_points, (0.0, 2.0)):
        point.handle_left_type = point.handle_right_type = 'FREE'
        x, y = point.co
        point.handle_left, point.handle_right = (x - 20 / 3, y - slope * 20 / 3), (x + 20 / 3, y + slope * 20 / 3)
    curve.update()
    for frame, picture in zip(frames, pictures):
        scene.frame_set(frame)
        np.testing.assert_allclose(picture, render()["ViewLayer.Combined"], atol=2e-4)
    scene.render.use_motion_blur = False
    assert np.abs(render()["ViewLayer.Combined"] - pictures[-1]).max() > 0.01


def test_ends_and_splits_follow_the_curve(module, obj, scene):
    """At speed 2 the clip of 400 frames lasts 200; a ramp from 1 to 3 over 100 frames runs 200, and at 3 the rest takes 66.7."""
    keyed(obj, [(3, 2.0), (4, 2.0)])
    bpy.ops.fastgs.fit_scene()
    assert (scene.frame_start, scene.frame_end) == (3, 202)
    obj.animation_data_clear()
    keyed(obj, [(3, 1.0), (103, 3.0)])
    frame_range = module("scene.frame_range")
    assert frame_range.clip_length(obj) == pytest.approx(100 + 200 / 3, abs=1e-3)
    whole = [shown(module, scene, obj, frame) for frame in range(3, 60)]
    scene.frame_set(30)
    assert bpy.ops.fastgs.split() == {'FINISHED'}
    for frame, wanted in zip(range(3, 60), whole, strict=True):
        assert shown(module, scene, obj, frame) == pytest.approx(wanted, abs=1e-3)
    with pytest.raises(RuntimeError, match="one speed"):
        bpy.ops.fastgs.add_sound(filepath="/nowhere.wav")


def test_bullet_time_needs_a_speed_that_stays(obj, scene):
    keyed(obj, KEYS)
    with pytest.raises(RuntimeError, match="animated Speed"):
        bpy.ops.fastgs.bullet_time(start=5)
