# SPDX-License-Identifier: GPL-3.0-or-later
"""A long clip in chapters as one object: F12, blur across a seam, viewport, and what needs one model."""
from dataclasses import replace

import bpy
import numpy as np
import pytest


@pytest.fixture
def model(fg, make_model):
    """Gaussians that move, come and go within 60 frames."""
    rng = np.random.default_rng(3)
    begin = rng.uniform(-0.1, 0.9, 80)
    window = np.stack([begin, begin + 0.2, *np.full((2, 80), -3.0)], -1)
    return replace(make_model(80, axes="RFU", clip=fg.Clip(60, 24.0)), basis=fg.Polynomial(1), motion=rng.normal(0, 0.5, (80, 1, 3)),
                   temporal_kind=fg.Window(), temporal=window, mu_tau=begin)


@pytest.fixture
def files(fg, model, tmp_path):
    """The same clip as a model and in chapters of ten frames."""
    fg.save(fg.chapters(model, frames=10), tmp_path / "long.safetensors")
    fg.save(fg.load(tmp_path / "long.safetensors"), tmp_path / "one.safetensors")
    return tmp_path


def imported(path):
    assert bpy.ops.import_scene.fastgs(filepath=str(path)) == {'FINISHED'}
    return bpy.context.object


def test_f12_is_that_of_the_whole_model(scene, module, files, add_camera, render):
    add_camera()
    scene.render.engine = 'FASTGS'
    shown = {}
    for name in ("long", "one"):
        obj = imported(files / f"{name}.safetensors")
        assert (obj.fastgs.frame_count, obj.fastgs.fps, obj.fastgs.gaussian_count) == (60, 24, 80)
        assert not module("scene.objects").is_sequence(obj) and module("scene.objects").error_of(obj) is None
        shown[name] = []
        for frame, subframe, blur in ((1, 0, False), (11, 0, True), (10, 0.7, True), (35, 0.5, False), (60, 0, False)):
            scene.render.use_motion_blur = blur
            scene.frame_set(frame, subframe=subframe)
            shown[name].append(render())
        bpy.data.objects.remove(obj)
    for one, other in zip(*shown.values(), strict=True):
        for name, image in one.items():
            assert image.any() and np.abs(image - other[name]).max() < 1e-6, name


def test_a_viewport_asks_for_the_chapter_and_has_the_next(scene, module, files):
    snapshot = module("scene.snapshot")
    imported(files / "long.safetensors")
    source = module("scene.objects").load_model(str(files / "long.safetensors"))

    def taken(frame, forget=False, **options):
        scene.frame_set(frame)
        shown = snapshot.take(bpy.context.evaluated_depsgraph_get())
        ready()
        if forget:
            module("fastgs_blender.model.sequence").cache.forget(source._owner)
        return shown.load(**options)

    def ready():
        [task.result() for task in source._ahead if not task.cancelled()]

    assert "not read" in taken(25, forget=True, read=False)[1][0][1]
    first = taken(25)[0][0]
    source.moment(0.1), source.moment(24 / 60)
    ready()
    assert taken(30, read=False)[0][0].model is first.model
    after = taken(31, read=False)[0][0]
    assert after.model is not first.model and after.t == pytest.approx(0.5)


def test_what_needs_one_model_says_what_to_do(scene, module, fg, files):
    obj = imported(files / "long.safetensors")
    with pytest.raises(fg.FastGSError, match="fastgs convert"):
        module("scene.objects").load_one_model(obj, "selected")
