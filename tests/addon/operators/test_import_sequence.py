# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences of files as one object: import by folder, name and selection; F12 of a frame is the file of that frame; panels; viewport."""
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

FRAMES = 4


@pytest.fixture
def folder(fg, make_model, tmp_path):
    """Numbered PLY files, each of a cloud that has moved."""
    (tmp_path / "frames").mkdir()
    cloud = make_model(60, features=np.random.default_rng(0).normal(size=(60, 12)), appearance=fg.SH(1), axes="RFU")
    for i in range(FRAMES):
        fg.save(replace(cloud, position=cloud.position + np.float32([0.3 * i, 0, 0])), tmp_path / "frames" / f"take_{i + 1:03d}.ply")
    return tmp_path / "frames"


@pytest.fixture
def sequence(folder):
    """The folder imported."""
    assert bpy.ops.import_scene.fastgs(filepath=str(folder)) == {'FINISHED'}
    return bpy.context.object


def test_a_folder_is_one_object(scene, module, folder, sequence):
    settings = sequence.fastgs
    assert (sequence.name, settings.gaussian_count, settings.frame_count, settings.fps) == ("frames", 60, FRAMES, 0)
    facts = module("ui.facts")
    assert dict(facts.object_facts(sequence))["Frames"] .startswith(f"{FRAMES} ")
    scene.frame_set(3)
    scene.render.fps = 60
    assert facts.shown_now(sequence, scene) == "Frame 2 (of 0 to 3)"
    assert module("scene.objects").error_of(sequence) is None
    rate = scene.render.fps
    bpy.ops.fastgs.fit_scene()
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (1, FRAMES, rate)
    points = np.array([v.co for v in sequence.data.vertices])
    assert np.ptp(points[:, 0]) > 0.3 * (FRAMES - 1), "the proxy reaches over all frames"


def test_selected_files_and_dropped_ones(folder, module):
    names = [f"take_{i + 1:03d}.ply" for i in range(FRAMES)]

    def imported(chosen, **options):
        for obj in list(bpy.data.objects):
            bpy.data.objects.remove(obj)
        bpy.ops.import_scene.fastgs(directory=str(folder), files=[{"name": name} for name in chosen], **options)
        return sorted((Path(obj.fastgs.filepath).name, obj.fastgs.frame_count) for obj in bpy.data.objects if obj.type != 'CAMERA')

    assert imported(names) == [("take_####.ply", FRAMES)]
    assert imported(names[1:3]) == [("take_[002-003].ply", 2)]
    assert imported(names[:2], as_sequence=False) == [(name, 1) for name in names[:2]]
    assert {".zip", ".gsd"} <= set(bpy.types.FASTGS_FH_import.bl_file_extensions.split(";"))


def test_a_folder_for_each_frame_and_one_of_sog(scene, module, fg, folder, tmp_path):
    """Both are chosen as folders; the second is one model."""
    for i in range(3):
        there = tmp_path / "run" / f"frame{i:04d}" / "point_cloud" / "iteration_7000"
        there.mkdir(parents=True)
        (folder / f"take_{i + 1:03d}.ply").rename(there / "point_cloud.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        fg.save(fg.load(folder / f"take_{FRAMES:03d}.ply"), tmp_path / "m.sog")
    with zipfile.ZipFile(tmp_path / "m.sog") as archive:
        archive.extractall(tmp_path / "sog")
    for name, frames in (("run", 3), ("sog", 1)):
        assert bpy.ops.import_scene.fastgs(filepath=str(tmp_path / name)) == {'FINISHED'}
        obj = bpy.context.object
        assert (obj.name, obj.fastgs.frame_count, obj.fastgs.gaussian_count) == (name, frames, 60)
        assert module("scene.objects").error_of(obj) is None


def test_f12_of_a_frame_is_the_file_of_that_frame(scene, folder, sequence, splat_object, add_camera, render):
    add_camera()
    scene.render.engine = 'FASTGS'
    shown = {}
    for frame in (1, 2, 4):
        scene.frame_set(frame)
        shown[frame] = render()
    scene.frame_set(2, subframe=0.5)
    between = render()
    sequence.fastgs.subframes = 'HOLD'
    held = render()
    sequence.fastgs.subframes = 'INTERPOLATE'
    sequence.fastgs.speed = -1.0
    scene.frame_set(1)
    backwards = render()
    bpy.data.objects.remove(sequence)
    for frame, images in shown.items():
        obj = splat_object(str(folder / f"take_{frame:03d}.ply"))
        for name, image in render().items():
            assert image.any() and np.array_equal(images[name], image), (frame, name)
        bpy.data.objects.remove(obj)
    assert same(backwards, shown[4])
    assert not any(same(between, other) for other in (*shown.values(), held))


def same(one, other):
    """Whether two renders are."""
    return all(np.array_equal(one[name], other[name]) for name in other)


def test_a_missing_frame_is_named(scene, module, folder, sequence, add_camera):
    add_camera()
    scene.render.engine = 'FASTGS'
    (folder / "take_002.ply").write_bytes(b"ply\nnonsense")
    scene.frame_set(2)
    with pytest.raises(RuntimeError, match=r"take_002\.ply"):
        bpy.ops.render.render()


def test_what_works_on_models_alone_says_so(module, fg, scene, sequence, tmp_path):
    with pytest.raises(fg.FastGSError, match="fastgs convert"):
        module("scene.cameras.tracking").region_track(scene, sequence, 1.0, np.array([1]), 0)
    with pytest.raises(fg.FastGSError, match="fastgs convert"):
        module("scene.selection").write_left(sequence, bpy.context.evaluated_depsgraph_get(), str(tmp_path / "left.safetensors"))


def test_the_panel_offers_sub_frames_to_sequences_only(sequence, module, make_model, model_file):
    objects = module("scene.objects")
    assert objects.is_sequence(sequence)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model()))
    assert not objects.is_sequence(bpy.context.object)


def test_a_viewport_draws_what_it_has_and_asks_for_the_frame(scene, module, sequence):
    """Drawing never reads a file: that is the thread's."""
    snapshot = module("scene.snapshot")
    scene.frame_set(3)
    taken = snapshot.take(bpy.context.evaluated_depsgraph_get())
    reads = module("fastgs_blender.model.sequence")
    reads.cache.forget(module("scene.objects").load_model(sequence.fastgs.filepath)._owner)
    loaded, left_out = taken.load(read=False)
    assert not loaded and "not read" in left_out[0][1]
    loaded, left_out = taken.load()
    again, _ = taken.load(read=False)
    assert not left_out and again[0].model is loaded[0].model


@pytest.mark.parametrize("whole_folder", [False, True])
def test_external_data_knows_sequences(module, folder, scene, tmp_path, capfd, whole_folder):
    """Reported where the files are gone, found where they have gone to, relative with the first save: as for one file."""
    objects, home = module("scene.objects"), tmp_path / "scenes"
    home.mkdir()
    bpy.ops.import_scene.fastgs(filepath=str(folder if whole_folder else folder / "take_###.ply"))
    obj = bpy.context.object
    bpy.ops.wm.save_as_mainfile(filepath=str(home / "x.blend"))
    name = folder.name if whole_folder else f"{folder.name}/take_###.ply"
    assert obj.fastgs.filepath.replace("\\", "/") == f"//../{name}"
    capfd.readouterr()
    bpy.ops.file.report_missing_files()
    assert "take_" not in capfd.readouterr().out
    (tmp_path / "moved").mkdir()
    folder.rename(tmp_path / "moved" / folder.name)
    bpy.ops.file.report_missing_files()
    assert "take_001.ply" in capfd.readouterr().out
    bpy.ops.file.find_missing_files(directory=str(tmp_path))
    assert obj.fastgs.filepath == f"//../moved/{name}" and len(objects.load_model(objects.abspath(obj))) > 0
    bpy.ops.wm.open_mainfile(filepath=str(home / "x.blend"))
