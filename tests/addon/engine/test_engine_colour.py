# SPDX-License-Identifier: GPL-3.0-or-later
"""Final renders have the capture's colours under the view transform Standard, and the right background behind the splats."""
from dataclasses import replace

import bpy
import by_hand
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

SWATCHES = np.array([(0, 0, 0), (1, 1, 1), (0.5, 0.5, 0.5), (0.9, 0.1, 0.04), (0.2, 0.7, 0.3), (0.02, 0.05, 0.9)])


@pytest.fixture(scope="module")
def colour(module):
    return module("scene.colour")


@given(arrays(np.float64, 20, elements=st.floats(-50, 50)))
def test_curve_is_continuous_and_odd(module, x):
    curve = module("fastgs_blender.rendering.colour").srgb_to_linear
    y = curve(x)
    np.testing.assert_allclose(curve(-x), -y)
    np.testing.assert_allclose(y[x >= 0], by_hand.linear(x[x >= 0]))
    assert np.all(np.diff(curve(np.sort(x))) >= -1e-12)


def test_nothing_stays_nothing(colour):
    """Alpha 0 gives 0, not NaN; a negative colour keeps its sign."""
    rgb = np.array([[[0, 0, 0], [-0.2, 0.5, 3.0]]], np.float32)
    out = colour.scene_linear(rgb, np.array([[0, 0.5]], np.float32), True, np.eye(3, dtype=np.float32))
    np.testing.assert_array_equal(out[0, 0], 0)
    np.testing.assert_allclose(out[0, 1], 0.5 * np.array([-by_hand.linear(0.4), 1, by_hand.linear(6.0)]), rtol=1e-5)


def wall(fg, colours, opacity=2.9, **fields):
    """Columns of flat Gaussians side by side, so dense that each has one colour and covers 99.98 % of what lies behind it."""
    n = len(colours)
    x = np.linspace(-1.5, 1.5, n)
    position = np.stack([np.repeat(x, 30), np.tile(np.linspace(0, 0.5, 30), n), np.zeros(30 * n)], 1)
    return fg.GaussianModel(
        position=position, rotation=np.tile([1.0, 0, 0, 0], (30 * n, 1)), opacity=np.full(30 * n, opacity),
        scale=np.log(np.tile([0.08, 0.01, 0.5], (30 * n, 1))), features=np.repeat(colours, 30, 0), **fields)


def columns(image, count):
    """The pixels in the middle of each column of a wall."""
    height, width = image.shape[:2]
    depth, focal = 5.0, width * 50 / 36
    x = (np.linspace(-1.5, 1.5, count) / depth * focal + width / 2).astype(int)
    return image[height // 2, x]


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("dither", [0.0, pytest.param(1.0, marks=pytest.mark.skipif(
    bpy.app.version < (4, 5, 0), reason="earlier versions' own dither is coarser than the tolerance"))])
def test_standard_gives_the_colours_back(scene, fg, model_file, splat_object, add_camera, render, transparent, dither):
    """Also under Blender's own dither, which is 1 by default."""
    splat_object(model_file(wall(fg, SWATCHES)))
    add_camera()
    scene.render.film_transparent, scene.render.dither_intensity = transparent, dither
    image = render("PNG")
    actual = columns(image.astype(float), len(SWATCHES))
    assert np.abs(actual[:, :3] - 255 * SWATCHES).max() <= 1
    assert (actual[:, 3] >= 254).all()


def test_soft_edges_keep_their_colour_on_transparent_film(scene, fg, model_file, splat_object, add_camera, render):
    """A PNG is not premultiplied: also a pixel that is hardly covered has the splat's own colour."""
    splat_object(model_file(wall(fg, SWATCHES[3:4])))
    add_camera()
    scene.render.film_transparent = True
    image = render("PNG16")
    faint = (image[..., 3] > 0.05) & (image[..., 3] < 0.5)
    assert faint.sum() > 10
    assert np.abs(image[faint][:, :3] - SWATCHES[3]).max() < 1 / 255


def test_a_model_in_linear_colour_is_not_decoded(scene, fg, model_file, splat_object, add_camera, render):
    splat_object(model_file(wall(fg, SWATCHES, colour_space="linear")))
    add_camera()
    scene.render.film_transparent = True
    actual = columns(render()["ViewLayer.Combined"], len(SWATCHES))
    np.testing.assert_allclose(actual[:, :3] / actual[:, 3:], SWATCHES, atol=1e-5)


def test_models_of_both_colour_spaces_share_a_picture(scene, fg, model_file, splat_object, add_camera, render):
    """A translucent linear wall before an sRGB one: each is decoded for itself, and the weights are those of one cloud."""
    front = wall(fg, SWATCHES, opacity=-5.0, colour_space="linear")
    back = wall(fg, SWATCHES[::-1])
    back.position[:, 1] += 1
    for name, model in (("front", front), ("back", back)):
        splat_object(model_file(model, f"{name}.safetensors"), name)
    add_camera()
    scene.render.film_transparent = True
    eye = by_hand.camera(fg, by_hand.look_at((0, -5, 0), (0, 0, 0)))
    paint = [fg.RGB(), lambda m, v: replace(m, features=np.full_like(m.features, v))]
    one, zero = (lambda m: paint[1](m, 1.0)), (lambda m: paint[1](m, 0.0))

    def picture(f, b):
        return fg.render([(f, np.eye(4), 0), (b, np.eye(4), 0)], eye, backend="reference")["rgb"].astype(float)

    share = picture(zero(front), one(back))[..., :1]
    encoded = picture(zero(front), back) / np.where(share > 0, share, 1)
    expected = picture(front, zero(back)) + by_hand.linear(encoded) * share
    actual = render()["ViewLayer.Combined"]
    by_hand.assert_same_picture(actual[..., :3], expected)
    assert 0.2 < share[24, 32, 0] < 0.9


def test_gamut_of_the_working_space(scene, fg, module, model_file, splat_object, add_camera, render, tmp_path):
    """Blender 5 may work in Rec.2020 or ACEScg: the picture on the screen stays the same."""
    if not hasattr(bpy.data, "colorspace"):
        pytest.skip("this Blender has one working space")
    splat_object(model_file(wall(fg, SWATCHES)))
    add_camera()
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    before = columns(render()["ViewLayer.Combined"], len(SWATCHES))
    bpy.ops.wm.set_working_color_space(working_space='ACEScg')
    try:
        from mathutils import Color

        image = render("PNG")
        assert np.abs(columns(image.astype(float), len(SWATCHES))[:, :3] - 255 * SWATCHES).max() <= 1
        after = columns(render()["ViewLayer.Combined"], len(SWATCHES))
        for a, b in zip(after, before, strict=True):
            np.testing.assert_allclose(a[:3], Color(b[:3]).from_rec709_linear_to_scene_linear(), atol=2e-3)
        assert np.abs(after - before).max() > 0.05
    finally:
        bpy.ops.wm.set_working_color_space(working_space='Linear Rec.709')


@pytest.fixture
def world(scene):
    """A world with a Background node of one colour; returns the node."""
    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    node, output = tree.nodes.new('ShaderNodeBackground'), tree.nodes.new('ShaderNodeOutputWorld')
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    node.inputs["Color"].default_value = (0.2, 0.4, 0.1, 1)
    node.inputs["Strength"].default_value = 1.5
    return node


COLOUR = np.array((0.3, 0.6, 0.15))


def test_world_lies_under_the_splats(scene, fg, world, make_model, model_file, splat_object, add_camera, render):
    model = make_model()
    splat_object(model_file(model))
    add_camera()
    eye = by_hand.camera(fg, by_hand.look_at((0, -5, 0), (0, 0, 0)))
    want = fg.render(model, eye, backend="reference")
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"], COLOUR))
    scene.render.film_transparent = True
    by_hand.assert_same_picture(render()["ViewLayer.Combined"], by_hand.combined(want["rgb"], want["alpha"]))


def test_world_without_nodes(scene, add_camera, render):
    if bpy.app.version >= (5, 0, 0):
        pytest.skip("worlds always have nodes")
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.1, 0.2, 0.3)
    add_camera()
    np.testing.assert_allclose(render()["ViewLayer.Combined"][0, 0], (0.1, 0.2, 0.3, 1), rtol=1e-6)


def test_no_world_is_black(scene, add_camera, render):
    add_camera()
    scene.world = None
    np.testing.assert_array_equal(render()["ViewLayer.Combined"][0, 0], (0, 0, 0, 1))


def test_world_can_be_animated_and_left_out_of_a_layer(scene, world, add_camera, render):
    add_camera()
    strength = world.inputs["Strength"]
    for frame, value in ((1, 0.0), (11, 3.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    scene.frame_set(6)
    np.testing.assert_allclose(render()["ViewLayer.Combined"][0, 0, :3], COLOUR, rtol=1e-5)
    scene.view_layers[0].use_sky = False
    np.testing.assert_array_equal(render()["ViewLayer.Combined"][0, 0], (0, 0, 0, 1))


def test_a_layer_can_have_its_own_world(scene, world, add_camera, render):
    layer = scene.view_layers[0]
    if not hasattr(layer, "world_override"):
        pytest.skip("this Blender has one world for all layers")
    add_camera()
    layer.world_override, scene.world = scene.world, None
    np.testing.assert_allclose(render()["ViewLayer.Combined"][0, 0, :3], COLOUR, rtol=1e-5)


def test_constants_reach_the_background_through_nodes(scene, world, add_camera, render):
    add_camera()
    tree = scene.world.node_tree
    rgb, reroute = tree.nodes.new('ShaderNodeRGB'), tree.nodes.new('NodeReroute')
    rgb.outputs[0].default_value = (0.5, 0.25, 0.125, 1)
    tree.links.new(rgb.outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], world.inputs["Color"])
    np.testing.assert_allclose(render()["ViewLayer.Combined"][0, 0, :3], 1.5 * np.array((0.5, 0.25, 0.125)), rtol=1e-6)
