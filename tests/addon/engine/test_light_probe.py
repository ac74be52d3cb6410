# SPDX-License-Identifier: GPL-3.0-or-later
"""*Light Probe*: meshes mirror the splats as they look from the probe's place, on every frame, and Off leaves nothing of it."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import image_files
import numpy as np
import pytest

WHITE = (1.0, 1.0, 1.0)
FRAMES = 10


@pytest.fixture
def mirror(add):
    """mirror(kind, **options): a mesh primitive that mirrors everything."""
    def make(kind, **options):
        obj = add(kind, **options)
        bpy.ops.object.shade_smooth()
        material = bpy.data.materials.new("Mirror")
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        tree = material.node_tree
        gloss = tree.nodes.new('ShaderNodeBsdfGlossy')
        gloss.inputs["Roughness"].default_value, gloss.inputs["Color"].default_value = 0.0, (1, 1, 1, 1)
        tree.links.new(gloss.outputs[0], tree.get_output_node('ALL').inputs["Surface"])
        obj.data.materials.append(material)
        return obj

    return make


@pytest.fixture
def probe(scene):
    """probe(location, radius=0.1, **settings): a light probe as the operator makes it, without Highlights."""
    def make(location=(0, 0, 0), radius=0.1, **settings):
        for obj in scene.objects:
            obj.select_set(False)
        assert bpy.ops.fastgs.add_light_probe() == {'FINISHED'}
        made = bpy.context.object
        made.location, made.empty_display_size = location, radius
        for name, value in {"highlights": 1.0, **settings}.items():
            setattr(made.fastgs.probe, name, value)
        return made

    return make


@pytest.fixture
def blob(fg, model_file, splat_object):
    """blob(start, colour=WHITE, size=1.5, way=(0, 0, 0)): an object of one round opaque splat, which goes that way in FRAMES frames."""
    def make(start, colour=WHITE, size=1.5, way=(0, 0, 0), name="Blob"):
        model = fg.GaussianModel(
            position=[start], rotation=[[1, 0, 0, 0]], scale=np.log([[size] * 3]), opacity=[8.0], features=[colour], basis=fg.Polynomial(1),
            motion=np.array([[way]], float), mu_tau=np.zeros(1), clip=fg.Clip(FRAMES, 24.0), axes="RFU")
        obj = splat_object(model_file(model, f"{name}.safetensors"), name)
        obj.fastgs.start_frame = 0
        return obj

    return make


def brightest(picture):
    """The mean column of a picture's light."""
    light = picture[..., :3].sum((0, 2))
    return (light * np.arange(len(light))).sum() / light.sum()


@pytest.mark.slow
def test_a_mirror_shows_what_is_seen_from_the_probes_place(scene, fg, make_model, model_file, splat_object, mirror, add_camera, now,
                                                          choose, render, probe, module):
    """A mirror that is turned by 20 degrees, beside the library's picture from the place and in the mirrored direction."""
    model = make_model(60, spread=4.0, opacity=np.full(60, 8.0), scale=np.log(np.random.default_rng(1).uniform(0.2, 0.4, (60, 3))))
    model = replace(model, position=model.position + np.array([7.7, -9.2, 0.5]))
    splat_object(model_file(model))
    camera = add_camera(rotation=(90, 5, 0))
    mirror("plane", size=9, rotation=(np.pi / 2, 0, np.radians(20)))
    place = np.array([0.5, -0.3, 0.4])
    probe(place, width=2048)
    choose().cycles.samples = 16
    found = render("PNG16")[..., :3]
    eye, normal = now(camera), np.array([np.sin(np.radians(20)), -np.cos(np.radians(20)), 0])
    turn = (np.eye(3) - 2 * np.outer(normal, normal)) @ np.linalg.inv(eye.world_to_camera)[:3, :3] @ np.diag([-1, 1, 1])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.T, -turn.T @ place
    seen = fg.render(model, replace(eye, world_to_camera=pose))
    wanted = np.clip(module("fastgs_blender.rendering.colour").scene_linear(seen["rgb"], seen["alpha"], "srgb")[:, ::-1], 0, 1)
    assert wanted.std() > 0.1 and np.abs(found - wanted).mean() < 0.012
    assert np.abs(found[:, ::-1] - wanted).mean() > 0.05, "another direction looks different"


@pytest.mark.slow
def test_a_chrome_ball_mirrors_the_fire_that_moves(scene, blob, mirror, add_camera, choose, probe, tmp_path):
    """In `-b -a`, with persistent data too: behind the camera a light goes from the left to the right."""
    add_camera()
    mirror("uv_sphere", radius=1.2, segments=48, ring_count=24)
    blob((-8, -8, 0), way=(16 / 0.9, 0, 0))
    probe(radius=0.1, width=256)
    choose().cycles.samples = 8
    image_files.set_output(scene, "PNG16")
    for persistent in (False, True):
        scene.render.use_persistent_data = persistent
        scene.frame_start, scene.frame_end, scene.frame_step, scene.render.filepath = 0, 9, 3, str(tmp_path / f"{persistent}")
        bpy.ops.render.render(animation=True)
        pictures = [image_files.read_png(tmp_path / f"{persistent}{frame:04d}.png") for frame in (0, 3, 6, 9)]
        columns = [brightest(picture) for picture in pictures]
        assert (np.diff(columns) > 1.5).all() and columns[0] < 29 and columns[-1] > 35
        assert max(picture[..., :3].max() for picture in pictures) > 0.9
    assert len(list(folder().glob("*.exr"))) == 2, "those of earlier frames are gone"


def folder():
    """Where the panoramas are."""
    image = next(image for image in bpy.data.images if image.source == 'SEQUENCE')
    return Path(image.filepath).parent


@pytest.mark.slow
def test_motion_blur_and_sub_frames_reach_the_mirror(scene, blob, mirror, add_camera, choose, render, probe):
    add_camera()
    mirror("uv_sphere", radius=1.2, segments=48, ring_count=24)
    blob((-8, -8, 0), size=0.6, way=(16 / 0.9, 0, 0))
    probe(width=512)
    choose().cycles.samples = 8
    places = []
    for part in (0.0, 0.5):
        scene.frame_set(4, subframe=part)
        places.append(brightest(render("PNG16")))
    assert places[1] > places[0] + 0.4
    scene.frame_set(4)
    sharp = render("PNG16")
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 3.0
    blurred = render("PNG16")
    lit = [(picture[..., :3].max(2) > 0.05).any(0).sum() for picture in (sharp, blurred)]
    assert lit[1] >= lit[0] + 2 and brightest(blurred) == pytest.approx(brightest(sharp), abs=1.0)


@pytest.mark.slow
def test_the_world_stays_where_there_are_no_splats(scene, blob, mirror, sky, add_camera, choose, render, probe):
    """It is seen by the camera, and in the mirror beside the splats; splats that the camera sees are no part of the background."""
    add_camera()
    mirror("uv_sphere", radius=0.8)
    blob((0, -9, 0), colour=(1, 0.2, 0.2))
    blob((0, 9, 0), colour=(0.2, 1, 0.2), size=1.0, name="Behind")
    choose().cycles.samples = 16
    without = render("PNG16")
    light = probe(width=256)
    with_probe = render("PNG16")
    np.testing.assert_allclose(with_probe[2, 2, :3], (0.2, 0.3, 0.4), atol=0.01)
    np.testing.assert_allclose(with_probe[:, :18], without[:, :18], atol=0.02)
    np.testing.assert_allclose(without[24, 32, :3], (0.2, 0.3, 0.4), atol=0.02)
    assert with_probe[24, 32, 0] > 0.7 and with_probe[24, 32, 1] < 0.2
    light.fastgs.probe.strength = 0.5
    assert render("PNG16")[24, 32, 0] == pytest.approx(with_probe[24, 32, 0] / 2, abs=0.05)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.4, 0.1, 0.1, 1)
    np.testing.assert_allclose(render("PNG16")[2, 2, :3], (0.4, 0.1, 0.1), atol=0.01)


@pytest.mark.slow
def test_highlights_make_white_brighter_and_grey_not(scene, blob, mirror, add_camera, choose, render, probe):
    add_camera()
    mirror("uv_sphere", radius=0.8)
    lamp = blob((0, -9, 0))
    light = probe(width=256)
    choose()
    assert render()["ViewLayer.Combined"].shape, "the passes of the splats alone are as ever"
    scene.view_settings.exposure = -3.0
    scene.view_settings.view_transform = 'Standard'
    plain = render("PNG16")[24, 32, 0]
    light.fastgs.probe.highlights = 4.0
    assert render("PNG16")[24, 32, 0] / plain > 1.3
    lamp.fastgs.exposure = -2.0
    grey = render("PNG16")[24, 32, 0]
    light.fastgs.probe.highlights = 1.0
    assert render("PNG16")[24, 32, 0] == pytest.approx(grey, abs=1e-3)


@pytest.mark.slow
def test_what_is_inside_of_the_sphere_is_left_out(blob, mirror, add_camera, choose, render, probe):
    """A splat in the ball does not cover all that the ball mirrors."""
    add_camera()
    mirror("uv_sphere", radius=0.8)
    blob((0, -9, 0), colour=(1, 0.2, 0.2))
    blob((0, -0.5, 0), colour=(0.2, 1, 0.2), size=0.15, name="Inside")
    light = probe(radius=0.8, width=256)
    choose().cycles.samples = 16
    assert render("PNG16")[24, 32, 0] > 0.7
    light.empty_display_size = 0.01
    assert render("PNG16")[24, 32, 0] < 0.2


@pytest.mark.slow
def test_off_and_deleting_take_all_of_it_away(scene, module, blob, mirror, sky, add_camera, choose, render, probe):
    kinds = ("scenes", "worlds", "images", "node_groups")
    facts, own = module("scene.sky").facts, scene.world
    add_camera()
    mirror("uv_sphere")
    blob((0, -9, 0))
    choose()
    render("PNG16")
    scene.fastgs.render_meshes = 'OFF'
    before, looks = [len(getattr(bpy.data, kind)) for kind in kinds], facts(own)
    light = probe()
    other = choose()
    render("PNG16")
    assert other.world != own and scene.world == own and facts(own) == looks and list(folder().glob("*.exr"))
    bpy.data.objects.remove(light)
    module("scene.composite").follow(scene)
    assert other.world == own and not any(image.source == 'SEQUENCE' for image in bpy.data.images)
    probe()
    module("scene.composite").follow(scene)
    assert other.world != own
    scene.fastgs.render_meshes = 'OFF'
    assert [len(getattr(bpy.data, kind)) for kind in kinds] == before and scene.world == own and facts(own) == looks


@pytest.mark.slow
def test_two_scenes_and_view_layers_have_light_of_their_own(scene, blob, mirror, add_camera, choose, probe, module, tmp_path):
    """A second view layer without the splats is not lit by them; neither is a second scene, which has other splats and its own probe."""
    add_camera()
    mirror("uv_sphere", radius=0.8)
    red = bpy.data.collections.new("Red")
    scene.collection.children.link(red)
    obj = blob((0, -9, 0), colour=(1, 0.1, 0.1))
    red.objects.link(obj)
    scene.collection.objects.unlink(obj)
    probe(width=128)
    scene.view_layers.new("Second").layer_collection.children["Red"].exclude = True
    second = scene.copy()
    second.collection.children.unlink(red)
    green = blob((0, -9, 0), colour=(0.1, 1, 0.1), name="Green")
    scene.collection.objects.unlink(green)
    second.collection.objects.link(green)
    for each in (scene, second):
        choose(of=each).cycles.samples = 8
        each.fastgs.write_passes = True
        image_files.set_output(each, "PNG16")
        each.render.filepath = str(tmp_path / f"{each.name}.png")
        bpy.ops.render.render(write_still=True, scene=each.name)
    planes = image_files.read_exr(tmp_path / f"{scene.name}_passes_0001.exr")
    meshes = "Meshes" if bpy.app.version >= (5, 0, 0) else "Mesh"
    assert planes[f"ViewLayer {meshes}.Combined"][24, 32, 0] > 0.7
    other = image_files.read_png(tmp_path / f"{second.name}.png")
    assert other[24, 32, 1] > 0.7 and other[24, 32, 0] < 0.2
    mesh_scene = module("scene.mesh_scene")
    assert mesh_scene.of(scene).world != mesh_scene.of(second).world
    scene.view_layers[0].use = False
    node = next(node for node in tree_of(scene).nodes if node.bl_idname == 'CompositorNodeRLayers' and node.scene == scene)
    node.layer = "Second"
    bpy.ops.render.render(write_still=True)
    assert image_files.read_png(scene.render.filepath)[24, 32, :3].max() < 0.05


def tree_of(scene):
    return scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree


@pytest.mark.slow
def test_nearby_reflections_come_from_the_surface(scene, screen, mirror, wall, add_camera, choose, render, probe):
    """The surface of splats is seen in the mirror where it stands, and not by the camera, which sees the splats."""
    add_camera(lens=30.0)
    mirror("plane", size=1.0, location=(0.8, -1.2, 0), rotation=(np.pi / 2, 0, -np.pi / 2 + 0.5))
    made = wall(-0.6, -0.2, (0, 1, 0), size=1.4)
    choose().cycles.samples = 16
    probe((0.8, -1.2, 0), width=128)
    assert render("PNG16")[..., 1].max() > 0.9
    made.fastgs.surface_of = screen
    picture = render("PNG16")
    seen = picture[..., 1] > 0.5
    assert seen.any() and np.flatnonzero(seen.any(0)).min() > 32, "in the mirror alone"


def test_the_operator_puts_it_around_the_active_mesh_or_at_the_cursor(scene, add):
    ball = add("uv_sphere", radius=0.5, location=(1, 2, 3))
    ball.scale = (2, 2, 2)
    assert bpy.ops.fastgs.add_light_probe() == {'FINISHED'}
    light = bpy.context.object
    bpy.context.view_layer.update()
    assert light.type == 'EMPTY' and light.parent == ball and light.empty_display_size == pytest.approx(1, abs=0.02)
    assert tuple(light.matrix_world.translation) == pytest.approx((1, 2, 3), abs=1e-5)
    ball.location.x = 4
    bpy.context.view_layer.update()
    assert light.matrix_world.translation.x == pytest.approx(4, abs=1e-5)
    scene.cursor.location = (0, 0, 7)
    assert bpy.ops.fastgs.add_light_probe() == {'FINISHED'}
    assert tuple(bpy.context.object.location) == (0, 0, 7) and bpy.context.object.parent is None


def test_a_second_probe_is_told(scene, blob, add_camera, mirror, choose, render, probe, warned):
    add_camera()
    blob((0, -9, 0))
    probe()
    probe()
    choose()
    render("PNG16")
    assert any("Light Probe.001" in text for text in warned())


def test_light_is_looked_for_in_as_many_directions_as_the_panorama_needs(scene, probe, choose, sky, module):
    """Where the world itself is of one colour and its sampling was left to Cycles, which would take seconds for each frame."""
    made, own, other = probe(width=256), scene.world, choose()

    def chosen():
        module("scene.composite").follow(scene)
        return other.world.cycles.sampling_method, other.world.cycles.sample_map_resolution

    assert chosen() == ('MANUAL', 1024), "fewer than four for each pixel make a little more noise"
    made.fastgs.probe.width = 8192
    assert chosen() == ('MANUAL', 4096), "and never more than Cycles' own"
    assert own.cycles.sampling_method == 'AUTOMATIC', "the scene's own world stays as it is"
    own.node_tree.nodes.new('ShaderNodeTexSky')
    assert chosen()[0] == 'AUTOMATIC', "Cycles knows best for what it makes"
    own.node_tree.nodes.remove(own.node_tree.nodes[-1])
    own.cycles.sampling_method = 'NONE'
    own.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    assert chosen()[0] == 'NONE'
