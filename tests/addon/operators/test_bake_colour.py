# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of bpy.ops.fastgs.bake: materials, textures, attributes, and light from Cycles."""
import bpy
import numpy as np
import pytest
from by_hand import srgb


def colours_of(model):
    """The model's colours, rounded, most frequent first."""
    values, counts = np.unique(model.features.round(3), axis=0, return_counts=True)
    return values[np.argsort(-counts)]


def test_base_colours_of_slots_and_no_material(bake, add, paint):
    cube, plain = add("cube"), add("cube", location=(4, 0, 0))
    paint(cube, (0.2, 0.4, 0.6))
    paint(cube, (0.9, 0.1, 0.0), "Second")
    for polygon in cube.data.polygons[:3]:
        polygon.material_index = 1
    found = {tuple(c) for c in colours_of(bake(cube, plain))}
    assert found == {tuple(srgb(c).round(3).astype(np.float32)) for c in ((0.2, 0.4, 0.6), (0.9, 0.1, 0.0), (0.8, 0.8, 0.8))}


@pytest.mark.parametrize(("is_float", "space"), [(False, 'sRGB'), (False, 'Non-Color'), (True, 'Linear')])
def test_image_texture_through_uv(bake, add, paint, is_float, space):
    """The left half of the picture on the left half of the plane, in its true colour whatever the image's colour space."""
    plane = add("plane", size=2)
    material, shader = paint(plane)
    image = bpy.data.images.new("Picture", 64, 64, float_buffer=is_float)
    if space in image.colorspace_settings.bl_rna.properties["name"].enum_items:
        image.colorspace_settings.name = space
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[:, :32, :3], pixels[:, 32:, :3] = (0.25, 0.5, 0.75), (0.75, 0.25, 0)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.extension = image, 'EXTEND'
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    model = bake(plane)
    left, right = (model.features[model.position[:, 0] * side > 0.15] for side in (-1, 1))
    stored_as_seen = not is_float and space == 'sRGB'
    for half, colour in ((left, (0.25, 0.5, 0.75)), (right, (0.75, 0.25, 0))):
        assert np.allclose(half, colour if stored_as_seen else srgb(colour), atol=4e-3)  # 8 bits


def test_mapping_extension_and_alpha_of_an_image(bake, add, paint):
    plane = add("plane", size=2)
    material, shader = paint(plane)
    image = bpy.data.images.new("Leaf", 8, 8, alpha=True)
    pixels = np.ones((8, 8, 4), np.float32)
    pixels[:4, :, 3] = 0
    image.pixels.foreach_set(pixels.ravel())
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, mapping, place = (nodes.new(kind) for kind in ("ShaderNodeTexImage", "ShaderNodeMapping", "ShaderNodeTexCoord"))
    texture.image, texture.interpolation = image, 'Closest'
    mapping.inputs["Location"].default_value[1] = 0.25
    links.new(place.outputs["UV"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    y = bake(plane, count=2000).position[:, 1]
    # v + 0.25 lies in the opaque upper half for v in 0.25 .. 0.75: y in -0.5 .. 0.5
    assert abs(y).max() < 0.55 and np.abs(y).mean() == pytest.approx(0.25, abs=0.02)


def test_colour_attribute_mixed_in_nodes(bake, add, paint):
    grid = add("grid", x_subdivisions=10, y_subdivisions=10, size=2)
    material, shader = paint(grid)
    attribute = grid.data.color_attributes.new("Tint", 'FLOAT_COLOR', 'POINT')
    attribute.data.foreach_set("color", np.ravel([(v.co.x * 0.5 + 0.5, 0.5, 0, 1) for v in grid.data.vertices]))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    tint, mix, path = nodes.new("ShaderNodeVertexColor"), nodes.new("ShaderNodeMix"), nodes.new("NodeReroute")
    tint.layer_name = "Tint"
    mix.data_type, mix.blend_type = 'RGBA', 'MULTIPLY'
    factor, a, b = (next(s for s in mix.inputs if s.identifier == k) for k in ("Factor_Float", "A_Color", "B_Color"))
    factor.default_value = 1.0
    b.default_value = (0.5, 0.5, 0.5, 1)
    links.new(tint.outputs["Color"], path.inputs[0])
    links.new(path.outputs[0], a)
    links.new(next(s for s in mix.outputs if s.identifier == "Result_Color"), shader.inputs["Base Color"])
    model = bake(grid)
    assert np.allclose(model.features[:, 0], srgb((model.position[:, 0] * 0.5 + 0.5) * 0.5), atol=0.05)
    assert np.allclose(model.features[:, 1], srgb(0.25), atol=1e-3)


def test_what_only_a_renderer_can_evaluate_is_named(bake, add, paint, capfd):
    cube = add("cube")
    material, shader = paint(cube, name="Marble")
    material.diffuse_color = (0.1, 0.2, 0.3, 1)
    noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
    material.node_tree.links.new(noise.outputs["Color"], shader.inputs["Base Color"])
    model = bake(cube)
    assert np.allclose(model.features, srgb((0.1, 0.2, 0.3)), atol=1e-6)
    assert 'material "Marble"' in capfd.readouterr().out


def test_light_and_shadow(bake, add, paint, scene):
    """Under a sun a floor is bright, dark where a ball hides it, and black on nobody's side that light reaches."""
    floor, ball = add("plane", size=6), add("uv_sphere", radius=0.8, location=(0, 0, 1.6))
    paint(floor, (0.5, 0.5, 0.5))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy = np.pi  # white paper at a right angle reflects 1
    scene.collection.objects.link(sun)
    model = bake(floor, lighting='CYCLES', light_samples=12, light_frames=1, count=1500)
    away = np.linalg.norm(model.position[:, :2], axis=1)
    assert np.allclose(model.features[away > 1.8], srgb(0.5), atol=0.02)
    assert model.features[away < 0.4].max() < 0.4
    assert ball.name in scene.objects
