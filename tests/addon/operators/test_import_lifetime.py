# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat objects after their import: undo, saving and loading, append and link, copies, reloading, fitting the scene."""
from pathlib import Path

import bpy
import numpy as np
import pytest


@pytest.fixture
def objects(module):
    return module("scene.objects")


@pytest.fixture
def imported(fg, make_model, model_file):
    """imported(n=40, name="model.safetensors", **fields): a fresh splat object of 20 frames at 24 fps."""

    def make(n=40, name="model.safetensors", **fields):
        path = model_file(make_model(n, **(dict(clip=fg.Clip(20, 24)) | fields)), name)
        bpy.ops.import_scene.fastgs(filepath=path)
        return bpy.context.object

    return make


def shown(objects, obj):
    """How many Gaussians an object would render."""
    return len(objects.load_model(objects.abspath(obj)))


def test_undo_and_redo_are_one_step(make_model, model_file, fg, scene):
    path = model_file(make_model(clip=fg.Clip(500, 60)))
    end = scene.frame_end
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.import_scene.fastgs('EXEC_DEFAULT', True, filepath=path, set_scene_range=True)
    bpy.ops.ed.undo()
    assert not bpy.data.objects and bpy.context.scene.frame_end == end
    bpy.ops.ed.redo()
    obj = bpy.data.objects["model"]
    assert (obj.fastgs.filepath, obj.fastgs.frame_count, bpy.context.scene.frame_end) == (path, 500, 500)
    assert len(obj.data.vertices) > 0


def test_save_and_load(imported, objects, tmp_path):
    obj = imported()
    obj.fastgs.speed, obj.fastgs.after, obj.fastgs.start_frame = -0.5, 'PING_PONG', 12.25
    obj.fastgs.keyframe_insert("offset", frame=3)
    points = len(obj.data.vertices)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    obj = bpy.data.objects["model"]
    assert (obj.fastgs.speed, obj.fastgs.after, obj.fastgs.start_frame) == (-0.5, 'PING_PONG', 12.25)
    assert obj.animation_data.action is not None
    assert len(obj.data.vertices) == points and obj.data.color_attributes.active_color.name == "Color"
    assert shown(objects, obj) == 40


@pytest.mark.parametrize("copy", [False, True])
def test_saving_elsewhere_keeps_relative_paths_right(imported, objects, tmp_path, copy):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    obj = imported()
    assert obj.fastgs.filepath == "//model.safetensors"
    (tmp_path / "deep" / "er").mkdir(parents=True)
    elsewhere = str(tmp_path / "deep" / "er" / "y.blend")
    bpy.ops.wm.save_as_mainfile(filepath=elsewhere, copy=copy)
    assert shown(objects, obj) == 40
    assert obj.fastgs.filepath.replace("\\", "/") == ("//model.safetensors" if copy else "//../../model.safetensors")
    bpy.ops.wm.open_mainfile(filepath=elsewhere)
    assert shown(objects, bpy.data.objects["model"]) == 40


def test_the_first_save_makes_paths_relative(imported, objects, tmp_path):
    """As it does for images, and where the preference says so."""
    obj = imported()
    assert obj.fastgs.filepath == str(tmp_path / "model.safetensors")
    (tmp_path / "scenes").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scenes" / "x.blend"))
    assert obj.fastgs.filepath.replace("\\", "/") == "//../model.safetensors" and shown(objects, obj) == 40


def test_external_data_knows_splat_files(imported, objects, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    first, second = imported(), imported(n=30, name="other.safetensors")
    bpy.ops.file.make_paths_absolute()
    assert first.fastgs.filepath == str(tmp_path / "model.safetensors")
    bpy.ops.file.make_paths_relative()
    assert (first.fastgs.filepath, second.fastgs.filepath) == ("//model.safetensors", "//other.safetensors")
    (tmp_path / "moved").mkdir()
    (tmp_path / "model.safetensors").rename(tmp_path / "moved" / "model.safetensors")
    capfd.readouterr()
    bpy.ops.file.report_missing_files()
    told = capfd.readouterr().out
    assert "model.safetensors" in told and "other.safetensors" not in told
    bpy.ops.file.find_missing_files(directory=str(tmp_path))
    assert first.fastgs.filepath.replace("\\", "/") == "//moved/model.safetensors"
    assert (shown(objects, first), shown(objects, second)) == (40, 30)


def test_one_datablock_holds_the_path_of_a_file(imported, objects):
    first = imported()
    bpy.ops.object.duplicate()
    second = imported()
    assert first.fastgs.file == second.fastgs.file and len(bpy.data.cache_files) == 1
    imported(n=30, name="other.safetensors")
    second.fastgs.filepath = bpy.context.object.fastgs.filepath
    assert (shown(objects, first), shown(objects, second)) == (40, 30) and len(bpy.data.cache_files) == 2
    bpy.context.object.fastgs.filepath = second.fastgs.filepath = ""
    assert not objects.is_splat(second) and len(bpy.data.cache_files) == 1


def test_a_failed_save_changes_no_path(imported, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    obj = imported()
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "no" / "such" / "folder" / "y.blend"))
    assert obj.fastgs.filepath == "//model.safetensors"


@pytest.fixture
def library(imported, tmp_path):
    """A .blend in another folder than the open one, which has an object named model with a relative path."""
    (tmp_path / "library").mkdir()
    path = str(tmp_path / "library" / "x.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    imported().fastgs.start_frame = 5
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return path


@pytest.mark.parametrize("saved", [False, True])
def test_append(library, objects, tmp_path, saved):
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here.blend"))
    bpy.ops.wm.append(directory=library + "/Object/", filename="model")
    obj = bpy.data.objects["model"]
    assert obj.library is None and obj.fastgs.start_frame == 5
    assert shown(objects, obj) == 40
    assert obj.fastgs.filepath.startswith("//") == saved
    assert obj.modifiers[0].node_group.library is None


def test_link_and_override(library, objects, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here.blend"))
    bpy.ops.wm.link(directory=library + "/Object/", filename="model")
    linked = next(obj for obj in bpy.data.objects if obj.library)
    assert shown(objects, linked) == 40 and objects.error_of(linked) is None
    own = linked.override_create(remap_local_usages=True)
    own.fastgs.start_frame = 33
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "here.blend"))
    own = next(obj for obj in bpy.data.objects if obj.override_library)
    assert own.fastgs.start_frame == 33 and shown(objects, own) == 40


def test_importing_beside_a_linked_object_needs_nothing_from_its_library(library, imported):
    bpy.ops.wm.link(directory=library + "/Object/", filename="model")
    obj = imported(name="mine.safetensors")
    assert obj.modifiers[0].node_group.library is None


@pytest.mark.parametrize("linked", [False, True])
def test_copies_have_their_own_time(imported, objects, linked):
    first = imported()
    bpy.ops.object.duplicate(linked=linked)
    second = bpy.context.object
    assert second != first and (second.data == first.data) == linked
    second.fastgs.start_frame, second.fastgs.speed = 50, 2
    assert (first.fastgs.start_frame, first.fastgs.speed) == (1, 1)
    assert shown(objects, second) == shown(objects, first) == 40


def test_reload_follows_the_file(imported, objects, fg, make_model, model_file, scene):
    obj = imported()
    old = obj.fastgs.file_hash
    model_file(make_model(70, clip=fg.Clip(31, 50)))
    obj.data.materials.append(bpy.data.materials.new("Mine"))
    assert bpy.ops.fastgs.reload() == {'FINISHED'}
    assert (obj.fastgs.gaussian_count, obj.fastgs.frame_count, obj.fastgs.fps) == (70, 31, 50)
    assert obj.fastgs.file_hash != old and 40 < len(obj.data.vertices) <= 76
    assert [m.name for m in obj.data.materials] == ["Mine"]
    assert {"Color", "radius"} <= set(obj.data.attributes.keys()) and "Color.001" not in obj.data.attributes


def test_reload_after_the_file_was_missing_and_broken(imported, objects):
    obj = imported()
    path = Path(obj.fastgs.filepath)
    content = path.read_bytes()
    points = len(obj.data.vertices)
    for damage in (path.unlink, lambda: path.write_bytes(content[:50])):
        damage()
        with pytest.raises(RuntimeError, match=path.name):
            bpy.ops.fastgs.reload()
        assert path.name in objects.error_of(obj)
        assert obj.fastgs.gaussian_count == 40 and len(obj.data.vertices) == points
    path.write_bytes(content)
    assert bpy.ops.fastgs.reload() == {'FINISHED'}
    assert objects.error_of(obj) is None


def test_another_file_for_a_linked_copy_leaves_the_first_alone(imported, make_model, model_file):
    first = imported()
    bpy.ops.object.duplicate(linked=True)
    second = bpy.context.object
    first.select_set(False)
    second.fastgs.filepath = model_file(make_model(90), "other.safetensors")
    bpy.ops.fastgs.reload()
    assert len(second.data.vertices) > 46 >= len(first.data.vertices)
    assert (first.fastgs.gaussian_count, second.fastgs.gaussian_count) == (40, 90)


def test_all_selected_objects_are_reloaded(imported, make_model, model_file):
    names = ["a.safetensors", "b.safetensors"]
    both = [imported(name=name) for name in names]
    for obj, name in zip(both, names, strict=True):
        model_file(make_model(55), name)
        obj.select_set(True)
    bpy.ops.fastgs.reload()
    assert [obj.fastgs.gaussian_count for obj in both] == [55, 55]


@pytest.mark.parametrize(("fps", "speed", "offset", "last"), [
    (29.97, 1, 0, 120), (23.976, -1, 0, 120), (60, 2, 0, 60), (25, 0.5, 0, 240), (24, 0, 0, 120), (30, 1, 20, 100), (30, 7, 0, 18),
    (30, 1, 500, 1),
    (30, -1, -20, 100)])
def test_fit_scene(imported, fg, scene, fps, speed, offset, last):
    obj = imported(clip=fg.Clip(120, fps))
    obj.fastgs.start_frame, obj.fastgs.speed, obj.fastgs.offset = 101, speed, offset
    bpy.ops.fastgs.fit_scene()
    assert scene.render.fps / scene.render.fps_base == pytest.approx(fps, rel=1e-6)
    assert (scene.frame_start, scene.frame_end) == (101, 100 + last)


def test_fit_scene_plays_the_whole_clip(imported, module, fg, scene):
    """The first and the last frame of the range are the clip's first and last."""
    obj = imported(clip=fg.Clip(48, 29.97))
    bpy.ops.fastgs.fit_scene()
    time, retime = module("scene.time"), module("scene.snapshot").retime_of(obj, scene.frame_start)
    rate = scene.render.fps / scene.render.fps_base
    ends = [time.clip_frame(f, rate, retime, fg.Clip(48, obj.fastgs.fps)) for f in (scene.frame_start, scene.frame_end)]
    assert np.allclose(ends, (0, 47), atol=1e-4)


def test_fit_scene_can_be_undone(imported, fg):
    imported(clip=fg.Clip(999, 12))
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.fastgs.fit_scene('EXEC_DEFAULT', True)
    assert bpy.context.scene.frame_end == 999
    bpy.ops.ed.undo()
    assert bpy.context.scene.frame_end == 250 and bpy.context.scene.render.fps == 24


def test_operators_wait_for_a_splat_object(scene):
    assert not bpy.ops.fastgs.reload.poll() and not bpy.ops.fastgs.fit_scene.poll()
    other = bpy.data.objects.new("Empty", None)
    scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = other
    assert not bpy.ops.fastgs.reload.poll() and not bpy.ops.fastgs.fit_scene.poll()
