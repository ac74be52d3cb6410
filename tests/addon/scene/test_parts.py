# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of splat objects: what they show together and alone, how they are made and joined, and what an object has that a part has too."""
from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest


@pytest.fixture
def whole(fg, make_model, model_file, add_camera, scene):
    """A cloud of 200 Gaussians in a clip of ten frames, before a camera."""
    rng = np.random.default_rng(5)
    model = make_model(200, seed=3, motion=rng.normal(0, 0.2, (200, 1, 3)), basis=fg.Polynomial(1), mu_tau=np.zeros(200),
                       clip=fg.Clip(10, 24.0), axes="RFU")
    add_camera(type='ORTHO', ortho_scale=4.0)
    scene.render.film_transparent = True
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    scene.frame_set(3)
    return bpy.context.object


@pytest.fixture
def choose(module):
    """choose(obj, bits [N]): select these Gaussians of an object."""
    selection = module("scene.selection")
    return lambda obj, bits: selection.select(obj, np.asarray(bits))


def test_parts_show_together_what_the_whole_showed(whole, choose, render, module):
    before, bits = render(), np.arange(200) % 3 == 0
    assert choose(whole, bits) == 67 and bpy.ops.fastgs.separate(name="Third") == {'FINISHED'}
    part = bpy.context.object
    assert (part.name, part.parent, part.fastgs.gaussian_count, whole.fastgs.gaussian_count) == ("Third", whole, 67, 133)
    assert not whole.fastgs.selection and not part.fastgs.selection
    after = render()
    for name, pixels in before.items():
        np.testing.assert_allclose(after[name], pixels, atol=2e-6, err_msg=name)
    whole.hide_render = True
    third = render()["ViewLayer.Combined"]
    assert 0 < third[..., 3].sum() < before["ViewLayer.Combined"][..., 3].sum()
    whole.hide_render = False
    for obj in (whole, part):
        obj.select_set(True)
    bpy.context.view_layer.objects.active = whole
    assert bpy.ops.fastgs.join_parts() == {'FINISHED'}
    assert whole.fastgs.part == "" and whole.fastgs.gaussian_count == 200 and "Third" not in bpy.data.objects
    np.testing.assert_allclose(render()["ViewLayer.Combined"], before["ViewLayer.Combined"], atol=2e-6)


def test_a_part_has_what_the_object_had_and_stands_still_in_it(whole, choose, where):
    """Its transform is identity under its parent, keys of the parent's place are not its own, and other keys are."""
    whole.location = (1, 2, 3)
    whole.fastgs.exposure = 1.5
    for path, value in (("location", (4, 5, 6)), ("fastgs.speed", 0.5)):
        whole.keyframe_insert(path, frame=1)
        (setattr(whole, path, value) if path == "location" else setattr(whole.fastgs, "speed", value))
        whole.keyframe_insert(path, frame=10)
    whole.constraints.new('LIMIT_LOCATION')
    choose(whole, np.arange(200) < 50)
    bpy.ops.fastgs.separate()
    part = bpy.context.object
    bpy.context.scene.frame_set(7)
    both = where()
    np.testing.assert_allclose(both[part.name], both[whole.name], atol=1e-6)
    assert part.fastgs.speed == whole.fastgs.speed != 1 and part.fastgs.exposure == 1.5 and not part.constraints
    part.location.x = 2
    bpy.context.view_layer.update()
    assert where()[part.name][0, 3] == pytest.approx(where()[whole.name][0, 3] + 2, abs=1e-5)


def test_what_cannot_be_a_part_is_said(whole, choose, make_model, model_file):
    choose(whole, np.ones(200, bool))
    with pytest.raises(RuntimeError, match="nothing.*select"):
        bpy.ops.fastgs.separate()
    whole.select_set(True)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(200, seed=9), "other.safetensors"))
    bpy.context.view_layer.objects.active = whole
    bpy.context.object.select_set(True)
    for obj in bpy.context.scene.objects:
        obj.select_set(obj.type == 'MESH')
    with pytest.raises(RuntimeError, match="another file"):
        bpy.ops.fastgs.join_parts()
    twin = whole.copy()
    bpy.context.scene.collection.objects.link(twin)
    for obj in bpy.context.scene.objects:
        obj.select_set(obj in (whole, twin))
    with pytest.raises(RuntimeError, match="same Gaussians"):
        bpy.ops.fastgs.join_parts()


def retrained(fg, model, seed=0):
    """A model of the same scene with other Gaussians: some gone, some split, in another order, a little elsewhere."""
    rng = np.random.default_rng(seed)
    index = rng.permutation(np.concatenate([np.flatnonzero(rng.random(len(model)) > 0.2), np.flatnonzero(rng.random(len(model)) > 0.7)]))
    out = model.take(index)
    return replace(out, position=out.position + rng.normal(0, 0.004, out.position.shape)), index


@pytest.mark.slow
@pytest.mark.parametrize("by_itself", [False, True], ids=["reload", "read again by itself before"])
def test_parts_survive_a_retrained_file(fg, make_model, model_file, module, choose, by_itself, capfd):
    """By place and colour: two clouds that touch, one red and one green; what was erased stays erased."""
    rng = np.random.default_rng(2)
    red = np.arange(600) % 2 == 0
    model = make_model(600, position=rng.uniform(-1, 1, (600, 3)) * (1, 0.3, 0.3) + np.where(red[:, None], (-0.8, 0, 0), (0.8, 0, 0)),
                       features=np.where(red[:, None], (0.8, 0.1, 0.1), (0.1, 0.8, 0.1)), axes="RFU")
    path = model_file(model)
    bpy.ops.import_scene.fastgs(filepath=path)
    whole, selection = bpy.context.object, module("scene.selection")
    choose(whole, red)
    bpy.ops.fastgs.separate(name="Red")
    part, erased = bpy.context.object, model.position[:, 0] < -1
    selection.erase(part, erased & red)
    new, index = retrained(fg, model)
    fg.save(new, path)
    if by_itself:
        module("scene.objects").load_model(path)
    assert bpy.ops.fastgs.reload() == {'FINISHED'}
    bits, gone = selection.bits(part, "part"), selection.bits(part, "mask")
    assert len(bits) == len(index) != 600
    assert (bits == red[index]).mean() > 0.99 and (gone == (erased & red)[index]).mean() > 0.98
    assert np.array_equal(selection.bits(whole, "part"), ~bits) and whole.fastgs.gaussian_count == (~bits).sum()
    assert part.fastgs.gaussian_count == bits.sum() and "lie where" not in capfd.readouterr().out


def test_another_scene_in_the_file_loses_nothing(whole, choose, fg, make_model, module):
    choose(whole, np.arange(200) < 50)
    bpy.ops.fastgs.separate()
    part, path = bpy.context.object, module("scene.objects").abspath(whole)
    before, first = part.fastgs.part, fg.load(path)
    fg.save(make_model(120, position=np.random.default_rng(1).uniform(20, 21, (120, 3)), axes="RFU"), path)
    with pytest.raises(RuntimeError, match="file.*120"):
        bpy.ops.fastgs.reload()
    assert part.fastgs.part == before
    fg.save(first, path)
    assert bpy.ops.fastgs.reload() == {'FINISHED'} and part.fastgs.gaussian_count == 50


def test_a_part_of_another_version_of_the_file_says_so(whole, choose, fg, make_model, render, module):
    """Where nothing is known of the earlier version; Show Whole File shows what there is."""
    choose(whole, np.arange(200) < 50)
    bpy.ops.fastgs.separate()
    part, path = bpy.context.object, module("scene.objects").abspath(whole)
    module("scene.objects").clear()
    fg.save(make_model(120, axes="RFU"), path)
    module("scene.objects").reload(path)
    assert not module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()[0]
    assert all(number in module("scene.objects").error_of(part) for number in ("200", "120"))
    assert bpy.ops.fastgs.show_whole() == {'FINISHED'} and part.fastgs.gaussian_count == 120
    assert len(module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()[0]) == 1
