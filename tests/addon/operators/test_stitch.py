# SPDX-License-Identifier: GPL-3.0-or-later
"""Two captures in one scene: aligned by pairs and by their surfaces, graded, faded; loops of a clip.  Each is one step of undo."""
from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from stitched_scenes import motion, off, part, place, swinging


@pytest.fixture
def two(fg, model_file):
    """two(a, b): the objects of two models, the first selected, the second active."""
    def make(a, b):
        made = []
        for model, name in ((a, "second"), (b, "first")):
            bpy.ops.import_scene.fastgs(filepath=model_file(model, f"{name}.safetensors"))
            made.append(bpy.context.object)
        chosen(*made)
        return made

    return make


def chosen(obj, active):
    for other in bpy.context.scene.objects:
        other.select_set(other in (obj, active))
    bpy.context.view_layer.objects.active = active
    bpy.context.view_layer.update()


def pairs_of(obj, fixed, points):
    """What Align by Pairs takes: places of two objects that show the same model."""
    here, there = (np.array(o.matrix_world) for o in (obj, fixed))
    return [value for p in points for m in (here, there) for value in m[:3, :3] @ p + m[:3, 3]]


@pytest.mark.parametrize("parented", [False, True])
def test_three_pairs(fg, two, parented):
    model = part(fg, 0, -1, 1, axes="RFU")
    obj, fixed = two(model, model)
    obj.matrix_world = Matrix(motion(np.random.default_rng(1), 1.2, 3, 0.5).tolist())
    fixed.matrix_world = Matrix(motion(np.random.default_rng(2), 0.4, 1, 2.0).tolist())
    if parented:
        parent = bpy.data.objects.new("Parent", None)
        bpy.context.scene.collection.objects.link(parent)
        parent.matrix_world = Matrix(motion(np.random.default_rng(3), 0.9, 2, 1.5).tolist())
        obj.parent = parent
    bpy.context.view_layer.update()
    before = np.array(fixed.matrix_world)
    places = pairs_of(obj, fixed, np.array([[0, 0, 0], [1, 0.2, 0], [0, 1, 0.5]]))
    assert bpy.ops.fastgs.align_pairs(places=places) == {'FINISHED'}
    assert np.array(obj.matrix_world) == pytest.approx(before, abs=2e-5) and np.array(fixed.matrix_world) == pytest.approx(before)


def test_pairs_that_do_not_fit_are_told(fg, two, capfd):
    """Such as three that were clicked in the wrong order; places that are a little off are no such pairs."""
    obj, fixed = two(*[part(fg, 0, -1, 1, axes="RFU")] * 2)
    points = np.array([[0, 0, 0], [1, 0.2, 0], [0, 1, 0.5]])
    places = pairs_of(obj, fixed, points)
    assert bpy.ops.fastgs.align_pairs(places=np.array(places) + np.random.default_rng(0).normal(0, 0.02, 18)) == {'FINISHED'}
    assert "Warning" not in capfd.readouterr().out
    places[3:6], places[9:12] = places[9:12], places[3:6]
    assert bpy.ops.fastgs.align_pairs(places=places) == {'FINISHED'}
    assert "do not fit" in capfd.readouterr().out


def test_a_linked_capture_is_not_graded(fg, two, module, tmp_path):
    two(*[part(fg, 0, -1, 1)] * 2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"), copy=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["second"]
    with pytest.raises(fg.FastGSError, match="linked"):
        module("scene.stitching").grade(wanted.objects[0], {"exposure": 1.0})
    assert wanted.objects[0].fastgs.exposure == 0


def test_what_would_not_stay_is_refused(fg, two):
    model = part(fg, 0, -1, 1)
    obj, fixed = two(model, model)
    places = pairs_of(obj, fixed, np.eye(3))
    obj.keyframe_insert("location", frame=1)
    with pytest.raises(RuntimeError, match="animated"):
        bpy.ops.fastgs.align_pairs(places=places)
    obj.animation_data_clear()
    fixed.parent = obj
    with pytest.raises(RuntimeError, match="child"):
        bpy.ops.fastgs.align_pairs(places=places)
    fixed.parent = None
    held = obj.constraints.new('LIMIT_LOCATION')
    held.use_max_x, held.max_x = True, -5.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="constraint"):
        bpy.ops.fastgs.align_pairs(places=pairs_of(obj, fixed, np.eye(3)))
    with pytest.raises(RuntimeError, match="on a line"):
        bpy.ops.fastgs.align_pairs(places=[0.0] * 18)
    with pytest.raises(RuntimeError, match="No places"):
        bpy.ops.fastgs.align_pairs()
    obj.select_set(False)
    assert not bpy.ops.fastgs.align_pairs.poll() and not bpy.ops.fastgs.match_grade.poll()


def test_overlap_with_transforms_and_undo(fg, two):
    obj, fixed = two(part(fg, 0, -3, 1, axes="RFU"), part(fg, 0, -1, 3, axes="RFU"))
    world, true = motion(np.random.default_rng(4), 0.7, 2, 1.7), motion(np.random.default_rng(5), 0.2, 0.4)
    fixed.matrix_world, obj.matrix_world = Matrix(world.tolist()), Matrix((true @ world).tolist())
    bpy.context.view_layer.update()
    was = np.array(obj.matrix_world)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.fastgs.align_overlap() == {'FINISHED'}
    assert off(np.linalg.inv(world) @ np.array(obj.matrix_world), place(0)[0]) < 0.03
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert np.array(bpy.data.objects["second"].matrix_world) == pytest.approx(was, abs=1e-5)


def test_grade_is_a_look_and_survives_the_blend(fg, two, tmp_path):
    model = part(fg, 4, -2, 2, axes="RFU")
    obj, fixed = two(model, model)
    fixed.fastgs.exposure, fixed.fastgs.saturation = 0.7, 0.6
    assert bpy.ops.fastgs.match_grade() == {'FINISHED'}
    assert obj.fastgs.exposure == pytest.approx(0.7, abs=0.06) and obj.fastgs.saturation == pytest.approx(0.6, abs=0.06)
    bpy.ops.fastgs.cross_fade(start=10, frames=20)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    obj = bpy.data.objects["second"]
    assert obj.fastgs.exposure == pytest.approx(0.7, abs=0.06)
    assert opacity(obj, 15, 0.5) == pytest.approx(1 - 5.5 / 20, abs=1e-5)


def opacity(obj, frame, part=0.0):
    bpy.context.scene.frame_set(frame, subframe=part)
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).fastgs.opacity


def test_a_cross_fade_is_exact_between_frames(fg, two):
    obj, fixed = two(part(fg, 0, -1, 1), part(fg, 0, -1, 1))
    obj.fastgs.opacity = 0.8
    assert bpy.ops.fastgs.cross_fade(start=10, frames=20) == {'FINISHED'}
    for frame, share in ((5, 0), (10, 0), (12.25, 0.1125), (20, 0.5), (29.5, 0.975), (30, 1), (60, 1)):
        whole, rest = int(frame), frame - int(frame)
        assert opacity(obj, whole, rest) == pytest.approx(0.8 * (1 - share), abs=1e-5)
        assert opacity(fixed, whole, rest) == pytest.approx(share, abs=1e-5)
    bpy.ops.fastgs.cross_fade(start=10, frames=20, overlap=1.0)
    assert opacity(obj, 20) == pytest.approx(0.8, abs=1e-5) and opacity(fixed, 20) == pytest.approx(1, abs=1e-5)
    assert opacity(obj, 25) == pytest.approx(0.4, abs=1e-5) and opacity(fixed, 15) == pytest.approx(0.5, abs=1e-5)
    chosen(fixed, obj)
    bpy.ops.fastgs.cross_fade(start=50, frames=10)  # and back, beside the keys from before
    assert opacity(fixed, 55) == pytest.approx(0.5, abs=1e-5) and opacity(obj, 60) == pytest.approx(0.8, abs=1e-5)
    assert opacity(obj, 25) == pytest.approx(0.4, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("fps", "start", "speed"), [(25, 1, 1.0), (30, 11, 0.5)])
def test_a_loop_repeats_in_the_scene(fg, scene, model_file, module, fps, start, speed):
    """The object shows the same after each round, at any frame rate and speed."""
    bpy.ops.import_scene.fastgs(filepath=model_file(swinging(fg, 20, axes="RFU")))
    obj, scene.render.fps = bpy.context.object, fps
    obj.fastgs.start_frame, obj.fastgs.speed = start, speed
    assert bpy.ops.fastgs.make_loop(least=12, fade=4, propose=True) == {'FINISHED'} and obj.fastgs.after == 'HOLD'
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.fastgs.make_loop(least=12, fade=4) == {'FINISHED'}
    settings = obj.fastgs
    assert (settings.before, settings.after, settings.fade) == ('LOOP', 'LOOP', 4)
    assert 60 - settings.trim_start - settings.trim_end == pytest.approx(24, abs=0.2)
    snapshot = module("scene.snapshot")
    period = 20 * fps / 25 / speed

    def shown(frame):
        whole = int(np.floor(frame))
        scene.frame_set(whole, subframe=frame - whole)
        return [(i.t, i.settings.opacity) for i in snapshot.take(bpy.context.evaluated_depsgraph_get()).load()[0]]

    for frame in (start + 8 * fps / 25 / speed, start + 13.5 * fps / 25 / speed, start + period + 2 * fps / 25 / speed):
        assert np.array(shown(frame + period)) == pytest.approx(np.array(shown(frame)), abs=0.004)
    assert sum(share for _, share in shown(start + period + 2 * fps / 25 / speed)) == pytest.approx(1, abs=0.01)
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert bpy.data.objects[0].fastgs.after == 'HOLD'


def test_a_clip_that_loops_by_itself_is_left_whole(fg, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(swinging(fg, 60)))
    assert bpy.ops.fastgs.make_loop(fade=4) == {'FINISHED'}
    settings = bpy.context.object.fastgs
    assert (settings.trim_start, settings.trim_end, settings.fade, settings.after) == (0, 0, 0, 'LOOP')


def test_parts_of_a_capture_loop_together(fg, model_file, module):
    """A part that plays as the other does; one whose start is another, and one whose trim is keyed, are left and named."""
    bpy.ops.import_scene.fastgs(filepath=model_file(swinging(fg, 20)))
    obj, selection, made = bpy.context.object, module("scene.selection"), []
    for k, name in enumerate(("Same", "Later", "Keyed")):
        selection.select(obj, np.arange(120) % 4 == k)
        bpy.ops.fastgs.separate(name=name)
        made.append(bpy.context.object)
        bpy.context.view_layer.objects.active = obj
    made[1].fastgs.start_frame = 7
    made[2].keyframe_insert("fastgs.trim_end", frame=1)
    assert bpy.ops.fastgs.make_loop(least=12, fade=4) == {'FINISHED'}
    times = [(each.fastgs.trim_start, each.fastgs.trim_end, each.fastgs.fade, each.fastgs.after) for each in (obj, *made)]
    assert times[0] == times[1] and times[0][2:] == (4, 'LOOP')
    assert times[2][3] == times[3][3] == 'HOLD'


def test_what_all_parts_show_is_looped(fg, model_file, module):
    """A part that stands still is active; the seam is looked for by what moves in the other."""
    model = swinging(fg, 20)
    bpy.ops.import_scene.fastgs(filepath=model_file(replace(model, motion=model.motion * (np.arange(120) % 2)[:, None, None])))
    obj = bpy.context.object
    module("scene.selection").select(obj, np.arange(120) % 2 == 0)
    bpy.ops.fastgs.separate(name="Still")
    assert bpy.ops.fastgs.make_loop(least=12, fade=4) == {'FINISHED'}
    length = 60 - obj.fastgs.trim_start - obj.fastgs.trim_end - obj.fastgs.fade
    assert length == pytest.approx(20, abs=0.2) and bpy.context.object.name == "Still"


def test_a_still_and_animated_trims_have_no_loop(fg, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(part(fg, 0, -1, 1)))
    assert not bpy.ops.fastgs.make_loop.poll()
    bpy.ops.import_scene.fastgs(filepath=model_file(swinging(fg, 20), "moves.safetensors"))
    bpy.context.object.keyframe_insert("fastgs.trim_start", frame=1)
    with pytest.raises(RuntimeError, match="animated"):
        bpy.ops.fastgs.make_loop()


def test_a_click_finds_the_surface_of_one_object(fg, two, module, scene):
    """Whatever lies before it: the two captures may lie in each other."""
    obj, fixed = two(part(fg, 0, -3, 3, axes="RFU"), part(fg, 0, -3, 3, axes="RFU"))
    fixed.location.z = 2.0
    bpy.context.view_layer.update()
    picked = module("operators.align_pairs").picked
    view = Matrix.Translation((0, 0, -10))  # from above
    near, far = 0.1, 100.0
    window = Matrix(((2, 0, 0, 0), (0, 2, 0, 0), (0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)), (0, 0, -1, 0)))

    class Region:
        width, height = 200, 200

    class View:
        view_matrix, window_matrix = view, window

    class Context:
        region, region_data = Region, View
        evaluated_depsgraph_get = staticmethod(bpy.context.evaluated_depsgraph_get)

    for each, lift in ((obj, 0.0), (fixed, 2.0)):
        found = np.array([p for p in (picked(Context, each, x, y) for x in (60, 100, 140) for y in (80, 120)) if p is not None])
        assert len(found) > 3 and (found[:, 2] > lift - 0.1).all() and (found[:, 2] < lift + 1.3).all()
        points = place(0)[0] + [0, 0, lift]
        assert max(np.linalg.norm(points - p, axis=1).min() for p in found) < 0.15
