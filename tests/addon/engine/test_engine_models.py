# SPDX-License-Identifier: GPL-3.0-or-later
"""Models in memory: each file is held once, as long as it is needed; and the paths of files."""
import os
import threading

import bpy
import numpy as np
import pytest
from mathutils import Vector


@pytest.fixture
def objects(module):
    objects = module("scene.objects")
    objects.clear()
    return objects


@pytest.fixture
def reads(fg, monkeypatch):
    """The paths that were read from disk."""
    reads = []
    monkeypatch.setattr(fg, "open_source", lambda path, load=fg.open_source: reads.append(str(path)) or load(path))
    return reads


def test_a_file_is_read_once_until_it_changes(objects, reads, make_model, model_file):
    path = model_file(make_model(5))
    first = objects.load_model(path)
    assert objects.load_model(os.path.join(os.path.dirname(path), ".", os.path.basename(path))) is first
    assert len(reads) == 1
    model_file(make_model(6))
    assert len(objects.load_model(path)) == 6
    assert len(reads) == 2
    objects.reload(path)
    assert len(objects.load_model(path)) == 6
    assert len(reads) == 3


@pytest.mark.parametrize("harm", ["truncated", "overwritten"])
def test_a_model_in_memory_survives_what_happens_to_its_file(objects, fg, make_model, model_file, harm):
    """A page of a mapped file that is cut off under Blender kills it with SIGBUS, unsaved work included."""
    made = make_model(20_000)
    path = model_file(made)
    model = objects.load_model(path)
    with open(path, "r+b") as file:
        if harm == "truncated":
            file.truncate(0)
        else:
            file.write(b"\xff" * os.path.getsize(path))
    for name, array in model.arrays.items():
        np.testing.assert_array_equal(array, made.arrays[name])
    with pytest.raises(fg.FastGSError, match="model.safetensors"):
        objects.load_model(path)


def test_threads_share_one_reading(objects, reads, make_model, model_file):
    path = model_file(make_model())
    models = []
    threads = [threading.Thread(target=lambda: models.append(objects.load_model(path))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(reads) == 1 and len({id(m) for m in models}) == 1 and len(models) == 8


def test_a_broken_file_is_read_once_and_remembered(objects, fg, reads, tmp_path, splat_object, make_model, model_file):
    path = str(tmp_path / "model.safetensors")
    with open(path, "wb") as file:
        file.write(b"nonsense")
    obj = splat_object(path)
    assert objects.error_of(obj) is None, "nobody has tried to read it"
    for _ in range(2):
        with pytest.raises(fg.FastGSError, match="model.safetensors"):
            objects.load_model(path)
    assert len(reads) == 1
    assert path in objects.error_of(obj)
    model_file(make_model())
    assert objects.error_of(obj) is None, "the file has changed since"
    objects.load_model(path)
    assert objects.error_of(obj) is None


def test_a_missing_file_is_seen_without_reading(objects, reads, splat_object):
    obj = splat_object("/nowhere/x.ply")
    assert os.path.abspath("/nowhere/x.ply") in objects.error_of(obj)
    obj.fastgs.filepath = ""
    assert objects.error_of(obj) is None
    assert not reads


def test_unused_models_are_freed(objects, make_model, model_file, splat_object, add_camera, render):
    keep, drop = (model_file(make_model(5, seed=i), f"{i}.safetensors") for i in range(2))
    splat_object(keep)
    obj = splat_object(drop)
    add_camera()
    render()
    one = objects.load_model(keep).nbytes
    assert objects.loaded_bytes() == 2 * one
    bpy.data.objects.remove(obj)
    render()
    assert objects.loaded_bytes() == one


def test_opening_a_file_frees_all_models(objects, make_model, model_file, tmp_path):
    objects.load_model(model_file(make_model()))
    assert objects.loaded_bytes()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not objects.loaded_bytes()


def test_disabling_frees_all_models(objects, addon, make_model, model_file):
    objects.load_model(model_file(make_model()))
    addon.unregister()
    try:
        assert not objects.loaded_bytes()
    finally:
        addon.register()


@pytest.fixture
def shot(tmp_path, make_model, fg):
    """A folder with a .blend that holds an object "Splats" with the path //cache/model.safetensors, and that file."""
    folder = tmp_path / "shot"
    (folder / "cache").mkdir(parents=True)
    model = folder / "cache" / "model.safetensors"
    fg.save(make_model(5), model)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
    obj = bpy.data.objects.new("Splats", bpy.data.meshes.new("Splats"))
    obj.fastgs.filepath = "//cache/model.safetensors"
    obj.fastgs.speed = -0.5
    bpy.context.scene.collection.objects.link(obj)
    bpy.ops.wm.save_mainfile()
    return folder


def test_relative_paths_and_settings_survive_saving(objects, shot):
    bpy.ops.wm.open_mainfile(filepath=str(shot / "shot.blend"))
    obj = bpy.data.objects["Splats"]
    assert objects.abspath(obj) == str(shot / "cache" / "model.safetensors")
    assert obj.fastgs.speed == -0.5 and objects.error_of(obj) is None


def test_a_linked_object_finds_its_file_beside_its_library(objects, shot, tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    with bpy.data.libraries.load(str(shot / "shot.blend"), link=True) as (_, wanted):
        wanted.objects = ["Splats"]
    assert objects.abspath(wanted.objects[0]) == str(shot / "cache" / "model.safetensors")


@pytest.mark.parametrize("relative", [True, False])
def test_a_library_override_too(objects, shot, tmp_path, relative):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    with bpy.data.libraries.load(str(shot / "shot.blend"), link=True, relative=relative) as (_, wanted):
        wanted.objects = ["Splats"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])  # Blender 5.3 overrides what is in the scene alone
    override = wanted.objects[0].override_create()
    bpy.context.scene.collection.objects.link(override)
    override.fastgs.speed = 3
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other.blend"))
    override = next(obj for obj in bpy.data.objects if obj.override_library)
    assert objects.abspath(override) == str(shot / "cache" / "model.safetensors")
    assert override.fastgs.speed == 3


def test_an_appended_object_keeps_its_file(objects, shot, tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    bpy.ops.wm.append(directory=str(shot / "shot.blend" / "Object"), filename="Splats")
    assert objects.abspath(bpy.data.objects["Splats"]) == str(shot / "cache" / "model.safetensors")


def test_saving_elsewhere_keeps_the_file(objects, shot, tmp_path):
    bpy.ops.wm.open_mainfile(filepath=str(shot / "shot.blend"))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "moved.blend"), relative_remap=True)
    assert objects.abspath(bpy.data.objects["Splats"]) == str(shot / "cache" / "model.safetensors")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved.blend"))
    assert objects.abspath(bpy.data.objects["Splats"]) == str(shot / "cache" / "model.safetensors")


@pytest.mark.parametrize("axes", ['RDF', 'RFU', 'RUB'])
def test_axes(objects, axes):
    """The letters say where the file's x, y and z point: right, forward, up and down are Blender's x, y, z and -z."""
    names = {'R': (1, 0, 0), 'F': (0, 1, 0), 'B': (0, -1, 0), 'U': (0, 0, 1), 'D': (0, 0, -1)}
    matrix = objects.axes_matrix(axes)
    for i, letter in enumerate(axes):
        axis = Vector(np.eye(3)[i])
        assert (matrix @ axis - Vector(names[letter])).length < 1e-7
    assert matrix.determinant() == pytest.approx(1)
