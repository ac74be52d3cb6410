# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Export > 4D Gaussians: what is written looks as the scene does, says what it loses, and touches nothing."""
import importlib.util
import sys
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest


@pytest.fixture
def exporter(module):
    """A stand-in for the operator whose properties can be set, for what it says before it writes."""
    parts = module("operators.exporting").Exporting, module("operators.export_splats").FASTGS_OT_export
    plain = {name: value for part in parts for name, value in vars(part).items()
             if not name.startswith("bl_") and name != "__annotations__"}
    return type("Exporter", (), plain | {"content": 'FRAME', "static_format": 'PLY', "moving_format": 'OWN', "selected": False})


def differences(a, b):
    """The largest difference of two renders, and the mean."""
    wrong = np.concatenate([np.abs(a[name] - b[name]).ravel() for name in a])
    return float(wrong.max()), float(wrong.mean())


def test_a_frame_looks_as_the_scene_does(scene, fg, module, make_model, model_file, add_camera, render, tmp_path):
    """Two objects: one turned, stretched, cropped and coloured, one that moves."""
    scene.render.engine = 'FASTGS'
    add_camera()
    rng = np.random.default_rng(0)
    still = make_model(50, axes="RDF", spread=0.7)
    moving = make_model(40, seed=1, spread=0.6, axes="RFU", basis=fg.Polynomial(1), motion=rng.normal(0, 0.5, (40, 1, 3)),
                        temporal_kind=fg.Radial(), temporal=np.full((40, 1), 1.0), mu_tau=rng.random(40), clip=fg.Clip(20, 24.0))
    for model, name in ((still, "still.safetensors"), (moving, "moving.safetensors")):
        bpy.ops.import_scene.fastgs(filepath=model_file(model, name))
    one, two = bpy.data.objects["still"], bpy.data.objects["moving"]
    one.location, one.rotation_euler, one.scale = (0.3, 0.1, -0.2), (0.4, 0.5, 0.6), (1.2, 0.6, 0.9)
    one.fastgs.exposure, one.fastgs.opacity, one.fastgs.splat_scale = 0.5, 0.8, 0.9
    two.scale = (0.8, 0.8, 0.8)
    with bpy.context.temp_override(object=two, active_object=two, selected_objects=[two]):
        bpy.ops.fastgs.add_crop_box()
    two.fastgs.crops[0].object.scale.x *= 0.6
    scene.frame_set(9)
    before = render()
    target = str(tmp_path / "out.ply")
    assert bpy.ops.export_scene.fastgs(filepath=target) == {'FINISHED'}
    model = fg.load(target)
    assert 50 < len(model) < 90 and not model.basis.terms
    for obj in (one, two):
        bpy.data.objects.remove(obj)
    bpy.ops.import_scene.fastgs(filepath=target)
    largest, mean = differences(before, render())
    assert largest < 0.02 and mean < 1e-3, (largest, mean)


def test_ranges_selections_and_the_scenes_frame(scene, fg, make_model, model_file, tmp_path):
    moving = make_model(20, basis=fg.Polynomial(1), motion=np.ones((20, 1, 3)), clip=fg.Clip(10, 24.0), axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(moving, "moving.safetensors"))
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(7), "still.ply"))  # it alone is selected
    scene.frame_set(5)
    bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "still.spz"), static_format='SPZ', selected=True)
    assert len(fg.load(tmp_path / "still.spz")) == 7
    bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "take.ply"), content='RANGE', frame_start=2, frame_end=4)
    assert scene.frame_current == 5
    sequence = fg.open_source(tmp_path / "take_####.ply")
    assert sequence.clip.frame_count == 3 and len(sequence) == 27
    first, last = (sequence.moment(f / 3)[0].position[:, 0].sum() for f in (0, 2))
    assert last - first == pytest.approx(20 * 2 / 10, rel=1e-4)


@pytest.mark.slow
def test_the_whole_model(fg, make_model, model_file, tmp_path):
    model = make_model(30, basis=fg.Polynomial(3), motion=np.ones((30, 3, 3)), axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    for kind, name in (('OWN', "a.safetensors"), ('COMPRESSED', "b.safetensors"), ('STG', "c.ply"), ('SPLATV', "d.splatv")):
        bpy.ops.export_scene.fastgs(filepath=str(tmp_path / name), content='MODEL', moving_format=kind)
        again = fg.load(tmp_path / name)
        assert len(again) == 30 and again.basis.terms == 3
    assert np.array_equal(fg.load(tmp_path / "a.safetensors").position, model.position)


@pytest.mark.slow
def test_a_clip_in_chapters_stays_one(fg, exporter, make_model, tmp_path):
    model = make_model(20, basis=fg.Polynomial(1), motion=np.ones((20, 1, 3)), axes="RFU", clip=fg.Clip(20, 24.0))
    fg.save(fg.chapters(model, frames=10), tmp_path / "long.safetensors")
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "long.safetensors"))
    bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "again.safetensors"), content='MODEL')
    again = fg.open_source(tmp_path / "again.safetensors")
    assert len(again.chapters) == 2 and again.clip.frame_count == 20
    assert np.array_equal(again.moment(0.5)[0].position, model.position)
    asked = exporter()
    asked.content, asked.moving_format = 'MODEL', 'OWN'
    assert asked.losses(bpy.context) == []
    asked.moving_format = 'STG'
    with pytest.raises(fg.FastGSError, match="clip in chapters"):
        asked.losses(bpy.context)


@pytest.mark.slow
def test_compressing_shows_how_far_it_is_and_can_be_broken_off(module, exporter, make_model, model_file, monkeypatch, tmp_path):
    background = module("scene.background")
    monkeypatch.setattr(background, "WAIT", 0.002)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(60)))
    asked, target = exporter(), tmp_path / "out" / "small.safetensors"
    target.parent.mkdir()
    asked.content, asked.moving_format, asked._remarks = 'MODEL', 'COMPRESSED', []
    steps = asked.write(bpy.context, target)
    while next(steps)[0] == 0:
        pass
    steps.close()
    assert not any(target.parent.iterdir()) and not any(thread.name == background.NAME for thread in threading.enumerate())
    steps, shares = asked.write(bpy.context, target), []
    written = None
    while written is None:
        try:
            shares.append(next(steps)[0])
        except StopIteration as end:
            written = end.value
    assert written == "60 Gaussians" and target.is_file() and any("quantised" in text for text in asked._remarks)
    assert shares == sorted(shares) and len(set(shares)) > 10 and shares[-1] > 0.9


def test_what_is_lost_is_said_before_writing(fg, exporter, make_model, model_file):
    rng = np.random.default_rng(0)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(30, features=rng.normal(size=(30, 12)), appearance=fg.SH(1))))
    asked = exporter()
    assert asked.losses(bpy.context) == []
    asked.static_format = 'SPLAT'
    assert any("spherical harmonics" in clause for clause in asked.losses(bpy.context))
    asked.filepath = "/x/model.compressed.ply"
    assert asked.check(bpy.context) and asked.filepath == "/x/model.splat"
    assert not asked.check(bpy.context)
    asked.content, asked.moving_format = 'MODEL', 'SPLATV'
    assert any("view-dependent" in clause for clause in asked.losses(bpy.context))


def test_errors_are_sentences(scene, make_model, model_file, tmp_path):
    assert not bpy.ops.export_scene.fastgs.poll()
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model()))
    obj = bpy.context.object
    for options, text in (
            ({"filepath": str(tmp_path / "nowhere" / "a.ply")}, "folder"), ({"filepath": str(tmp_path / "a.xyz")}, "extension"),
            ({"filepath": str(tmp_path / "a.ply"), "content": 'RANGE', "frame_start": 3, "frame_end": 2}, "range")):
        with pytest.raises(RuntimeError, match=text):
            bpy.ops.export_scene.fastgs(**options)
    obj.fastgs.before = 'HIDE'
    obj.fastgs.start_frame = 100
    with pytest.raises(RuntimeError, match="(?i)nothing.*shown"):
        bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "a.ply"))
    assert not list(Path(tmp_path).glob("a.*"))


def test_a_range_as_time_samples(fg, make_model, model_file, tmp_path):
    if importlib.util.find_spec("pxr") is None:  # the bpy wheel keeps it in a folder of its own
        sys.path += [str(found.parent) for found in Path(bpy.utils.resource_path('LOCAL')).glob("python/lib/*/site-packages/pxr")]
    pytest.importorskip("pxr", reason="Blender 4.2 as a module does not bring Pixar's library along")
    moving = make_model(20, basis=fg.Polynomial(1), motion=np.ones((20, 1, 3)), clip=fg.Clip(10, 24.0), axes="RFU")
    bpy.ops.import_scene.fastgs(filepath=model_file(moving, "moving.safetensors"))
    bpy.ops.export_scene.fastgs(filepath=str(tmp_path / "take.usdc"), content='RANGE', static_format='USD', frame_start=1, frame_end=3)
    source = fg.open_source(tmp_path / "take.usdc")
    assert source.clip.frame_count == 3 and source.clip.fps == pytest.approx(24)


class Attribute:
    """A point cloud's attribute: its values, as foreach_get() hands them over."""

    def __init__(self, values):
        self.data, self.values = self, np.asarray(values, np.float32)

    def __len__(self):
        return len(self.values)

    def foreach_get(self, key, out):
        assert out.dtype == np.float32 and key == ("value" if self.values is not None and self.quaternion else "vector")
        out[:] = self.values.ravel()

    quaternion = False


def test_native_splats_are_read_from_their_attributes(module, fg, make_model):
    """As Blender 5.3 stores them; the wheels of the tests have none of these point clouds."""
    native = module("operators.export_native")
    model = make_model(20, features=np.random.default_rng(0).normal(size=(20, 12)), appearance=fg.SH(1))
    opacity = 1 / (1 + np.exp(-model.opacity))
    attributes = {"position": Attribute(model.position), "scale": Attribute(np.exp(model.scale)), "rotation": Attribute(model.rotation),
                  "radiance:base": Attribute(np.c_[model.features[:, :3], opacity])}
    attributes |= {f"radiance:sh_{k}": Attribute(model.features[:, 3 + 3 * k:6 + 3 * k]) for k in range(3)}
    attributes["rotation"].quaternion = True
    again = native.model_of(attributes)
    for name in ("position", "rotation", "scale", "opacity", "features"):
        assert np.allclose(getattr(again, name), getattr(model, name), atol=1e-5), name
    del attributes["radiance:sh_2"]
    with pytest.raises(fg.FastGSError, match="2 coefficients"):
        native.model_of(attributes)


def test_native_splats_need_a_point_cloud_of_splats(scene):
    assert not bpy.ops.fastgs.export_native.poll()
    cloud = bpy.data.objects.new("Points", bpy.data.pointclouds.new("Points"))
    scene.collection.objects.link(cloud)
    bpy.context.view_layer.objects.active = cloud
    assert not bpy.ops.fastgs.export_native.poll()
