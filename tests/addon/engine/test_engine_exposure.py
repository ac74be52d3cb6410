# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur and depth of field as Blender's settings have them, against averages of sharp frames."""
import bpy
import numpy as np
import pytest


@pytest.fixture
def moving(scene, fg, make_model, model_file, splat_object, add_camera):
    """A cloud whose model, object and camera all move between frames; film is transparent."""
    model = make_model(30, basis=fg.Polynomial(1), motion=np.tile([[[1.5, 0, 0]]], (30, 1, 1)), clip=fg.Clip(20, 24))
    obj = splat_object(model_file(model))
    camera = add_camera()
    for frame, x in ((1, 0.0), (11, 0.8)):
        obj.location[2] = x
        obj.keyframe_insert("location", index=2, frame=frame)
        camera.data.lens = 50 + 10 * x
        camera.data.keyframe_insert("lens", frame=frame)
    scene.frame_set(6)
    scene.render.film_transparent = True
    return obj, camera


@pytest.mark.parametrize("position", ['START', 'CENTER', 'END'])
def test_motion_blur_is_the_average_of_subframes(scene, moving, render, position):
    """Of 33 sharp pictures on sub-frames that are set by hand."""
    r = scene.render
    r.motion_blur_shutter, r.motion_blur_position = 2.0, position
    first = {'START': 6.0, 'CENTER': 5.0, 'END': 4.0}[position]
    expected = 0
    for i in range(33):
        frame = first + 2 * i / 32
        scene.frame_set(int(frame), subframe=frame % 1)
        expected = expected + render()["ViewLayer.Combined"] * (0.5 if i in (0, 32) else 1) / 32
    scene.frame_set(6)
    sharp = render()["ViewLayer.Combined"]
    r.use_motion_blur, scene.fastgs.blur_steps = True, 32
    blurred = render()["ViewLayer.Combined"]
    assert np.abs(blurred - expected).mean() < 2e-3 < 0.1 * np.abs(sharp - expected).max()
    assert np.array_equal(render()["ViewLayer.Combined"], blurred), "the same bytes every time"
    assert (scene.frame_current, scene.frame_subframe) == (6, 0)


def test_the_shutters_curve(scene, moving, render):
    """A curve that is open at the end alone shows the end."""
    r = scene.render
    r.use_motion_blur, r.motion_blur_shutter, r.motion_blur_position = True, 2.0, 'START'
    curve = r.motion_blur_shutter_curve.curves[0]
    for point, place in zip(list(curve.points)[:2], ((0, 0), (0.95, 0)), strict=False):
        point.location = place
    curve.points[len(curve.points) - 1].location = 1, 1
    r.motion_blur_shutter_curve.update()
    blurred = render()["ViewLayer.Combined"]
    r.use_motion_blur = False
    at = {}
    for frame in (6, 8):
        scene.frame_set(frame)
        at[frame] = np.abs(render()["ViewLayer.Combined"] - blurred).mean()
    assert at[8] < 0.5 * at[6]


def test_depth_of_field(scene, make_model, model_file, splat_object, add_camera, render, fg):
    """The focus object counts along the view axis, the opening is focal length / f-stop; wide open, only what lies there is sharp."""
    points = np.array([[x, y, 0.0] for x in (-0.6, 0.6) for y in (0.0, 6.0)])
    model = make_model(4, position=points, scale=np.full((4, 3), np.log(0.02)), opacity=np.full(4, 4.0))
    splat_object(model_file(model))
    camera = add_camera()
    scene.render.film_transparent = True
    sharp = render()["ViewLayer.Combined"][..., 3]
    target = bpy.data.objects.new("Focus", None)
    target.location = 3.0, 0.0, 1.0
    scene.collection.objects.link(target)
    dof = camera.data.dof
    dof.use_dof, dof.focus_object, dof.aperture_fstop = True, target, 0.1
    near = render()["ViewLayer.Combined"][..., 3]
    scene.fastgs.lens_samples = 4
    assert np.abs(render()["ViewLayer.Combined"][..., 3] - near).max() > 0.01, "so few points of the lens leave single copies"
    scene.fastgs.property_unset("lens_samples")
    target.location = 0, 6.0, 0
    far = render()["ViewLayer.Combined"][..., 3]
    places = {}
    for name, (x, y) in (("front", points[0, :2]), ("back", points[1, :2])):
        column = int(32 + x * 50 / 36 * 64 / (5 + y))
        places[name] = np.s_[22:27, column - 1:column + 2]
    pictures = {"front": near, "back": far}
    loss = {(focus, name): (sharp - picture)[at].max() for name, at in places.items() for focus, picture in pictures.items()}
    assert loss["front", "front"] < 0.05 and loss["back", "back"] < 0.05, loss
    assert loss["front", "back"] > 0.3 and loss["back", "front"] > 0.3, loss
    dof.aperture_fstop = 1000.0
    np.testing.assert_allclose(render()["ViewLayer.Combined"][..., 3], sharp, atol=1e-3)
