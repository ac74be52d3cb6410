# SPDX-License-Identifier: GPL-3.0-or-later
"""New Camera from View: the corners of the view lie where they should in the new camera's picture.  (tests/blender asks a real window.)"""
from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector


@pytest.fixture
def view(scene):
    """view(perspective, lens): the context of a 3D view that looks down at the origin."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == 'VIEW_3D')
    space, region = area.spaces.active, next(region for region in area.regions if region.type == 'WINDOW')
    assert region.width > 100 and region.height > 100 and region.width != region.height

    def look(perspective='PERSP', lens=50.0):
        seen = space.region_3d
        seen.view_perspective, space.lens, space.clip_start, space.clip_end = perspective, lens, 0.02, 300.0
        seen.view_rotation, seen.view_location, seen.view_distance = Euler((1.1, 0, 0.6)).to_quaternion(), (0.2, 0.1, 0.4), 6.0
        return dict(window=window, area=area, region=region, space_data=space, region_data=seen)

    yield look
    look()


def corners(context):
    """The corners of what a view shows, at two depths, in the world: [8, 4].  36 mm of its lens show half of its longer side."""
    space, seen, region = context["space_data"], context["region_data"], context["region"]
    longer = max(region.width, region.height)
    eye = Matrix.Translation(seen.view_location) @ seen.view_rotation.to_matrix().to_4x4()
    eye = eye @ Matrix.Translation((0, 0, seen.view_distance))
    found = []
    for depth in (5.0, 9.0):
        half = (seen.view_distance if seen.view_perspective == 'ORTHO' else depth) * 36.0 / space.lens
        found += [eye @ Vector((x * half * region.width / longer, y * half * region.height / longer, -depth, 1))
                  for x in (-1, 1) for y in (-1, 1)]
    return np.array(found)


def pictured(camera, scene, places):
    """Where places [n, 4] lie in a camera's picture, whose sides are at -1 and 1, by Blender's own projection: [n, 2]."""
    render, graph = scene.render, bpy.context.evaluated_depsgraph_get()
    p = camera.evaluated_get(graph).calc_matrix_camera(graph, x=render.resolution_x, y=render.resolution_y,
                                                       scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y)
    out = places @ (np.array(p) @ np.linalg.inv(np.array(camera.matrix_world))).T
    assert (out[:, 3] > 0).all(), "before the camera"
    return out[:, :2] / out[:, 3:]


@pytest.mark.parametrize("size", [(1920, 1080), (600, 1000), (500, 500)])
@pytest.mark.parametrize(("perspective", "lens"), [('PERSP', 50.0), ('PERSP', 4.0), ('ORTHO', 35.0)])
def test_all_of_the_view_is_in_the_picture(scene, view, size, perspective, lens):
    scene.render.resolution_x, scene.render.resolution_y = size
    context = view(perspective, lens)
    wanted = corners(context)
    with bpy.context.temp_override(**context):
        assert bpy.ops.fastgs.camera_from_view() == {'FINISHED'}
    camera = scene.camera
    assert camera == bpy.context.object and camera.select_get() and context["region_data"].view_perspective == 'CAMERA'
    assert (scene.render.resolution_x, scene.render.resolution_y) == size
    assert camera.data.type == perspective and (camera.data.clip_start, camera.data.clip_end) == pytest.approx((0.02, 300.0))
    bpy.context.view_layer.update()
    reach = np.abs(pictured(camera, scene, wanted)).max(0)
    assert reach.max() == pytest.approx(1, abs=1e-4) and reach.min() <= 1 + 1e-4, "it ends at two sides where the view does"


@pytest.mark.parametrize(("perspective", "lens"), [('PERSP', 1.0), ('ORTHO', 35.0)])
def test_set_up_scene_places_a_camera_likewise(scene, view, module, perspective, lens):
    """The widest view needs a sensor of its own, because Blender's shortest lens is 1 mm; behind an orthographic one nothing lies."""
    bpy.ops.mesh.primitive_cube_add(location=(0, 0, 50))
    context = view(perspective, lens)
    with bpy.context.temp_override(**context):
        camera = module("scene.cameras.from_view").stand_in_view(bpy.context, [])
    bpy.context.view_layer.update()
    reach = np.abs(pictured(camera, scene, corners(context))).max(0)
    assert reach.max() == pytest.approx(1, abs=1e-4) and reach.min() <= 1 + 1e-4
    assert perspective == 'PERSP' or (np.linalg.inv(np.array(camera.matrix_world)) @ (0, 0, 51, 1))[2] < 0


def test_without_a_window_the_camera_is_that_of_a_usual_view(scene, splats, module):
    """A 3D view's lens is 50 mm before 72 mm at first."""
    camera = module("scene.cameras.from_view").stand_in_view
    with bpy.context.temp_override(window=None):
        made = camera(bpy.context, [splats])
    assert made == scene.camera and made.data.sensor_width / made.data.lens == pytest.approx(72 / 50)


def test_the_picture_may_take_the_views_shape(scene, view):
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    context = view()
    wanted = corners(context)
    with bpy.context.temp_override(**context):
        bpy.ops.fastgs.camera_from_view(shape='VIEW')
    bpy.context.view_layer.update()
    size = scene.render.resolution_x, scene.render.resolution_y
    assert max(size) == 1920 and not size[0] % 2 and not size[1] % 2
    np.testing.assert_allclose(np.abs(pictured(scene.camera, scene, wanted)), 1, atol=2 / min(size))


def test_nothing_lies_behind_the_camera_of_an_orthographic_view(scene, view):
    bpy.ops.mesh.primitive_cube_add(location=(0, 0, 50))
    context = view('ORTHO')
    seen = context["region_data"]
    assert (seen.view_rotation.inverted() @ (Vector((0, 0, 49)) - seen.view_location)).z > 6, "behind where the view looks from"
    with bpy.context.temp_override(**context):
        bpy.ops.fastgs.camera_from_view()
    bpy.context.view_layer.update()
    away = np.linalg.inv(np.array(scene.camera.matrix_world))
    assert all((away @ (*corner, 1))[2] < 0 for corner in np.array([(x, y, 50 + z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]))


def test_a_view_through_a_camera_gives_a_copy_that_stands_still(scene, add_camera, view):
    old = add_camera(lens=85.0)
    for frame, lens in ((1, 85.0), (20, 30.0)):
        old.data.lens = lens
        old.data.keyframe_insert("lens", frame=frame)
    old.matrix_world = Matrix.Translation((1, 2, 3)) @ Euler((0.3, 0.2, 0.1)).to_matrix().to_4x4()
    bpy.context.view_layer.update()
    context = view('CAMERA')
    scene.frame_set(20)
    with bpy.context.temp_override(**context):
        bpy.ops.fastgs.camera_from_view(shape='VIEW')
    made = scene.camera
    assert made != old and made.data != old.data and made.data.lens == pytest.approx(30) and made.data.animation_data is None
    np.testing.assert_allclose(made.matrix_world, old.matrix_world, atol=1e-6)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48), "its picture is the scene's already"


def test_it_wants_a_3d_view(scene):
    assert not bpy.ops.fastgs.camera_from_view.poll()
