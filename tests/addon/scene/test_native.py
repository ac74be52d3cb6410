# SPDX-License-Identifier: GPL-3.0-or-later
"""Native copies: objects for other engines that hold what a splat object shows on each frame and sub-frame, and that no file holds."""
from __future__ import annotations

import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest

POINTS = "resize" in bpy.types.PointCloud.bl_rna.functions
KINDS = ['DISCS'] + ['POINTS'] * POINTS


@pytest.fixture
def moving(fg, make_model, model_file):
    """The file of a model that moves, with spherical harmonics; a third of it lives in the clip's second half alone."""
    n, rng = 60, np.random.default_rng(8)
    windows = np.tile([-1.0, 2.0, -6.0, -6.0], (n, 1))
    windows[::3, 0] = 0.5
    return model_file(make_model(n, basis=fg.Fourier(2), motion=rng.normal(size=(n, 4, 3)) * 0.3, opacity=rng.uniform(1, 5, n),
                                 clip=fg.Clip(60, 24), temporal_kind=fg.Window(), temporal=windows, appearance=fg.SH(1),
                                 features=rng.normal(0, 0.3, (n, 12))))


@pytest.fixture
def splat(moving, scene):
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj = bpy.context.object
    obj.location, obj.rotation_euler, obj.scale = (1, 2, 3), (0.3, 0.2, 0.1), (1, 2, 1)
    scene.frame_end = 60
    return obj


def middles(obj, matrix=None):
    """The Gaussians' middles that a copy holds, in the world, sorted."""
    data = obj.data
    if obj.type == 'MESH':
        at = np.empty(3 * len(data.vertices), np.float32)
        data.vertices.foreach_get("co", at)
        at = at.reshape(-1, 6, 3).mean(1)
    else:
        at = np.empty(3 * len(data.points), np.float32)
        data.points.foreach_get("co", at)
        at = at.reshape(-1, 3)
    matrix = np.array(obj.matrix_world) if matrix is None else matrix
    return np.sort(at @ matrix[:3, :3].T + matrix[:3, 3], 0)


def truth(fg, path, frame, placement):
    model = fg.load(path)
    s = fg.slice_model(model, (frame - 1) / 60)
    return np.sort(s.position @ placement[:3, :3].T + placement[:3, 3], 0)


class _Reader(bpy.types.RenderEngine):
    """An engine that reads on sub-frames what Cycles would render of each copy."""

    bl_idname = "FASTGS_test_copies"
    bl_label = "Reader"
    seen: list = []

    def render(self, depsgraph):
        scene = depsgraph.scene
        for subframe in (0.0, 0.25):
            self.frame_set(scene.frame_current, subframe)
            for instance in depsgraph.object_instances:
                if instance.object.fastgs.copy_of is not None:
                    self.seen.append((scene.frame_current + subframe, middles(instance.object, np.array(instance.matrix_world))))
        self.end_result(self.begin_result(0, 0, 8, 8))


@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_follows_frames(scene, fg, module, splat, moving, kind, where):
    assert bpy.ops.fastgs.native_copy(kind=kind) == {'FINISHED'}
    copy, = (obj for obj in scene.objects if obj.fastgs.copy_of == splat)
    assert copy.parent == splat and not module("scene.splats.proxy_nodes").modifier_of(splat).show_render
    counts = set()
    for frame, part in ((1, 0.0), (40, 0.0), (20, 0.5)):
        scene.frame_set(frame, subframe=part)
        shown = copy.evaluated_get(bpy.context.evaluated_depsgraph_get())
        wanted = truth(fg, moving, frame + part, where()[splat.name])
        assert middles(shown) == pytest.approx(wanted, abs=1e-4)
        counts.add(len(wanted))
    assert len(counts) == 2, "what does not live on a frame is left out"
    splat.fastgs.opacity = 0.0
    bpy.context.view_layer.update()
    assert len(middles(copy.evaluated_get(bpy.context.evaluated_depsgraph_get()))) == 0
    splat.fastgs.opacity = 1.0
    bpy.context.view_layer.update()
    assert len(middles(copy.evaluated_get(bpy.context.evaluated_depsgraph_get()))) == len(wanted)
    assert bpy.ops.fastgs.native_copy(kind=kind) == {'FINISHED'} and sum(obj.fastgs.copy_of == splat for obj in scene.objects) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_final_renders_see_sub_frames(scene, fg, splat, moving, kind, where, add_camera):
    """The keyed capture frame counts as it is evaluated, of the frame that is rendered."""
    splat.fastgs.use_capture_frame = True
    for frame, value in ((1, 0.0), (11, 20.0)):
        splat.fastgs.capture_frame = value
        splat.keyframe_insert("fastgs.capture_frame", frame=frame)
    action = splat.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for key in curves[0].keyframe_points:
        key.interpolation = 'LINEAR'
    bpy.ops.fastgs.native_copy(kind=kind)
    add_camera()
    bpy.utils.register_class(_Reader)
    try:
        scene.render.engine = _Reader.bl_idname
        _Reader.seen.clear()
        scene.frame_start, scene.frame_end = 4, 5
        placement = where()[splat.name]
        scene.render.filepath = bpy.app.tempdir + "copy_"
        bpy.ops.render.render(animation=True)
        found = dict(_Reader.seen)
    finally:
        bpy.utils.unregister_class(_Reader)
    assert set(found) == {4.0, 4.25, 5.0, 5.25}
    for frame, places in found.items():
        assert places == pytest.approx(truth(fg, moving, 1 + 2 * (frame - 1), placement), abs=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_files_hold_nothing_of_it(scene, splat, kind, tmp_path):
    bpy.ops.fastgs.native_copy(kind=kind)
    name = next(obj.name for obj in scene.objects if obj.fastgs.copy_of == splat)
    before = middles(bpy.data.objects[name])
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, compress=False)
    assert len(middles(bpy.data.objects[name])) == len(before) > 0, "it is there again after saving"
    with bpy.data.libraries.load(str(shutil.copy(path, tmp_path / "other.blend"))) as (_, taken):
        taken.objects = [name]
    saved = taken.objects[0].data
    assert len(saved.vertices if kind == 'DISCS' else saved.points) == 0
    bpy.ops.wm.open_mainfile(filepath=path)
    bpy.context.view_layer.update()
    assert middles(bpy.data.objects[name]) == pytest.approx(before, abs=1e-5)


def test_a_copy_is_one_step_of_undo(scene, splat, module):
    name = splat.name
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.fastgs.native_copy(kind='DISCS')
    bpy.ops.ed.undo_push(message="Native Copy")
    scene.frame_set(40)
    bpy.ops.ed.undo_push(message="Change Frame")
    bpy.ops.ed.undo()  # the datablock is as it was on frame 1 again
    copy = next(obj for obj in bpy.context.scene.objects if obj.fastgs.copy_of is not None)
    bpy.context.scene.frame_set(20)
    shown = middles(copy.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    assert len(shown) == len(copy.data.polygons) > 0
    bpy.ops.ed.undo()
    assert not any(obj.fastgs.copy_of for obj in bpy.context.scene.objects)
    assert module("scene.splats.proxy_nodes").modifier_of(bpy.data.objects[name]).show_render


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("by", ["operator", "script"])
def test_a_copy_goes_with_its_splat_object(scene, splat, kind, by):
    bpy.ops.fastgs.native_copy(kind=kind)
    copy = next(obj for obj in scene.objects if obj.fastgs.copy_of == splat)
    name, data, plain = copy.name, copy.data.name, bpy.data.meshes.new("Plain")
    other = bpy.data.objects.new("Other", plain)
    scene.collection.objects.link(other)
    bpy.context.view_layer.update()
    if by == "operator":
        with bpy.context.temp_override(selected_objects=[splat], active_object=splat, object=splat):
            bpy.ops.object.delete()
    else:
        bpy.data.objects.remove(splat)
    bpy.context.view_layer.update()
    assert name not in bpy.data.objects and data not in {d.name for d in [*bpy.data.meshes, *bpy.data.pointclouds]}
    assert other.name in scene.objects and plain.name in bpy.data.meshes


def test_without_its_copy_an_objects_own_points_are_rendered_again(scene, splat, module):
    modifier_of = module("scene.splats.proxy_nodes").modifier_of
    bpy.ops.fastgs.native_copy(kind='DISCS')
    copy = next(obj for obj in scene.objects if obj.fastgs.copy_of == splat)
    bpy.context.view_layer.update()
    assert not modifier_of(splat).show_render
    with bpy.context.temp_override(selected_objects=[copy], active_object=copy, object=copy):
        bpy.ops.object.delete()
    bpy.context.view_layer.update()
    assert splat.name in scene.objects and modifier_of(splat).show_render


def test_discs_have_the_gaussians_colours_and_shapes(scene, fg, splat, moving):
    bpy.ops.fastgs.native_copy(kind='DISCS')
    mesh = next(obj.data for obj in scene.objects if obj.fastgs.copy_of == splat)
    model = fg.load(moving)
    s = fg.slice_model(model, 0.0)
    colour = np.empty(4 * len(mesh.vertices), np.float32)
    mesh.attributes["Color"].data.foreach_get("color", colour)
    wanted = np.clip(0.5 + 0.28209479 * s.features[:, :3], 0, 100)
    wanted = np.where(wanted <= 0.04045, wanted / 12.92, ((wanted + 0.055) / 1.055) ** 2.4)
    assert colour.reshape(-1, 6, 4)[:, 0, :3] == pytest.approx(wanted, abs=1e-4)
    normals = np.array([polygon.normal for polygon in mesh.polygons])
    areas = np.array([polygon.area for polygon in mesh.polygons])
    largest = np.sort(s.scale, 1)[:, 1:].prod(1) * s.opacity
    assert areas == pytest.approx(largest * 1.5**2 * 3 * np.sqrt(3) / 2, rel=1e-3)
    assert len(s.index) == len(mesh.polygons) and np.isfinite(normals).all() and mesh.materials[0].name == "FAST-GS Discs"


def test_blenders_own_splats_get_the_attributes_that_they_read(module, fg, moving):
    """Names, types and values as Blender 5.3 documents them; a point cloud of 5.2 takes all of them."""
    native = module("scene.splats.native")
    model = fg.freeze(fg.load(moving), 0.75)
    model = model.take(np.arange(20))
    found = {name: (kind, values) for name, kind, values in native.splat_attributes(model)}
    assert list(found) == ["rotation", "scale", "radiance:base", "radiance:sh_0", "radiance:sh_1", "radiance:sh_2"]
    assert np.linalg.norm(found["rotation"][1], axis=1) == pytest.approx(1)
    assert found["scale"][1] == pytest.approx(np.exp(model.scale))
    assert found["radiance:base"][1][:, 3] == pytest.approx(1 / (1 + np.exp(-model.opacity)))
    assert found["radiance:base"][1][:, :3] == pytest.approx(model.features[:, :3])
    assert found["radiance:sh_1"][1] == pytest.approx(model.features.reshape(20, 4, 3)[:, 2])
    if POINTS:
        cloud = bpy.data.pointclouds.new("Splats")
        native._write_points(cloud, model, True)
        for name, (kind, _) in found.items():
            assert cloud.attributes[name].domain == 'POINT' and cloud.attributes[name].data_type == kind
        again = module("operators.export_native").model_of(cloud.attributes)  # which reads what Blender's importer makes
        for name in ("position", "scale", "features", "opacity"):
            assert getattr(again, name) == pytest.approx(getattr(model, name), abs=1e-4), name
        native._write_points(cloud, replace(model.take(np.arange(3)), features=model.features[:3, :3], appearance=fg.SH(0)), True)
        assert len(cloud.points) == 3 and not any(a.name.startswith("radiance:sh_") for a in cloud.attributes)
