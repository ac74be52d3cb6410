# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of light in Blender, surfaces that give normals, and the compositor's node that lights splats as Scene Light does."""
import bpy
import numpy as np
import pytest
from joined import tree_of

PASSES = ("Mesh Shadow", "Mesh Shadow 2", "Lamp Light", "Lamp Light 2", "Lamp Shadow", "Contact Occlusion", "Unlit Colour", "Normal")


@pytest.fixture
def lit(scene, fg, model_file, splat_object, add, add_camera):
    """A wall of grey and red discs at y = 0 before a camera, a leaf and a cube before it, a sun and a point lamp; transparent film."""
    x, z = (axis.ravel() for axis in np.meshgrid(*[np.arange(-2, 2, 0.08)] * 2))
    wall = np.stack([x, 0 * x, z], 1)
    leaf = np.stack([0.15 * x - 0.5, 0 * x - 0.5, 0.15 * z + 0.3], 1)
    places, sizes = np.concatenate([wall, leaf]), np.repeat([0.056, 0.0084], len(x))
    colours = np.where(places[:, :1] > 0.3, [0.7, 0.3, 0.2], [0.6, 0.6, 0.6])
    model = fg.GaussianModel(position=places, rotation=np.tile([1.0, 0, 0, 0], (len(places), 1)), opacity=np.full(len(places), 6.0),
                             scale=np.log(np.stack([sizes, 0 * sizes + 1e-4, sizes], 1)), features=colours)
    add_camera(location=(0, -5, 0), rotation=(90, 0, 0))
    scene.view_settings.view_transform, scene.render.film_transparent = 'Raw', True
    obj = splat_object(model_file(model))
    add("cube", size=0.3, location=(0.6, -0.6, 0.2)).visible_camera = False
    for name, kind, place, energy in (("A", 'SUN', (0.4, -1, 0.6), 2.0), ("B", 'POINT', (0.9, -2, 0.3), 80.0)):
        lamp = bpy.data.objects.new(name, bpy.data.lights.new(name, kind))
        lamp.location, lamp.data.energy = place, energy
        if kind == 'SUN':
            lamp.data.angle = 0.0
            lamp.rotation_euler = (0.9, 0.3, 0)
        else:
            lamp.data.shadow_soft_size = 0.0
        scene.collection.objects.link(lamp)
    return obj


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def test_passes_are_delivered_and_counted(scene, lit, render):
    layer = bpy.context.view_layer
    for name in ("mesh_shadow", "lamp_light", "lamp_shadow", "contact", "unlit"):
        setattr(layer.fastgs, f"use_pass_{name}", True)
    layer.use_pass_normal = True
    images = {name.partition(".")[2] or name: image for name, image in render().items()}
    assert set(PASSES) <= set(images) and "Mesh Shadow 3" not in images
    shadow = images["Mesh Shadow 2"].squeeze()
    assert shadow.min() < 0.05 and np.median(shadow) > 0.99
    assert images["Contact Occlusion"].min() > 0.99  # the cube stands clear of the wall
    scene.objects["Cube"].location = 0.6, -0.1, 0.2
    near = next(image for name, image in render().items() if name.endswith("Contact Occlusion"))
    assert near.min() < 0.8


def test_the_node_makes_what_scene_light_makes(scene, lit, render, module):
    """To 1/255 in the median; 98 % of the pixels within 8/255 (edges mix splats in light and in shadow)."""
    look = dict(captured_light=0.3, lamp_light=0.8, shadows=0.7, unlit=0.5)
    for name, value in look.items():
        setattr(lit.fastgs, name, value)
    wanted = render("PNG16")
    for name in look:
        lit.fastgs.property_unset(name)
    plain = render("PNG16")
    assert np.array_equal(bpy.ops.fastgs.add_relight(), {'FINISHED'})
    joins = module("scene.joins")
    node = next(node for node in tree_of(scene).nodes if joins.RELIGHT in node.name)
    for name, value in zip(("Captured Light", "Lamps", "Shadows", "Unlit"), look.values()):
        node.inputs[name].default_value = value
    found = render("PNG16")
    off = np.abs(srgb(found[..., :3]) - srgb(wanted[..., :3])).max(-1)
    assert np.abs(wanted - plain).mean() > 0.02
    assert np.median(off) < 1 / 255 and np.percentile(off, 98) < 8 / 255
    assert np.allclose(found[..., 3], plain[..., 3], atol=1e-4)
    count = len(tree_of(scene).nodes)
    bpy.ops.fastgs.add_relight()
    assert len(tree_of(scene).nodes) == count  # it is there


def test_meshes_are_joined_behind_the_node(scene, lit, render, module):
    """Render With Meshes keeps it, and Off leaves it where it was."""
    bpy.ops.fastgs.add_relight()
    scene.fastgs.render_meshes = 'CYCLES'
    joins = module("scene.joins")
    joins_here = [node for node in tree_of(scene).nodes if node.bl_idname == 'CompositorNodeGroup' and joins.JOIN in node.node_tree]
    assert len(joins_here) == 1 and joins_here[0].inputs["Splats"].links[0].from_node.name.startswith(joins.RELIGHT)
    module("scene.composite").follow(scene)
    assert joins_here[0].inputs["Splats"].links[0].from_node.name.startswith(joins.RELIGHT)
    scene.fastgs.render_meshes = 'OFF'
    relight = next(node for node in tree_of(scene).nodes if node.name.startswith(joins.RELIGHT))
    assert relight.outputs[0].is_linked and relight.inputs["Mesh Shadow 2"].is_linked and not relight.inputs["Mesh Shadow 3"].is_linked


def test_a_surface_of_the_object_gives_the_normals(scene, lit, render, add):
    """A plane through the wall, tilted by 20 degrees, that counts as its surface."""
    bpy.context.view_layer.use_pass_normal = True

    def normal():
        return next(image for name, image in render().items() if name.endswith("Normal"))[24, 32]

    assert normal() == pytest.approx([0, -1, 0], abs=1e-3)
    plane = add("grid", x_subdivisions=8, y_subdivisions=8, size=1.0, rotation=(np.radians(70), 0, 0))
    plane.fastgs.surface_of, plane.fastgs.hides_splats = lit, False
    tilted = normal()
    assert tilted[1] < -0.8 and abs(tilted[2]) == pytest.approx(np.sin(np.radians(20)), abs=0.03)
