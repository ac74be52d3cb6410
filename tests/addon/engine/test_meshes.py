# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that hide splats, and catch their shadows, in final renders of Blender's scenes."""
from __future__ import annotations

import bpy
import numpy as np
import pytest

COMBINED = "ViewLayer.Combined"


@pytest.fixture
def splats(fg, model_file, splat_object, add_camera, scene):
    """A screen of opaque red Gaussians at y = 0, which a camera at y = -5 sees everywhere on transparent film; its object."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-3, 3, 70), np.linspace(-3, 3, 70)))
    n = len(x)
    model = fg.GaussianModel(position=np.stack([x, np.zeros(n), z], 1), rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                             scale=np.full((n, 3), -2.4), opacity=np.full(n, 6.0), features=np.tile((0.9, 0.1, 0.1), (n, 1)))
    add_camera()
    scene.render.film_transparent = True
    return splat_object(model_file(model))


@pytest.fixture
def alpha(render):
    return lambda: render()[COMBINED][..., 3]


def window(x=0.0, z=0.0, size=1.0, y=-1.0, grow=0.0):
    """The pixels that a square before the camera covers, wholly (grow < 0) or at all."""
    unit = 50 / 36 * 64 / (5 + y)
    left, right = 32 + (x - size / 2) * unit, 32 + (x + size / 2) * unit
    top, bottom = 24 - (z + size / 2) * unit, 24 - (z - size / 2) * unit
    out = np.zeros((48, 64), bool)
    out[int(np.ceil(top - grow)):int(bottom + grow), int(np.ceil(left - grow)):int(right + grow)] = True
    return out


def square(add, **options):
    return add("plane", rotation=(np.pi / 2, 0, 0), **{"size": 1.0, "location": (0, -1, 0)} | options)


def assert_hidden(found, free, x=0.0, **where):
    """Nothing shows in the square, all else is as it was to the last bit."""
    assert not found[window(x, **where)].any()
    outside = ~window(x, grow=1.5, **where)
    assert np.array_equal(found[outside], free[outside]) and free.min() > 0.9


def test_what_hides_splats(scene, splats, add, alpha):
    free = alpha()
    plane = square(add)
    assert np.array_equal(alpha(), free), "as it was before, without a word of the user"
    scene.fastgs.use_meshes = True
    assert_hidden(alpha(), free)
    for name, value in (("hide_render", True), ("visible_camera", False)):
        setattr(plane, name, value)
        assert np.array_equal(alpha(), free), name
        setattr(plane, name, not value)
    plane.fastgs.hides_splats = False
    assert np.array_equal(alpha(), free)
    plane.is_holdout = True
    assert_hidden(alpha(), free)
    scene.fastgs.use_meshes = False
    assert_hidden(alpha(), free)
    plane.is_holdout = False
    inside = bpy.data.collections.new("Inside")
    scene.collection.children.link(inside)
    inside.objects.link(plane)
    scene.collection.objects.unlink(plane)
    bpy.context.view_layer.layer_collection.children["Inside"].holdout = True
    assert_hidden(alpha(), free)
    plane.location.y = 1.0  # behind the splats
    assert alpha() == pytest.approx(free, abs=1e-6)


def test_what_is_evaluated_hides(scene, splats, add, alpha):
    """Instances of a collection, modifiers, and text and curves as surfaces."""
    free = alpha()
    scene.fastgs.use_meshes = True
    plane = square(add)
    inside = bpy.data.collections.new("Inside")
    inside.objects.link(plane)
    scene.collection.objects.unlink(plane)
    assert np.array_equal(alpha(), free)
    for x in (-0.9, 0.9):
        maker = bpy.data.objects.new("Maker", None)
        maker.instance_type, maker.instance_collection, maker.location = 'COLLECTION', inside, (x, 0, 0)
        scene.collection.objects.link(maker)
    both = alpha()
    for x in (-0.9, 0.9):
        assert not both[window(x)].any()
    outside = ~window(-0.9, grow=1.5) & ~window(0.9, grow=1.5)
    assert np.array_equal(both[outside], free[outside])
    for obj in [obj for obj in scene.objects if obj.name.startswith("Maker")]:
        bpy.data.objects.remove(obj)

    scene.collection.objects.link(plane)
    array = plane.modifiers.new("Array", 'ARRAY')
    array.use_relative_offset, array.use_constant_offset, array.constant_offset_displace = False, True, (-1.0, 0, 0)
    found = alpha()
    assert not found[window(0.0)].any() and not found[window(-1.0)].any() and found[window(1.0)].min() > 0.9
    bpy.data.objects.remove(plane)

    bpy.ops.curve.primitive_bezier_circle_add(radius=0.5, location=(0, -1, 0), rotation=(np.pi / 2, 0, 0))
    bpy.context.object.data.dimensions, bpy.context.object.data.fill_mode = '2D', 'BOTH'
    found = alpha()
    y, x = np.mgrid[:48, :64] + 0.5
    away = np.hypot(x - 32, y - 24) / (50 / 36 * 64 / 4)
    assert not found[away < 0.45].any() and np.array_equal(found[away > 0.56], free[away > 0.56])


def test_instances_hide_as_what_they_show_does(scene, splats, add, alpha, paint):
    """A collection that is instanced has an opaque square, glass, and one that is not to hide anything."""
    free = alpha()
    scene.fastgs.use_meshes = True
    inside = bpy.data.collections.new("Inside")
    for x in (-0.9, 0.0, 0.9):
        obj = square(add, location=(x, -1, 0), size=0.5)
        inside.objects.link(obj)
        scene.collection.objects.unlink(obj)
    paint(inside.objects[1])[1].inputs["Transmission Weight"].default_value = 1.0
    inside.objects[2].fastgs.hides_splats = False
    maker = bpy.data.objects.new("Maker", None)
    maker.instance_type, maker.instance_collection = 'COLLECTION', inside
    scene.collection.objects.link(maker)
    assert_hidden(alpha(), free, -0.9, size=0.5)
    maker.fastgs.hides_splats = False
    assert np.array_equal(alpha(), free)


def test_passes_say_what_is_hidden(scene, splats, add, render):
    """Alpha and Depth of the splats that are left, the light that the mesh stops, and a hole in the world."""
    square(add)
    scene.fastgs.use_meshes = True
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.fastgs.use_pass_alpha = layer.fastgs.use_pass_holdout = True
    inside, outside = window(), ~window(grow=1.5)
    found = render()
    assert not found["ViewLayer.Splat Alpha"][inside].any() and (found["ViewLayer.Depth"][inside] == 1e10).all()
    assert found["ViewLayer.Depth"][outside] == pytest.approx(5, rel=0.02)
    assert (found["ViewLayer.Splat Holdout"][inside] == 1).all() and not found["ViewLayer.Splat Holdout"][outside].any()
    scene.render.film_transparent = False
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)
    combined = render()[COMBINED]
    assert not combined[inside].any() and (combined[outside][:, 3] == 1).all()


def test_motion_blur_and_depth_of_field_of_meshes(scene, splats, add, alpha):
    """A square that crosses its own width while the shutter is open hides a triangle's worth of light."""
    free = alpha()
    plane = square(add)
    for frame, x in ((0, -1.0), (4, 1.0)):
        plane.location.x = x
        plane.keyframe_insert("location", index=0, frame=frame)
    from_action = plane.animation_data.action
    curves = from_action.fcurves if hasattr(from_action, "fcurves") else from_action.layers[0].strips[0].channelbags[0].fcurves
    for key in curves[0].keyframe_points:
        key.interpolation = 'LINEAR'
    scene.frame_set(2)
    scene.fastgs.use_meshes = scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 2.0
    x = (np.arange(64) + 0.5 - 32) / (50 / 36 * 64 / 4)
    hidden = 1 - alpha()[20:28].mean(0) / free[20:28].mean(0)
    np.testing.assert_allclose(hidden, np.clip(1 - np.abs(x), 0, 1), atol=0.05)
    scene.render.use_motion_blur = False
    dof = scene.camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 5.0, 0.1
    soft = alpha()
    assert soft[24, 32] < 0.05 and 0.1 < soft[window(grow=4) & ~window(grow=-3)].mean() < 0.9


def test_panoramas_see_meshes(scene, splats, add, alpha, add_camera):
    scene.camera.data.type = 'PANO'
    kinds = scene.camera.data if hasattr(scene.camera.data, "panorama_type") else scene.camera.data.cycles
    kinds.panorama_type = 'EQUIRECTANGULAR'
    free = alpha()
    square(add, size=2.0, location=(0, -3, 0))
    scene.fastgs.use_meshes = True
    found = alpha()
    assert free[24, 32] > 0.9 and not found[22:26, 30:34].any() and np.array_equal(found[:, :20], free[:, :20])


def test_shadows_fall_where_the_light_sends_them(scene, fg, model_file, splat_object, add, add_camera, render):
    """A dark ball of splats over a plane, lit by each kind of lamp; the camera looks straight down."""
    ball = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.3] * 3]), opacity=[4.0], features=[[0, 0, 0]])
    splat_object(model_file(ball))
    add_camera(location=(0, 0, 10), rotation=(0, 0, 0), lens=36.0)  # 6.4 pixels a unit on the plane
    add("plane", size=40)
    bpy.context.view_layer.fastgs.use_pass_shadow = True
    assert (render()["ViewLayer.Splat Shadow"] == 1).all(), "no light was chosen"

    def lamp(kind, location, rotation=(0, 0, 0), **data):
        obj = bpy.data.objects.new(kind, bpy.data.lights.new(kind, kind))
        obj.location, obj.rotation_euler = location, rotation
        for name, value in data.items():
            setattr(obj.data, name, value)
        scene.collection.objects.link(obj)
        for each in scene.objects:
            each.fastgs.splat_shadow = each is obj
        dark = 1 - render()["ViewLayer.Splat Shadow"][..., 0]
        y, x = np.mgrid[:48, :64] + 0.5
        return dark, ((dark * x).sum() / dark.sum() - 32) / 6.4, (24 - (dark * y).sum() / dark.sum()) / 6.4

    hard, x, y = lamp('SUN', (0, 0, 5), (0, np.pi / 4, 0), angle=0.0)
    assert (x, y) == pytest.approx((-2, 0), abs=0.1) and hard.max() > 0.8
    soft, x, y = lamp('SUN', (0, 0, 5), (0, np.pi / 4, 0), angle=0.5)
    assert (x, y) == pytest.approx((-2, 0), abs=0.25) and soft.max() < hard.max() - 0.1
    scene.fastgs.shadow_samples = 1
    assert (1 - render()["ViewLayer.Splat Shadow"]).max() > soft.max() + 0.1, "one point of the sun makes a hard shadow"
    scene.fastgs.shadow_samples, scene.fastgs.shadow_bias = 16, 6.0
    assert render()["ViewLayer.Splat Shadow"].min() > 0.99, "splats so near to a surface cast none on it"
    scene.fastgs.property_unset("shadow_bias")
    _, x, y = lamp('SPOT', (0, 1, 4), shadow_soft_size=0.0)
    # Its middle falls on -1.  Behind it the shadow is longer: the mean of exp(-d^2 / 2 s^2) over lines of light lies at -1.2.
    assert x == pytest.approx(0, abs=0.1) and -1.25 < y < -0.95
    wide, x, y = lamp('AREA', (0, 0, 4), shape='RECTANGLE', size=3.0, size_y=0.1)
    assert (x, y) == pytest.approx((0, 0), abs=0.15)
    assert (wide.max(0) > 0.05).sum() > 1.5 * (wide.max(1) > 0.05).sum()
    bpy.data.objects["AREA"].hide_render = True
    assert render()["ViewLayer.Splat Shadow"].min() < 1, "a hidden lamp still says where the light comes from"


def test_each_lamp_has_its_shadow(scene, fg, model_file, splat_object, add, add_camera, render, warned):
    """A sun from the left, one from the right, and more than there are passes; a point lamp is none.  Shadow linking tells them apart."""
    ball = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.3] * 3]), opacity=[4.0], features=[[0, 0, 0]])
    splats = splat_object(model_file(ball))
    add_camera(location=(0, 0, 10), rotation=(0, 0, 0), lens=36.0)
    add("plane", size=40)
    bpy.context.view_layer.fastgs.use_pass_shadow = True
    for name, kind, angle in (("Bulb", 'POINT', 0.0), ("From Left", 'SUN', -np.pi / 4), ("From Right", 'SUN', np.pi / 4)):
        lamp = bpy.data.objects.new(name, bpy.data.lights.new(name, kind))
        lamp.rotation_euler.y, lamp.fastgs.splat_shadow = angle, True
        scene.collection.objects.link(lamp)
    planes = render()
    for name, x in (("Splat Shadow", 2), ("Splat Shadow 2", -2)):
        assert planes[f"ViewLayer.{name}"][24, int(32 + 6.4 * x), 0] < 0.5 < planes[f"ViewLayer.{name}"][24, int(32 - 6.4 * x), 0]
    assert "ViewLayer.Splat Shadow 3" not in planes and not any("lamps" in text for text in warned())
    blockers = scene.objects["From Left"].light_linking.blocker_collection = bpy.data.collections.new("Blockers")
    blockers.objects.link(splats)
    blockers.collection_objects[0].light_linking.link_state = 'EXCLUDE'
    planes = render()
    assert planes["ViewLayer.Splat Shadow"].min() == 1 and planes["ViewLayer.Splat Shadow 2"].min() < 0.5
    for _ in range(7):
        more = scene.objects["From Right"].copy()
        scene.collection.objects.link(more)
    planes = render()
    assert "ViewLayer.Splat Shadow 8" in planes and "ViewLayer.Splat Shadow 9" not in planes
    assert any("At most 8 lamps" in text for text in warned())
