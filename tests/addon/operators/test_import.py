# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > 4D Gaussians: every kind of file, its options, and what becomes of a file that cannot be read."""
import bpy
import numpy as np
import pytest

COLLECTIONS = ("objects", "meshes", "materials", "node_groups", "texts", "images", "collections", "actions")


def inventory():
    """The names of all datablocks that an import could leave."""
    return {kind: sorted(x.name for x in getattr(bpy.data, kind)) for kind in COLLECTIONS}


def settings_of(scene):
    """What an import must not touch unasked."""
    return (scene.render.engine, scene.render.fps, scene.render.fps_base, scene.frame_start, scene.frame_end, scene.frame_current,
            scene.view_settings.view_transform, scene.render.film_transparent)


@pytest.fixture
def models(fg, make_model):
    """One model for each kind of file, of 30 Gaussians and 20 frames where the format moves."""
    rng = np.random.default_rng(3)
    moving = dict(
        basis=fg.Polynomial(3), motion=rng.normal(size=(30, fg.Polynomial(3).terms, 3)) * 0.1, rotation_basis=fg.Polynomial(1),
        rotation_motion=rng.normal(size=(30, 1, 4)), temporal_kind=fg.Radial(), temporal=np.zeros((30, 1)), mu_tau=rng.random(30))
    return {
        "ours.safetensors": make_model(
            30, basis=fg.Fourier(5), motion=rng.normal(size=(30, 10, 3)) * 0.1, clip=fg.Clip(20, 29.97), axes="RFU"),
        "inria.ply": make_model(30, features=rng.normal(size=(30, 12)), appearance=fg.SH(1)),
        "lite.ply": make_model(30, **moving),
        "full.ply": make_model(30, features=rng.normal(size=(30, 9)), appearance=fg.Features(), **moving),
        "viewer.splatv": make_model(30, **moving),
    }


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["ours.safetensors", "inria.ply", "lite.ply", "full.ply", "viewer.splatv"])
def test_every_kind_of_file(scene, fg, module, models, model_file, name):
    path = model_file(models[name], name)
    before = settings_of(scene)
    assert bpy.ops.import_scene.fastgs(filepath=path) == {'FINISHED'}
    read, obj = fg.load(path), bpy.context.object
    assert obj.select_get() and obj.name == name.split(".")[0] and obj.name in scene.objects
    assert (obj.fastgs.filepath, obj.fastgs.gaussian_count) == (path, 30)
    assert (obj.fastgs.frame_count, obj.fastgs.fps) == (read.clip.frame_count, pytest.approx(read.clip.fps))
    assert obj.fastgs.start_frame == scene.frame_start
    assert np.array_equal(obj.matrix_world, np.eye(4))
    assert np.array_equal(module("scene.model_space").placement(obj), module("scene.objects").axes_matrix(read.axes))
    assert 0 < len(obj.data.vertices) <= 30 + 6
    assert settings_of(scene) == before


def test_axes_of_every_convention_end_upright(make_model, model_file, module):
    placement = module("scene.model_space").placement
    up = {"RDF": (0, -1, 0), "RFU": (0, 0, 1), "RUB": (0, 1, 0)}
    for axes, direction in up.items():
        bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes=axes), f"{axes}.safetensors"))
        assert np.allclose(placement(bpy.context.object)[:3, :3] @ direction, (0, 0, 1), atol=1e-6)
        bpy.ops.import_scene.fastgs(filepath=model_file(make_model(axes=axes), f"{axes}.safetensors"), orientation='KEEP')
        assert np.array_equal(placement(bpy.context.object), np.eye(4))


def test_a_broken_file_leaves_nothing(make_model, model_file, tmp_path):
    broken = tmp_path / "broken.ply"
    model_file(make_model(), broken.name)
    broken.write_bytes(broken.read_bytes()[:-100])
    before = inventory()
    for path in (broken, tmp_path / "absent.splatv", tmp_path):
        with pytest.raises(RuntimeError) as error:
            bpy.ops.import_scene.fastgs(filepath=str(path))
        text = str(error.value).strip()
        assert path.name in text and "Traceback" not in text
        assert len(text.splitlines()) == 1
        assert inventory() == before


def test_no_file_at_all():
    with pytest.raises(RuntimeError, match="file.*chosen"):
        bpy.ops.import_scene.fastgs()


def test_several_files_and_one_of_them_broken(make_model, model_file, tmp_path):
    names = ["a.safetensors", "b.ply", "c.ply"]
    for name in names:
        model_file(make_model(), name)
    files = [{"name": name} for name in names]
    bpy.ops.import_scene.fastgs(directory=str(tmp_path), files=files)
    assert {obj.name for obj in bpy.context.selected_objects} == {"a", "b", "c"}
    assert len(bpy.data.node_groups) == 1 and len(bpy.data.materials) == 27

    (tmp_path / "b.ply").write_bytes(b"ply\nnonsense")
    with pytest.raises(RuntimeError, match=r"b\.ply"):
        bpy.ops.import_scene.fastgs(directory=str(tmp_path), files=files)
    assert {obj.name for obj in bpy.context.selected_objects} == {"a.001", "c.001"}


def test_readers_warnings_are_reported(fg, make_model, model_file, capfd):
    model = make_model(40)
    model.position[3] = np.nan
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    assert bpy.context.object.fastgs.gaussian_count == 39
    assert "Warning" in capfd.readouterr().out


def test_options_change_the_scene_only_when_asked(scene, fg, make_model, model_file):
    path = model_file(make_model(clip=fg.Clip(75, 29.97)))
    scene.render.engine = 'BLENDER_WORKBENCH'
    scene.frame_start = 11
    bpy.ops.import_scene.fastgs(filepath=path, set_scene_range=True)
    assert (scene.frame_start, scene.frame_end) == (11, 85)
    assert scene.render.fps / scene.render.fps_base == pytest.approx(29.97, abs=1e-5)
    assert scene.render.engine == 'BLENDER_WORKBENCH'
    bpy.ops.import_scene.fastgs(filepath=path, use_engine=True)
    assert scene.render.engine == 'FASTGS'


def test_relative_paths_once_the_blend_is_saved(module, make_model, model_file, tmp_path):
    path = model_file(make_model())
    (tmp_path / "scenes").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scenes" / "x.blend"))
    bpy.ops.import_scene.fastgs(filepath=path)
    assert bpy.context.object.fastgs.filepath.replace("\\", "/") == "//../model.safetensors"
    assert module("scene.objects").abspath(bpy.context.object) == path
    bpy.ops.import_scene.fastgs(filepath=path, relative_path=False)
    assert bpy.context.object.fastgs.filepath == path


def test_where_the_object_goes(scene, make_model, model_file):
    """Into the active collection, or the scene's where that one is hidden; never into the mesh that is being edited."""
    path = model_file(make_model())
    collection = bpy.data.collections.new("Splats")
    scene.collection.children.link(collection)
    layer = bpy.context.view_layer
    layer.active_layer_collection = layer.layer_collection.children["Splats"]
    bpy.ops.import_scene.fastgs(filepath=path)
    assert list(collection.objects) == [bpy.context.object]
    layer.layer_collection.children["Splats"].exclude = True
    bpy.ops.import_scene.fastgs(filepath=path)
    assert bpy.context.object.users_collection == (scene.collection,)

    mesh = bpy.data.objects.new("Edited", bpy.data.meshes.new("Edited"))
    scene.collection.objects.link(mesh)
    layer.objects.active = mesh
    bpy.ops.object.mode_set(mode='EDIT')
    bpy.ops.import_scene.fastgs(filepath=path)
    assert bpy.context.mode == 'OBJECT' and bpy.context.object != mesh and len(mesh.data.vertices) == 0


def test_menu_and_drop():
    handler = bpy.types.FASTGS_FH_import
    assert handler.bl_import_operator == "import_scene.fastgs"
    assert set(handler.bl_file_extensions.split(";")) >= {".safetensors", ".ply", ".splatv", ".splat"}
    for menu, entry in ((bpy.types.TOPBAR_MT_file_import, "draw_import"), (bpy.types.VIEW3D_MT_object, "draw_bake")):
        assert [f.__name__ for f in menu.draw._draw_funcs if "fastgs" in f.__module__] == [entry]


def test_an_imported_object_renders_like_one_made_by_hand(scene, make_model, model_file, splat_object, add_camera, render):
    """The proxy and its modifier are not part of the picture."""
    path = model_file(make_model(60, axes="RFU"))
    add_camera()
    scene.render.engine = 'FASTGS'
    bpy.ops.import_scene.fastgs(filepath=path)
    imported = render()
    bpy.data.objects.remove(bpy.context.object)
    splat_object(path)
    by_hand = render()
    assert imported.keys() == by_hand.keys()
    for name, image in by_hand.items():
        assert image.any() and np.array_equal(imported[name], image)
