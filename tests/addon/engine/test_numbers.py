# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers at the ends of their ranges, beyond these, and such as are no numbers: a picture, or the one object is left out and named."""
import contextlib
import math

import bpy
import numpy as np
import pytest

FAR = (math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e30, 0.0)


@pytest.fixture
def two(make_model, model_file, splat_object, add_camera, scene, render, fg):
    """An object before a camera, and the picture of another one alone."""
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    add_camera()
    splat_object(model_file(make_model(30)), "Good")
    alone = render()["ViewLayer.Combined"]
    return splat_object(model_file(make_model(30, seed=1, clip=fg.Clip(10, 24.0)), "bad.safetensors"), "Bad"), alone


def values_of(group):
    """Yields (name, value) for all numbers of a group, each with the ends of its range and what lies beyond; the numbers stay as they
    were."""
    for prop in group.bl_rna.properties:
        if prop.type != 'FLOAT' or prop.is_readonly:
            continue
        before = getattr(group, prop.identifier)
        before = tuple(before) if prop.is_array else before
        for value in (prop.hard_min, prop.hard_max, *FAR):
            setattr(group, prop.identifier, [value] * prop.array_length if prop.is_array else value)
            yield prop.identifier, value
        setattr(group, prop.identifier, before)


def left_out(picture, alone, caplog, what) -> bool:
    """Whether the object is left out, which one sentence says and the picture of the other one shows; else nothing is said."""
    lines = [record.getMessage() for record in caplog.records]
    caplog.clear()
    assert np.isfinite(picture).all(), what
    if lines:
        assert len(lines) == 1 and lines[0].startswith("Bad is left out: ") and lines[0].endswith("."), (what, lines)
        np.testing.assert_array_equal(picture, alone, str(what))
    return bool(lines)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["object", "crops", "filters"])
def test_no_number_of_an_object_harms_another_one(two, render, caplog, group):
    bad, alone = two
    settings = bad.fastgs if group == "object" else getattr(bad.fastgs, group).add()
    if group == "crops":
        settings.object = bpy.data.objects.new("Box", None)
    for name, value in values_of(settings):
        told = left_out(render()["ViewLayer.Combined"], alone, caplog, (name, value))
        unused = name in ("capture_frame", "still_frame", "fps", "viewport_density")
        assert told == (math.isnan(value) and not unused), (name, value)


def test_looks_of_an_object_that_instances_splats_leave_out_its_instances(two, render, scene, caplog):
    bad, alone = two
    collection, empty = bpy.data.collections.new("Instanced"), bpy.data.objects.new("Instance", None)
    scene.collection.objects.unlink(bad)
    collection.objects.link(bad)
    empty.instance_type, empty.instance_collection = 'COLLECTION', collection
    scene.collection.objects.link(empty)
    assert not left_out(render()["ViewLayer.Combined"], alone, caplog, "as it is")
    empty.fastgs.gamma = math.nan
    assert left_out(render()["ViewLayer.Combined"], alone, caplog, "gamma")


@pytest.mark.parametrize("broken", [math.nan, math.inf, 3e38])
def test_a_crop_mesh_with_a_vertex_that_is_no_number(two, render, caplog, add, broken):
    bad, alone = two
    cube = add("cube", size=2)
    cube.hide_render = True
    crop = bad.fastgs.crops.add()
    crop.object, crop.shape = cube, 'MESH'
    assert not left_out(render()["ViewLayer.Combined"], alone, caplog, "as it is")
    cube.data.vertices[0].co.x = broken
    cube.data.update()
    assert left_out(render()["ViewLayer.Combined"], alone, caplog, broken)


@pytest.mark.slow
def test_proxies_and_copies_follow_although_a_number_is_none(two, scene, capfd):
    """Handlers that read the same settings raise nothing; the panel says that nothing is shown."""
    bad, _ = two
    bpy.ops.import_scene.fastgs(filepath=bad.fastgs.filepath)
    shown = bpy.context.object
    bpy.ops.fastgs.native_copy()
    for points in ('SOME', 'ALL'):
        shown.fastgs.points = points
        for name, value in values_of(shown.fastgs):
            scene.frame_set(scene.frame_current + 1)
            bpy.context.view_layer.update()
            assert "Traceback" not in (found := capfd.readouterr().err), (name, value, found)


@pytest.mark.slow
@pytest.mark.parametrize(("owner", "names"), [
    (lambda scene: scene.render, ("motion_blur_shutter", "pixel_aspect_x", "border_max_x")),
    (lambda scene: scene.camera.data, ("lens", "sensor_width", "shift_x", "clip_start", "clip_end")),
    (lambda scene: scene.camera.data.dof, ("focus_distance", "aperture_fstop", "aperture_ratio", "aperture_rotation")),
    (lambda scene: scene.fastgs, ("shadow_bias",))])
def test_numbers_of_the_scene_are_a_picture_or_one_sentence(two, render, scene, caplog, owner, names):
    group = owner(scene)
    scene.render.use_motion_blur = scene.camera.data.dof.use_dof = True
    scene.fastgs.blur_steps = scene.fastgs.lens_samples = 2
    for name in names:
        prop, before = group.bl_rna.properties[name], getattr(group, name)
        for value in (prop.hard_min, prop.hard_max, *FAR):
            setattr(group, name, value)
            with contextlib.suppress(RuntimeError):  # a sentence
                assert np.isfinite(render()["ViewLayer.Combined"]).all(), (name, value)
        setattr(group, name, before)
    assert "Traceback" not in caplog.text


def test_a_shutter_that_is_open_for_too_long_is_named(two, render, scene):
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1e30
    with pytest.raises(RuntimeError, match="shutter"):
        render()
