# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows on splats while Blender's shutter is open and a mesh or its lamp moves."""
import bpy
import numpy as np
import pytest


@pytest.fixture
def shaded(scene, fg, model_file, splat_object, add, add_camera):
    """A grey wall at y = 0 before a camera, and (the box before it, the lamp that throws its shadow to the right)."""
    x, z = (axis.ravel() for axis in np.meshgrid(*[np.arange(-2, 2, 0.08)] * 2))
    model = fg.GaussianModel(position=np.stack([x, 0 * x, z], 1), rotation=np.tile([1.0, 0, 0, 0], (len(x), 1)),
                             opacity=np.full(len(x), 6.0), scale=np.log(np.tile([0.056, 1e-4, 0.056], (len(x), 1))),
                             features=np.full((len(x), 3), 0.6))
    add_camera(location=(0, -5, 0), rotation=(90, 0, 0))
    scene.view_settings.view_transform, scene.render.film_transparent = 'Raw', True
    look = splat_object(model_file(model)).fastgs
    look.captured_light, look.lamp_light, look.shadows = 0.2, 1.0, 1.0
    box = add("cube", size=0.4, location=(0, -0.8, 0))
    box.visible_camera = False
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", 'POINT'))
    lamp.location, lamp.data.energy, lamp.data.shadow_soft_size = (-1.0, -3.0, 0), 200.0, 0.0
    scene.collection.objects.link(lamp)
    return box, lamp


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1], ids=["box", "lamp"])
def test_a_shadow_that_moves_is_blurred(scene, shaded, render, which):
    """As the average of sub-frames is; the frame's own shadow is farther from it."""
    moving = shaded[which]
    for frame, place in ((1, -0.4), (3, 0.4)):
        moving.location.z = place
        moving.keyframe_insert("location", frame=frame)
    scene.frame_set(2)
    sharp = render("PNG16")
    scene.render.use_motion_blur, scene.render.motion_blur_shutter, scene.render.motion_blur_position = True, 1.0, 'CENTER'
    blurred = render("PNG16")
    assert np.array_equal(blurred, render("PNG16")) and scene.frame_current == 2
    scene.render.use_motion_blur = False
    wanted = []
    for later in np.linspace(-0.5, 0.5, 9)[1:] - 1 / 16:
        scene.frame_set(int(np.floor(2 + later)), subframe=later % 1)
        wanted.append(render("PNG16"))
    off, before = (np.abs(each - np.mean(wanted, 0))[..., :3] for each in (blurred, sharp))
    assert off.max() < 0.4 * before.max() and off.mean() < 0.4 * before.mean() and before.max() > 0.08
