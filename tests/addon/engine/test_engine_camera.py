# SPDX-License-Identifier: GPL-3.0-or-later
"""Every camera setting that moves pixels, against the reference renderer with a camera built from the formulas."""
import bpy
import by_hand
import image_files
import numpy as np
import pytest
from mathutils import Matrix

EYE, TARGET = (2.5, -4, 1.5), (0.2, 0, 0.1)


@pytest.fixture
def shot(scene, fg, make_model, model_file, splat_object, add_camera, render):
    """shot(by_hand.camera's arguments, **camera settings) renders, and compares alpha and depth with the reference.

    Pictures with oblong pixels go through a PNG: Blender 5.0 cannot write them as multi-layer EXR.
    """
    model = make_model(60, seed=3)
    splat_object(model_file(model))
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.fastgs.use_pass_alpha = True
    world_to_camera = by_hand.look_at(EYE, TARGET)

    def take(hand, **settings):
        camera = add_camera(**settings)
        camera.matrix_world = Matrix(by_hand.blender_matrix(world_to_camera).tolist())
        eye = by_hand.camera(fg, world_to_camera, **hand)
        expected = fg.render(model, eye, passes=("alpha", "depth"), backend="reference")
        assert expected["alpha"].max() > 0.5
        if "aspect" in hand:
            scene.render.film_transparent = True
            by_hand.assert_same_picture(render("PNG16")[..., 3], expected["alpha"])
            return
        image = render()
        by_hand.assert_same_picture(image["ViewLayer.Splat Alpha"], expected["alpha"])
        solid = expected["alpha"] > 0.5
        np.testing.assert_allclose(image["ViewLayer.Depth"][..., 0][solid], expected["depth"][solid], rtol=5e-3)
        assert (image["ViewLayer.Depth"][..., 0][expected["alpha"] == 0] == np.float32(1e10)).all()

    return take


def test_default(shot):
    shot({})


@pytest.mark.parametrize(("fit", "size", "horizontal", "sensor"), [
    ('AUTO', (64, 48), True, 30), ('AUTO', (48, 64), False, 30), ('HORIZONTAL', (48, 64), True, 30),
    ('VERTICAL', (64, 48), False, 20),
])
def test_sensor_fit(scene, shot, fit, size, horizontal, sensor):
    scene.render.resolution_x, scene.render.resolution_y = size
    shot(dict(width=size[0], height=size[1], lens=35, sensor=sensor, horizontal=horizontal),
         lens=35, sensor_fit=fit, sensor_width=30, sensor_height=20)


@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_shift(scene, shot, size):
    scene.render.resolution_x, scene.render.resolution_y = size
    shot(dict(width=size[0], height=size[1], horizontal=size[0] > size[1], shift=(0.1, -0.07)), shift_x=0.1, shift_y=-0.07)


@pytest.mark.parametrize("aspect", [(1, 2), (1.5, 1)])
def test_pixel_aspect(scene, shot, aspect):
    """At 1 x 2 the picture is taller than wide, so the sensor is fitted to its height."""
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    shot(dict(aspect=aspect, horizontal=aspect[0] > aspect[1], shift=(0.05, 0.02)), shift_x=0.05, shift_y=0.02)


@pytest.mark.parametrize("aspect", [(1, 1), (1, 1.6)])
def test_orthographic(scene, shot, aspect):
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    shot(dict(ortho_scale=5, aspect=aspect, horizontal=aspect[1] == 1, shift=(0.1, 0.05)),
         type='ORTHO', ortho_scale=5, shift_x=0.1, shift_y=0.05)


def test_field_of_view_unit(shot):
    shot(dict(lens=18 / np.tan(0.35)), lens_unit='FOV', angle=0.7)


def test_clip_start_is_the_near_plane(shot):
    shot(dict(near=4.8), clip_start=4.8)


def test_clip_end_is_the_far_plane(shot):
    shot(dict(far=4.8), clip_end=4.8)


def test_a_clip_end_before_the_clip_start_is_refused(scene, make_model, model_file, splat_object, add_camera):
    splat_object(model_file(make_model(5)))
    camera = add_camera(clip_start=20.0, clip_end=10.0)
    with pytest.raises(RuntimeError, match=f'"{camera.name}".*Clip End.*10.*Clip Start.*20'):
        bpy.ops.render.render()


@pytest.mark.parametrize(("percentage", "width", "height"), [(50, 33, 25), (150, 100, 76)])
def test_percentage_is_cut_to_whole_pixels(scene, shot, percentage, width, height):
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 67, 51, percentage
    shot(dict(width=width, height=height))


def test_scale_of_the_camera_object_does_not_count(scene, fg, make_model, model_file, splat_object, add_camera, render):
    splat_object(model_file(make_model()))
    camera = add_camera()
    plain = render()["ViewLayer.Combined"]
    camera.scale = (3, 0.5, 2)
    np.testing.assert_allclose(render()["ViewLayer.Combined"], plain, atol=1e-5)


def test_the_evaluated_camera_counts(scene, fg, make_model, model_file, splat_object, add_camera, render):
    """A camera on an animated rig, halfway between two frames."""
    model = make_model(60, seed=3)
    splat_object(model_file(model))
    scene.view_layers[0].fastgs.use_pass_alpha = True
    rig = bpy.data.objects.new("Rig", None)
    scene.collection.objects.link(rig)
    for frame, x in ((1, 0), (2, 1)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    add_camera(location=EYE).parent = rig
    scene.camera.matrix_world = Matrix(by_hand.blender_matrix(by_hand.look_at(EYE, TARGET)).tolist())
    scene.frame_set(1, subframe=0.5)
    moved = by_hand.look_at(np.add(EYE, (0.5, 0, 0)), np.add(TARGET, (0.5, 0, 0)))
    expected = fg.render(model, by_hand.camera(fg, moved), passes=("alpha",), backend="reference")["alpha"]
    by_hand.assert_same_picture(render()["ViewLayer.Splat Alpha"], expected)


BORDER = (0.21, 0.73, 0.34, 0.9)


@pytest.mark.parametrize("percentage", [100, 70])
@pytest.mark.parametrize("crop", [False, True])
def test_border_has_the_bytes_of_the_whole(scene, make_model, model_file, splat_object, add_camera, render, percentage, crop):
    splat_object(model_file(make_model(200)))
    add_camera(shift_x=0.05)
    r = scene.render
    r.resolution_percentage = percentage
    scene.view_layers[0].use_pass_z = True
    whole = render()
    r.use_border, r.use_crop_to_border = True, crop
    r.border_min_x, r.border_max_x, r.border_min_y, r.border_max_y = BORDER
    part = render()
    height, width = whole["ViewLayer.Depth"].shape[:2]
    x0, x1, y0, y1 = (int(f * s) for f, s in zip(BORDER, (width, width, height, height), strict=True))
    box = np.s_[height - y1:height - y0, x0:x1]
    for name, image in whole.items():
        inside = part[name] if crop else part[name][box]
        np.testing.assert_array_equal(inside, image[box], err_msg=name)
        assert np.ptp(inside) > 0
    if not crop:
        outside = part["ViewLayer.Combined"].copy()
        outside[box] = 0
        assert not outside.any()


def test_an_object_that_is_no_camera_and_a_mirror_ball_are_refused(scene, make_model, model_file, splat_object, add_camera, render):
    obj = splat_object(model_file(make_model()))
    data = add_camera(type='PANO').data
    (data if hasattr(data, "panorama_type") else data.cycles).panorama_type = 'MIRRORBALL'
    with pytest.raises(RuntimeError, match='"Camera".*mirrorball.*Equirectangular'):
        render()
    scene.camera = obj
    with pytest.raises(RuntimeError, match='"Splats".*mesh'):
        render()


def test_no_camera(scene, make_model, model_file, splat_object, render):
    splat_object(model_file(make_model()))
    with pytest.raises(RuntimeError, match="(?i)no camera"):
        render()


def test_stereo_views(scene, fg, make_model, model_file, splat_object, add_camera, tmp_path):
    """Parallel eyes: each view is the picture of a camera moved sideways by half the distance."""
    model = make_model(60, seed=3)
    splat_object(model_file(model))
    world_to_camera = by_hand.look_at(EYE, TARGET)
    camera = add_camera(shift_x=0.1)
    camera.matrix_world = Matrix(by_hand.blender_matrix(world_to_camera).tolist())
    camera.data.stereo.convergence_mode, camera.data.stereo.pivot = 'OFFAXIS', 'CENTER'
    camera.data.stereo.interocular_distance = 0.3
    camera.data.stereo.convergence_distance = 4
    r = scene.render
    r.use_multiview, r.views_format = True, 'STEREO_3D'
    r.views.new("extra")  # is of no account in stereo
    r.image_settings.views_format = 'INDIVIDUAL'
    r.film_transparent = True
    image_files.set_output(scene, "EXR")
    r.filepath = str(tmp_path / "stereo.exr")
    bpy.ops.render.render(write_still=True)
    for suffix, side in (("_L", -1), ("_R", 1)):
        picture = image_files.read_exr(tmp_path / f"stereo{suffix}.exr")
        moved = world_to_camera.copy()
        moved[0, 3] -= side * 0.15
        # the eyes' pictures coincide at the convergence distance: 0.15 there is 0.15 / 4 x 50 mm on the sensor
        eye = by_hand.camera(fg, moved, shift=(0.1 - side * 0.15 / 4 * 50 / 36, 0))
        expected = fg.render(model, eye, passes=("alpha",), backend="reference")["alpha"]
        by_hand.assert_same_picture(picture["ViewLayer.Combined"][..., 3], expected)


def test_views_with_their_own_cameras(scene, fg, make_model, model_file, splat_object, add_camera, tmp_path):
    model = make_model(60, seed=3)
    splat_object(model_file(model))
    scene.camera = None
    eyes = {"left": (-1, -5, 0), "right": (1, -5, 1)}
    for view, suffix in (("left", "_L"), ("right", "_R")):
        add_camera(location=eyes[view]).name = f"Camera{suffix}"
    r = scene.render
    r.use_multiview, r.views_format, r.film_transparent = True, 'MULTIVIEW', True
    r.image_settings.views_format = 'INDIVIDUAL'
    image_files.set_output(scene, "EXR")
    r.filepath = str(tmp_path / "views.exr")
    bpy.ops.render.render(write_still=True)
    for view, suffix in (("left", "_L"), ("right", "_R")):
        hand = by_hand.camera(fg, by_hand.look_at(eyes[view], np.add(eyes[view], (0, 1, 0))))
        expected = fg.render(model, hand, passes=("alpha",), backend="reference")["alpha"]
        by_hand.assert_same_picture(image_files.read_exr(tmp_path / f"views{suffix}.exr")["ViewLayer.Combined"][..., 3], expected)
