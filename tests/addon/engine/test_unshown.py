# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects and settings that FAST-GS does not render are reported, and *Set Up Composite* adds meshes through the compositor."""
from __future__ import annotations

import bpy
import numpy as np
import pytest


@pytest.fixture
def splats(fg, model_file, splat_object):
    """A screen of opaque red Gaussians at y = 0, which a camera at y = -5 sees everywhere; its object."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-3, 3, 70), np.linspace(-3, 3, 70)))
    n = len(x)
    model = fg.GaussianModel(position=np.stack([x, np.zeros(n), z], 1), rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                             scale=np.full((n, 3), -2.4), opacity=np.full(n, 6.0), features=np.tile((0.9, 0.1, 0.1), (n, 1)))
    return splat_object(model_file(model))


@pytest.fixture
def warned(caplog):
    """warned(): the sentences that the last render has told."""
    def texts():
        found = [record.message for record in caplog.records if record.levelname == "WARNING"]
        caplog.clear()
        return found

    return texts


@pytest.fixture
def shine(scene):
    """shine(obj, colour): the object's surface sends out light of this colour, whatever the lamps."""
    def make(obj, colour):
        material = bpy.data.materials.new("Shine")
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        tree = material.node_tree
        emission = tree.nodes.new('ShaderNodeEmission')
        emission.inputs["Color"].default_value = (*colour, 1)
        tree.links.new(emission.outputs[0], tree.get_output_node('ALL').inputs["Surface"])
        obj.data.materials.append(material)

    return make


def test_meshes_that_are_not_rendered_are_named_once(scene, splats, add, add_camera, warned, tmp_path):
    add_camera()
    for name in ("Chair", "Table", "Lamp", "Door", "Helper", "Hidden", "Dark"):
        add("cube").name = name
    bpy.data.objects["Helper"].display_type = 'WIRE'
    bpy.data.objects["Hidden"].hide_render = True
    bpy.data.objects["Dark"].visible_camera = False
    box = splats.fastgs.crops.add()
    box.object = bpy.data.objects["Door"]
    scene.frame_start, scene.frame_end, scene.render.filepath = 1, 3, str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    text, = warned()
    assert "meshes: Chair, Lamp, Table." in text or "Chair, Table, Lamp." in text
    box.object = None
    bpy.ops.render.render()
    assert "and 1 more" in warned()[0]


def test_settings_that_do_nothing_are_told(scene, splats, add_camera, warned):
    add_camera()
    bpy.ops.render.render()
    assert warned() == []
    splats.is_holdout = True
    bpy.ops.render.render()
    text, = warned()
    assert "Holdout" in text and splats.name in text
    splats.is_holdout = False
    inside = bpy.data.collections.new("Inside")
    scene.collection.children.link(inside)
    inside.objects.link(splats)
    bpy.context.view_layer.layer_collection.children["Inside"].holdout = True
    bpy.ops.render.render()
    assert "Holdout" in warned()[0]


@pytest.mark.parametrize("instanced", [False, True])
def test_ray_visibility(scene, splats, add_camera, render, module, instanced):
    """Off for the object, or for the one that instances it; Solid shading shows it all the same, as it shows meshes."""
    add_camera()
    scene.render.film_transparent = True
    maker = splats
    if instanced:
        inside = bpy.data.collections.new("Inside")
        inside.objects.link(splats)
        scene.collection.objects.unlink(splats)
        maker = bpy.data.objects.new("Maker", None)
        maker.instance_type, maker.instance_collection = 'COLLECTION', inside
        scene.collection.objects.link(maker)
    assert render()["ViewLayer.Combined"][..., 3].min() > 0.9
    maker.visible_camera = False
    assert not render()["ViewLayer.Combined"].any()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    take = module("scene.snapshot").take
    assert len(take(depsgraph, rendered=False).instances) == 1 and not take(depsgraph).instances


def test_the_composite_joins_meshes_by_depth(scene, splats, add, add_camera, shine, render, warned):
    """A green plane before the splats on the left, a blue one behind them on the right, a white one above that nothing hides."""
    add_camera(lens=30.0)
    scene.view_settings.view_transform = 'Raw'
    for name, place, colour in (("Before", (-1.5, -1.0, 0), (0, 1, 0)), ("Behind", (1.5, 1.0, 0), (0, 0, 1))):
        plane = add("plane", size=1.6, location=place, rotation=(np.pi / 2, 0, 0))
        plane.name = name
        shine(plane, colour)
    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)
    splats.scale = (1, 1, 0.25)  # leaves the world above and below
    alone = render("PNG16")
    assert "meshes: Before, Behind" in warned()[0]
    assert bpy.ops.fastgs.set_up_composite(engine='CYCLES') == {'FINISHED'}
    other = bpy.data.scenes[f"{scene.name} Meshes"]
    other.cycles.samples, other.cycles.use_denoising = 4, False
    picture = render("PNG16")
    assert not any("meshes" in text for text in warned())
    height, width = picture.shape[:2]
    middle = slice(height // 2 - 3, height // 2 + 3)

    def at(x):
        return picture[middle, int(width / 2 + x / 5 * 30 / 36 * width)][:, :3]

    np.testing.assert_allclose(at(-1.5 * 5 / 4), np.tile((0, 1, 0), (6, 1)), atol=0.02)
    np.testing.assert_allclose(at(1.5 * 5 / 6), alone[middle, int(width / 2 + 0.25 * 30 / 36 * width)][:, :3], atol=0.03)
    np.testing.assert_allclose(picture[2, 2, :3], (0.2, 0.3, 0.4), atol=0.02)
    np.testing.assert_allclose(picture[2, 2, :3], alone[2, 2, :3], atol=0.02)
    edge = np.abs(np.diff(picture[middle].mean(0)[:, :3], axis=0)).max()
    assert edge > 0.2, "there is something to see"
    before = alone[middle].mean(0)[:width // 2], picture[middle].mean(0)[:width // 2]
    splats_share = before[1][:, 0] / before[0][:, 0]
    green = before[1][:, 1] - splats_share * before[0][:, 1]
    np.testing.assert_allclose(splats_share + green, 1, atol=0.1, err_msg="no fringe along the edges, dark or light")

    # again: nothing is made twice, new objects come along, the user's nodes stay
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    before = sorted(node.name for node in tree.nodes)
    shine(add("plane", size=0.5, location=(0, -1, 0), rotation=(np.pi / 2, 0, 0)), (1, 1, 1))
    bpy.ops.fastgs.set_up_composite(engine='CYCLES')
    assert sorted(node.name for node in tree.nodes) == before
    assert len(bpy.data.scenes) == 2
    np.testing.assert_allclose(render("PNG16")[height // 2, width // 2, :3], 1, atol=0.02)


def test_the_composite_is_one_step_of_undo(scene, splats, add, add_camera):
    add_camera()
    add("cube")
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.fastgs.set_up_composite(engine='CYCLES')
    bpy.ops.ed.undo_push(message="Set Up Composite")
    assert bpy.context.scene.fastgs.use_meshes and len(bpy.data.scenes) == 2
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert not scene.fastgs.use_meshes and not bpy.context.view_layer.fastgs.use_pass_holdout and len(bpy.data.scenes) == 1
    assert not (scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.use_nodes)


def test_the_composite_darkens_meshes_by_the_shadows_of_splats(scene, fg, model_file, splat_object, add, add_camera, shine, render):
    """A white plane, a ball of splats beside the camera's axis, and a lamp that throws its shadow to the other side."""
    ball = fg.GaussianModel(position=[[1, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.3] * 3]), opacity=[4.0],
                            features=[[0.9, 0.1, 0.1]])
    splat_object(model_file(ball))
    add_camera(location=(0, 0, 10), rotation=(0, 0, 0), lens=36.0)
    shine(add("plane", size=40), (1, 1, 1))
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    lamp.rotation_euler.y = np.pi / 4  # from the side of x
    scene.collection.objects.link(lamp)
    scene.view_settings.view_transform, scene.fastgs.shadow_light = 'Raw', lamp
    bpy.ops.fastgs.set_up_composite(engine='CYCLES')
    other = bpy.data.scenes[f"{scene.name} Meshes"]
    other.cycles.samples, other.cycles.use_denoising = 1, False
    picture = render("PNG16")
    x, y = int(32 - 1 * 6.4), 24
    assert picture[y, x, :3].max() < 0.25 and picture[y, 60, :3].min() > 0.98
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    tree.nodes["FAST-GS Join"].inputs["Shadow Strength"].default_value = 0.0
    assert render("PNG16")[y, x, :3].min() > 0.98
    bpy.ops.fastgs.set_up_composite(engine='CYCLES')
    assert tree.nodes["FAST-GS Join"].inputs["Shadow Strength"].default_value == 0.0, "what users have set stays"


def test_the_composite_keeps_the_users_nodes(scene, splats, add, add_camera, compositor):
    add_camera()
    add("cube")
    compositor.show("Image")
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    blur = tree.nodes.new('CompositorNodeBlur')
    output = next(node for node in tree.nodes if node.inputs and not node.outputs)
    tree.links.new(compositor.layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs["Image"], output.inputs[0])
    before = {node.name for node in tree.nodes}
    bpy.ops.fastgs.set_up_composite(engine='CYCLES')
    assert before <= {node.name for node in tree.nodes}
    assert output.inputs[0].links[0].from_node == blur
    assert blur.inputs["Image"].links[0].from_node.name.startswith("FAST-GS ")
