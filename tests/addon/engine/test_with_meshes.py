# SPDX-License-Identifier: GPL-3.0-or-later
"""*Render With Meshes*: another engine renders the meshes, the compositor joins both, and nothing has to be pressed again."""
from __future__ import annotations

import bpy
import image_files
import numpy as np
import pytest
from joined import column, tree_of

MIDDLE = slice(21, 27)
"""The middle rows of a picture."""


def test_meshes_are_joined_by_depth(scene, screen, wall, sky, add_camera, choose, render, warned):
    """A green plane before the splats on the left, a blue one behind them on the right, a white one that is added later."""
    add_camera(lens=30.0)
    scene.view_settings.view_transform = 'Raw'
    wall(-1.5, -1.0, (0, 1, 0)).name = "Before"
    wall(1.5, 1.0, (0, 0, 1)).name = "Behind"
    screen.scale = (1, 1, 0.25)  # leaves the world above and below
    alone = render("PNG16")
    assert "meshes: Before, Behind" in warned()[0]
    choose()
    picture = render("PNG16")
    assert not any("meshes" in text for text in warned())
    np.testing.assert_allclose(picture[MIDDLE, column(-1.5, -1)][:, :3], np.tile((0, 1, 0), (6, 1)), atol=0.02)
    np.testing.assert_allclose(picture[MIDDLE, column(1.5, 1)][:, :3], alone[MIDDLE, column(0.25)][:, :3], atol=0.03)
    np.testing.assert_allclose(picture[2, 2, :3], (0.2, 0.3, 0.4), atol=0.02)
    np.testing.assert_allclose(picture[2, 2, :3], alone[2, 2, :3], atol=0.02)
    left = alone[MIDDLE].mean(0)[:32], picture[MIDDLE].mean(0)[:32]
    assert np.abs(np.diff(left[1][:, :3], axis=0)).max() > 0.2, "there is something to see"
    share = left[1][:, 0] / left[0][:, 0]
    green = left[1][:, 1] - share * left[0][:, 1]
    np.testing.assert_allclose(share + green, 1, atol=0.1, err_msg="no fringe along the edges, dark or light")
    wall(0, -1, (1, 1, 1), size=0.5)
    np.testing.assert_allclose(render("PNG16")[24, 32, :3], 1, atol=0.02)
    scene.render.film_transparent = True
    clear = render("PNG16")
    assert clear[2, 2, 3] == 0 and clear[24, 32, 3] > 0.99


def test_off_takes_everything_away(scene, screen, add, add_camera, choose, render):
    add_camera()
    add("cube")
    layer = bpy.context.view_layer
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("scenes", "node_groups", "objects", "collections", "worlds")}
    plain = render("PNG16")
    settings = [scene.render.film_transparent, scene.render.use_compositing, layer.use_pass_z, layer.fastgs.use_pass_holdout,
                scene.fastgs.use_meshes]
    choose()
    assert len(bpy.data.scenes) == 2
    scene.fastgs.render_meshes = 'OFF'
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before and tree_of(scene) is None
    assert settings == [scene.render.film_transparent, scene.render.use_compositing, layer.use_pass_z, layer.fastgs.use_pass_holdout,
                        scene.fastgs.use_meshes]
    np.testing.assert_array_equal(render("PNG16"), plain)


def test_a_render_that_is_under_way_keeps_its_scenes(scene, screen, add_camera, choose, module, monkeypatch):
    add_camera()
    other, composite = choose(), module("scene.composite")
    monkeypatch.setattr(composite, "_rendering", lambda: True)
    scene.fastgs.render_meshes = 'OFF'
    assert other in list(bpy.data.scenes) and composite._sync_all() > 0
    monkeypatch.setattr(composite, "_rendering", lambda: False)
    assert composite._sync_all() is None and list(bpy.data.scenes) == [scene] and tree_of(scene) is None


def test_it_is_one_step_of_undo(scene, screen, add, add_camera):
    add_camera()
    add("cube")
    bpy.ops.ed.undo_push(message="before")
    scene.fastgs.render_meshes = 'CYCLES'
    bpy.ops.ed.undo_push(message="Render With Meshes")
    assert len(bpy.data.scenes) == 2
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert scene.fastgs.render_meshes == 'OFF' and len(bpy.data.scenes) == 1 and not tree_of(scene)


def test_the_meshes_scene_is_in_step(scene, screen, add, add_camera, choose):
    """Whatever is changed after *Render With Meshes* was chosen, at the latest when a render begins, as in `blender -b`."""
    camera = add_camera()
    other = choose()
    left = bpy.data.objects.new("Left", bpy.data.cameras.new("Left"))
    scene.collection.objects.link(left)
    scene.timeline_markers.new("cut", frame=1).camera = left
    scene.render.resolution_x, scene.render.use_motion_blur, scene.render.motion_blur_shutter = 48, True, 1.25
    scene.render.motion_blur_position = 'START'
    scene.render.motion_blur_shutter_curve.curves[0].points[1].location = (0.3, 0.4)
    scene.render.use_multiview, scene.render.views_format = True, 'MULTIVIEW'
    scene.render.views.new("third").camera_suffix = "_T"
    scene.view_layers[0].name = "Renamed"
    scene.view_layers.new("Second").use = False
    bpy.ops.render.render()
    for name in ("resolution_x", "use_motion_blur", "motion_blur_shutter", "motion_blur_position", "use_multiview", "views_format"):
        assert getattr(other.render, name) == getattr(scene.render, name), name
    assert [tuple(p.location) for p in other.render.motion_blur_shutter_curve.curves[0].points] == [
        tuple(p.location) for p in scene.render.motion_blur_shutter_curve.curves[0].points]
    assert [(marker.frame, marker.camera) for marker in other.timeline_markers] == [(1, left)] and other.camera in (camera, left)
    assert other.render.views["third"].camera_suffix == "_T"
    assert {(layer.name, layer.use) for layer in other.view_layers} == {("Renamed", True), ("Second", False)}
    assert other.render.film_transparent and not scene.render.film_transparent
    scene.driver_add("render.motion_blur_shutter").driver.expression = "frame / 4"
    scene.frame_set(3)
    bpy.ops.render.render()
    assert other.animation_data.drivers[0].driver.expression == "frame / 4" and other.render.motion_blur_shutter == 0.75


def test_flags_of_collections_count_for_meshes(scene, screen, wall, add_camera, choose, render):
    """A wall in a collection that only reflects is not seen; one in a holdout hides splats and is a hole."""
    add_camera(lens=30.0)
    scene.render.film_transparent = True
    for name, x in (("Reflected", -1.5), ("Held", 1.5)):
        inside = bpy.data.collections.new(name)
        scene.collection.children.link(inside)
        obj = wall(x, -1.0, (0, 1, 0))
        inside.objects.link(obj)
        scene.collection.objects.unlink(obj)
    choose()
    layers = bpy.context.view_layer.layer_collection.children
    layers["Reflected"].indirect_only = layers["Held"].holdout = True
    picture = render("PNG16")
    assert picture[24, column(-1.5, -1), 0] > 0.7 and picture[24, column(-1.5, -1), 1] < 0.2
    assert picture[24, column(1.5, -1), 3] < 0.02


def test_splats_are_no_points_in_the_meshes_picture(scene, screen, add, add_camera, choose, tmp_path):
    """Neither the object's own nor those of a collection that is instanced, nor a native copy; a copy for shadows alone stays."""
    add_camera()
    inside = bpy.data.collections.new("Inside")
    inside.objects.link(screen)
    scene.collection.objects.unlink(screen)
    maker = bpy.data.objects.new("Maker", None)
    maker.instance_type, maker.instance_collection = 'COLLECTION', inside
    scene.collection.objects.link(maker)
    other = choose()
    scene.render.use_compositing = False
    image_files.set_output(other, "PNG")
    other.render.filepath = str(tmp_path / "meshes.png")
    bpy.ops.render.render(write_still=True, scene=other.name)
    assert not image_files.read_png(other.render.filepath)[..., 3].any()
    assert screen.visible_camera and screen.visible_shadow, "nothing of the open file is changed"


def test_each_view_layer_has_its_meshes(scene, screen, wall, add_camera, choose, render, compositor):
    add_camera(lens=30.0)
    scene.render.film_transparent = True
    near = bpy.data.collections.new("Near")
    scene.collection.children.link(near)
    obj = wall(-1.5, -1.0, (0, 1, 0))
    near.objects.link(obj)
    scene.collection.objects.unlink(obj)
    wall(1.5, -1.0, (0, 0, 1))
    second = scene.view_layers.new("Second")
    second.layer_collection.children["Near"].exclude = True
    tree = tree_of(scene)
    also = tree.nodes.new('CompositorNodeRLayers')
    also.scene, also.layer = scene, "Second"
    blur = tree.nodes.new('CompositorNodeBlur')
    tree.links.new(also.outputs["Image"], blur.inputs["Image"])
    compositor.show("Image")
    choose()
    output = next(node for node in tree.nodes if node.inputs and not node.outputs)
    first = render("PNG16")
    assert first[24, column(-1.5, -1), 1] > 0.9 and first[24, column(1.5, -1), 2] > 0.9
    tree.links.new(blur.inputs["Image"].links[0].from_socket, output.inputs[0])
    picture = render("PNG16")
    assert picture[24, column(-1.5, -1), 1] < 0.2 and picture[24, column(1.5, -1), 2] > 0.9


def test_a_copied_scene_gets_meshes_of_its_own(scene, screen, wall, add_camera, choose, module):
    add_camera()
    wall(0, -1.0, (0, 1, 0))
    other = choose()
    copy = scene.copy()
    module("scene.composite").follow(copy)
    mine = module("scene.mesh_scene").of(copy)
    assert mine not in (None, other) and len(bpy.data.scenes) == 4
    for owner, meshes in ((scene, other), (copy, mine)):
        shown = {node.scene for node in tree_of(owner).nodes if node.bl_idname == 'CompositorNodeRLayers'}
        assert shown == {owner, meshes}


@pytest.mark.parametrize("y", [-1.0, 1.0])
def test_what_lets_light_through_lies_over_the_splats(scene, screen, wall, add_camera, choose, render, y):
    """A green wall of alpha 0.4 before the splats, and one behind them, which these hide."""
    add_camera()
    alone = render("PNG16")[24, 32, :3]
    wall(0, y, (0, 1, 0), alpha=0.4)
    choose().cycles.samples = 64
    expected = 0.6 * alone + 0.4 * np.array((0, 1, 0)) if y < 0 else alone
    np.testing.assert_allclose(render("PNG16")[20:28, 28:36, :3].mean((0, 1)), expected, atol=0.03)


def test_both_eyes_have_meshes(scene, screen, wall, add_camera, choose, render):
    add_camera(lens=30.0)
    wall(0, -3.0, (0, 1, 0), size=0.5)
    scene.render.use_multiview = True
    choose()
    scene.render.image_settings.views_format = 'STEREO_3D'
    scene.render.image_settings.stereo_3d_format.display_mode = 'SIDEBYSIDE'
    picture = render("PNG16")
    half = picture.shape[1] // 2
    for eye in (picture[:, :half], picture[:, half:]):
        assert (eye[24, :, 1] > 0.9).any()


def test_a_shadow_takes_the_light_of_its_lamp_alone(scene, fg, model_file, splat_object, add, paint, sky, add_camera, choose, render):
    """A white plane under two suns and a world: where the ball keeps one's light it is as bright as without this one."""
    ball = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.3] * 3]), opacity=[9.0],
                            features=[[0.9, 0.1, 0.1]])
    splat_object(model_file(ball))
    add_camera(location=(0, 0, 10), rotation=(0, 0, 0), lens=36.0)
    paint(add("plane", size=40))[1].inputs["Specular IOR Level"].default_value = 0  # as bright from every side
    lamps = {}
    for name, angle, colour in (("Left", -np.pi / 4, (1, 0.2, 0.2)), ("Right", np.pi / 4, (0.2, 0.2, 1))):
        lamp = lamps[name] = bpy.data.objects.new(name, bpy.data.lights.new(name, 'SUN'))
        lamp.rotation_euler.y, lamp.data.color, lamp.data.energy, lamp.fastgs.splat_shadow = angle, colour, 0.5, True
        scene.collection.objects.link(lamp)
    scene.fastgs.shadow_samples = 4
    choose().cycles.samples = 16
    lit, planes = render("PNG16"), render()
    for name, x, number in (("Left", 2, ""), ("Right", -2, " 2")):
        y, x, through = 24, int(32 + x * 6.4), planes[f"ViewLayer.Splat Shadow{number}"][..., 0]
        lamps[name].data.energy = 0
        dark = render("PNG16")
        lamps[name].data.energy = 0.5
        sun = lit[y, 60, :3] - dark[y, 60, :3]
        assert dark[y, x].min() > 0.05 and sun.max() > 0.08 and through[y, x] < 0.5
        np.testing.assert_allclose(lit[y, x, :3], dark[y, x, :3] + through[y, x] * sun, atol=0.02)
    nodes = [node for node in tree_of(scene).nodes if node.name.startswith("FAST-GS Shade")]
    assert {node.label for node in nodes} == {"Left", "Right"}
    for node in nodes:
        node.inputs["Shadow Strength"].default_value = 0.0
    np.testing.assert_allclose(render("PNG16")[24, int(32 - 2 * 6.4), :3], lit[24, 60, :3], atol=0.02)
    lamps["Left"].fastgs.splat_shadow = False
    bpy.ops.render.render()
    assert [node.label for node in tree_of(scene).nodes if node.name.startswith("FAST-GS Shade")] == ["Right"]


def test_the_light_that_a_shadow_takes_is_denoised_too(scene, fg, model_file, splat_object, add, paint, add_camera, choose, render):
    """Engines denoise their picture, and not the light of one lamp: a shadow would be full of its noise."""
    ball = fg.GaussianModel(position=[[0, 0, 2.0]], rotation=[[1, 0, 0, 0]], scale=np.log([[0.5] * 3]), opacity=[9.0],
                            features=[[0.9, 0.1, 0.1]])
    splat_object(model_file(ball))
    add_camera(location=(0, 0, 10), rotation=(0, 0, 0), lens=36.0)
    paint(add("plane", size=40))
    lamp = bpy.data.objects.new("Area", bpy.data.lights.new("Area", 'AREA'))
    lamp.location, lamp.rotation_euler, lamp.data.energy, lamp.data.size = (-3, 0, 5), (0, -0.54, 0), 400, 3.0
    lamp.fastgs.splat_shadow = True
    scene.collection.objects.link(lamp)
    cycles, noise = choose().cycles, []
    cycles.samples = 4
    for cycles.use_denoising in (False, True):
        pictures = [render("PNG16")[16:32, 36:60, 1] for cycles.seed in (0, 1)]
        noise.append(np.abs(pictures[1] - pictures[0]).mean())
    assert noise[1] < 0.4 * noise[0]


def test_a_shadow_catcher_lays_the_shadows_of_meshes_over_splats(scene, screen, add, sky, add_camera, choose, render):
    """A box between a sun and the screen, which stands just before a catcher, or well before it."""
    add_camera(lens=30.0)
    alone = render("PNG16")
    catcher = add("plane", size=20, location=(0, 0.1, 0), rotation=(np.pi / 2, 0, 0))
    catcher.is_shadow_catcher = True
    add("cube", size=0.8, location=(1.2, -1.5, 0))
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    lamp.rotation_euler, lamp.data.energy, lamp.data.angle = (np.pi / 2, 0, np.pi / 4), 20.0, 0.0
    scene.collection.objects.link(lamp)
    choose().cycles.samples = 16
    shadow, free = (slice(22, 26), column(-0.3) - 1), (slice(22, 26), 3)
    picture = render("PNG16")
    assert picture[shadow][:, 0].max() < 0.4 * alone[shadow][:, 0].min()
    np.testing.assert_allclose(picture[free][:, 0], alone[free][:, 0], rtol=0.05)
    assert (picture[..., 3] == 1).all()
    catcher.location.y = 0.6
    np.testing.assert_allclose(render("PNG16")[shadow], alone[shadow], atol=0.02)


def test_a_mesh_behind_splats_does_not_leak_at_the_edge_of_one_before_them(scene, screen, wall, add_camera, choose, render):
    """A turned green square before red splats before a blue wall, of which nothing is seen."""
    add_camera(lens=30.0)
    square = wall(0, -1.0, (0, 1, 0), size=2.0)
    square.rotation_euler.y = 0.3
    wall(0, 1.0, (0, 0, 1), size=20)
    choose().cycles.samples = 32
    picture = render("PNG16")
    assert picture[..., 1].max() > 0.99 and picture[..., 2].max() < 0.03
    green, red = picture[..., 1], picture[..., 0] / np.median(picture[:, :8, 0])
    np.testing.assert_allclose((green + red)[4:-4, 8:-8], 1, atol=0.25)  # the red screen is no even surface
    for frame, x in ((0, -0.6), (2, 0.6)):
        square.location.x = x
        square.keyframe_insert("location", frame=frame)
    scene.render.use_motion_blur = True
    assert render("PNG16")[24, :, 1].max() > 0.3 and render("PNG16")[..., 2].max() < 0.16


def test_two_scenes_in_one_compositor(scene, screen, wall, add_camera, choose, render, compositor):
    """The compositor puts one scene over another; each has meshes of its own."""
    add_camera(lens=30.0)
    scene.render.film_transparent = True
    wall(-1.5, -1.0, (0, 1, 0))
    over = scene.copy()
    bpy.context.window.scene = over
    for obj in list(over.collection.objects):
        if obj.type != 'CAMERA':
            over.collection.objects.unlink(obj)
    blue = wall(1.5, -1.0, (0, 0, 1))
    assert blue.name in over.objects and blue.name not in scene.objects
    bpy.context.window.scene = scene
    compositor.show("Image")
    tree = tree_of(scene)
    layers = tree.nodes.new('CompositorNodeRLayers')
    layers.scene = over
    node = tree.nodes.new('CompositorNodeAlphaOver')
    output = next(each for each in tree.nodes if each.inputs and not each.outputs)
    for image, socket in zip((compositor.layers, layers), (socket for socket in node.inputs if socket.type == 'RGBA')):
        tree.links.new(image.outputs["Image"], socket)
    tree.links.new(node.outputs[0], output.inputs[0])
    choose()
    choose(of=over)
    assert (compositor.layers.scene, layers.scene) == (scene, over)
    picture = render("PNG16")
    assert picture[24, column(-1.5, -1), 1] > 0.95 and picture[24, column(1.5, -1), 2] > 0.95
    over.fastgs.render_meshes = 'OFF'
    picture = render("PNG16")
    assert picture[24, column(-1.5, -1), 1] > 0.95 and picture[24, column(1.5, -1), 2] < 0.2


def test_the_users_nodes_stay(scene, screen, add, add_camera, compositor, choose):
    add_camera()
    add("cube")
    compositor.show("Image")
    tree = tree_of(scene)
    blur = tree.nodes.new('CompositorNodeBlur')
    output = next(node for node in tree.nodes if node.inputs and not node.outputs)
    tree.links.new(compositor.layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs["Image"], output.inputs[0])
    before = {node.name for node in tree.nodes}
    choose()
    assert before <= {node.name for node in tree.nodes}
    assert output.inputs[0].links[0].from_node == blur
    assert blur.inputs["Image"].links[0].from_node.name.startswith("FAST-GS ")
    scene.fastgs.render_meshes = 'OFF'
    assert {node.name for node in tree.nodes} == before and blur.inputs["Image"].links[0].from_node == compositor.layers


def test_names_of_blender_4_are_short_and_each_its_own(module):
    layers = ["ViewLayer", "ViewLayer Mesh", "The long road home", "The long road away"]
    names = [f"{layer}.{name}" for layer in layers for name in ("Depth", "CryptoObject00", "CryptoObject01")]
    found = module("scene.passes_file").fitted(names)
    assert len(set(found)) == len(names) and max(map(len, found)) <= 29 and found[:6] == names[:6]


@pytest.mark.slow
def test_all_passes_are_in_one_file(scene, screen, wall, add_camera, choose, module, tmp_path):
    """The picture, the splats' passes and those of the meshes, with their names for Cryptomatte, beside the scene's own picture."""
    import OpenEXR

    add_camera(lens=30.0)
    wall(-1.5, -1.0, (0, 1, 0)).name = "Wall"
    layer, meshes = scene.view_layers[0], choose().view_layers[0]
    layer.use_pass_mist = layer.use_pass_cryptomatte_object = True
    lights = {entry.switch.removeprefix("fastgs.") for entry in module("fastgs_blender.rendering.passes").PASSES.values() if entry.light}
    for switch in lights:
        setattr(layer.fastgs, switch, True)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    scene.collection.objects.link(sun)
    sun.rotation_euler.x, sun.data.energy = np.pi / 2, 2.0  # from behind the camera
    meshes.use_pass_normal = meshes.use_pass_emit = meshes.use_pass_cryptomatte_object = True
    before = len(tree_of(scene).nodes)
    scene.fastgs.write_passes = True
    image_files.set_output(scene, "PNG16")
    scene.render.filepath = str(tmp_path / "shot.png")
    bpy.ops.render.render(write_still=True)
    assert (tmp_path / "shot.png").is_file()
    path = tmp_path / "shot_passes_0001.exr"
    planes, (y, x) = image_files.read_exr(path), (24, column(-1.5, -1))
    made, light = ("ViewLayer Meshes", "Emission") if bpy.app.version >= (5, 0, 0) else ("ViewLayer Mesh", "Emit")
    for name, value in (("Composite.Combined", (0, 1, 0, 1)), ("ViewLayer.Combined", (0, 0, 0, 0)), ("ViewLayer.Splat Holdout", 1),
                        (f"{made}.Depth", 4), (f"{made}.Normal", (0, -1, 0))):
        np.testing.assert_allclose(planes[name][y, x], value, atol=1e-3, err_msg=name)
    np.testing.assert_allclose(planes[f"{made}.{light}"][y, x, :3], (0, 1, 0), atol=1e-3)
    assert planes["ViewLayer.Depth"][y, 60, 0] == pytest.approx(5, abs=0.1) and 0 < planes["ViewLayer.Mist"][y, 60, 0] < 1
    assert planes[f"{made}.CryptoObject00"][y, x, 1] == 1
    assert planes["ViewLayer.Lamp Light"][y, 60, :3] == pytest.approx(2 / np.pi, abs=0.02)
    kept = None if bpy.app.version >= (5, 0, 0) else 14
    assert all(f"ViewLayer.{name[:kept]}" in planes for name in ("Mesh Shadow", "Lamp Shadow", "Contact Occlusion"))
    with OpenEXR.File(str(path), separate_channels=True) as file:
        manifests = {name: value for part in file.parts for name, value in part.header.items() if name.endswith("/manifest")}
    assert any("Wall" in text for text in manifests.values()) and any(screen.name in text for text in manifests.values())
    scene.fastgs.write_passes = False
    assert len(tree_of(scene).nodes) == before
    scene.fastgs.write_passes = True
    scene.fastgs.render_meshes = 'OFF'
    assert tree_of(scene) is None
