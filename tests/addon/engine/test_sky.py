# SPDX-License-Identifier: GPL-3.0-or-later
"""Worlds that are more than a colour: F12 and Rendered shading show what Cycles shows behind everything."""
from __future__ import annotations

import logging

import bpy
import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu
from held_runs import GUARD


@pytest.fixture(autouse=True)
def forgotten(module):
    """Every test begins without panoramas."""
    module("scene.sky").sky.stop()


@pytest.fixture
def made(module, monkeypatch):
    """The names of the worlds that another Blender has rendered."""
    sky, names = module("scene.sky"), []
    rendered = sky.Sky._rendered
    monkeypatch.setattr(sky.Sky, "_rendered", lambda self, request, folder: names.append(request.name) or rendered(self, request, folder))
    return names


@pytest.fixture
def world(scene):
    """A world with a picture of smooth colours around it, turned, and dimmed by a gradient; returns its nodes by their names."""
    world = scene.world = bpy.data.worlds.new("Evening")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    image = bpy.data.images.new("Around", 128, 64, float_buffer=True)
    x, y = np.meshgrid(np.linspace(0, 2 * np.pi, 128, endpoint=False), np.linspace(0, 1, 64))
    picture = np.stack([0.5 + 0.4 * np.sin(x), 0.5 + 0.4 * np.cos(2 * x) * y, 2 * y**2, np.ones_like(x)], -1)
    image.pixels.foreach_set(picture.astype(np.float32).ravel())
    image.pack()
    names = {"around": 'ShaderNodeTexEnvironment', "mapping": 'ShaderNodeMapping', "place": 'ShaderNodeTexCoord',
             "mix": 'ShaderNodeVectorMath'}
    nodes = {name: tree.nodes.new(kind) for name, kind in names.items()}
    nodes["around"].image = image
    nodes["mapping"].inputs["Rotation"].default_value = (0.3, 0.2, 1.0)
    nodes["mix"].operation, nodes["mix"].inputs[1].default_value = 'MULTIPLY', (0.5, 1.0, 0.8)
    links = tree.links
    links.new(nodes["place"].outputs["Generated"], nodes["mapping"].inputs["Vector"])
    links.new(nodes["mapping"].outputs["Vector"], nodes["around"].inputs["Vector"])
    links.new(nodes["around"].outputs["Color"], nodes["mix"].inputs[0])
    links.new(nodes["mix"].outputs["Vector"], tree.nodes["Background"].inputs["Color"])
    return nodes


def of_cycles(scene, render):
    """What Cycles renders of a scene without objects."""
    scene.render.engine = 'CYCLES'
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.pixel_filter_type, scene.cycles.filter_width = 4, False, 'GAUSSIAN', 0.01
    picture = render()["ViewLayer.Combined"][..., :3]
    scene.render.engine = 'FASTGS'
    return picture


@pytest.mark.slow
def test_a_world_is_rendered_in_the_cameras_directions(scene, world, module, made, make_model, model_file, splat_object, add_camera,
                                                       render):
    """Through a shifted lens, and from elsewhere; the panorama is made once for all pictures, and again when a node changes."""
    camera = add_camera(rotation=(75, 10, 35), lens=18, shift_x=0.1)
    wanted = of_cycles(scene, render)
    assert np.ptp(wanted, axis=(0, 1)).min() > 0.2
    got = render()["ViewLayer.Combined"]
    assert (got[..., 3] == 1).all()
    np.testing.assert_allclose(got[..., :3], wanted, atol=0.01)
    camera.rotation_euler = np.radians((170, 0, 80))
    np.testing.assert_allclose(render()["ViewLayer.Combined"][..., :3], of_cycles(scene, render), atol=0.01)
    model = make_model()
    splat_object(model_file(model))
    over = render()["ViewLayer.Combined"][..., :3]
    scene.render.film_transparent = True
    splats = render()["ViewLayer.Combined"]
    np.testing.assert_allclose(over, splats[..., :3] + (1 - splats[..., 3:]) * of_cycles_again(scene, module, render, camera), atol=0.02)
    assert made == ["Evening"]
    scene.render.film_transparent = False
    world["mapping"].inputs["Rotation"].default_value[2] = 2.0
    turned = render()["ViewLayer.Combined"][..., :3]
    assert made == ["Evening"] * 2 and np.abs(turned - over).max() > 0.1


def of_cycles_again(scene, module, render, camera):
    """The world without splats, from the panorama that is there."""
    sky = module("scene.sky").sky.latest()
    cameras = module("scene.camera")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sky.behind(cameras.camera_of(camera.evaluated_get(depsgraph), cameras.render_area(scene.render), depsgraph))


@pytest.mark.parametrize("orthographic", [False, True])
def test_viewports_show_the_same(module, scene, fg, make_model, model_file, orthographic):
    """Also where several groups of splats make the picture, and where the CPU draws it."""
    open_gpu(scene)
    sky, views, files = module("scene.sky"), module("engine.viewport.view"), module("scene.snapshot")
    rng = np.random.default_rng(0)
    panorama = sky.Panorama(rng.uniform(0, 2, (16, 32, 3)).astype(np.float32))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = turn * np.sign(np.linalg.det(turn))
    pose[2, 3] = 3
    camera = fg.Camera(90, 60, 70, 72, 40, 33, pose, orthographic)
    retime = module("scene.time").Retime(start_frame=0.0)
    paths = [model_file(make_model(40, spread=0.5), "a.safetensors"),
             model_file(make_model(40, 1, 0.5, colour_space="linear"), "b.safetensors")]
    display = views.Display(np.eye(3), panorama)
    for shown in ([], paths[:1], paths):
        snapshot = files.Snapshot([files.FileInstance(path, path, np.eye(4), retime) for path in shown], 0.0, 30.0)
        want = module("engine.passes").images(snapshot.load()[0], camera, [], panorama.behind(camera))["Combined"]
        view = views.View(module("engine.viewport.atlas").Atlas(), module("engine.viewport.worker").Worker())
        got = draw_offscreen(90, 60, lambda _, view=view, snapshot=snapshot: view.draw(snapshot, camera, display, wait=True))
        np.testing.assert_allclose(got, want, atol=0.03)
        np.testing.assert_allclose(got[want[..., 3] == 1].mean(0), want[want[..., 3] == 1].mean(0), atol=2e-3)
        view.free()
        by_cpu = module("engine.viewport.fallback").render(snapshot, camera, np.eye(3), panorama)[::-1]
        np.testing.assert_allclose(by_cpu, want, atol=1e-3)


def test_directions(module):
    """+Y in the middle, +X to the right of it, +Z on top; nothing jumps behind, and the poles are rows."""
    height, width = 32, 64
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    angle, lift = (u - 0.5) * 2 * np.pi, (v - 0.5) * np.pi
    directions = np.stack([np.sin(angle) * np.cos(lift), np.cos(angle) * np.cos(lift), np.sin(lift)], -1)
    panorama = module("scene.sky").Panorama(directions.astype(np.float32))
    np.testing.assert_allclose(panorama.towards(directions), directions, atol=1e-5)
    around = np.linspace(-np.pi, np.pi, 500)
    ring = np.stack([np.sin(around), np.cos(around), 0 * around], -1)
    np.testing.assert_allclose(panorama.towards(ring), ring, atol=0.01)
    assert panorama.towards(np.array([[0, 0, 1.0], [0, 0, -1.0]]))[:, 2] == pytest.approx([1, -1], abs=0.01)


def test_large_images_keep_their_detail(scene, world, module, monkeypatch):
    """A panorama is as wide as the world's widest image; it is rendered in strips, which leave no seam."""
    sky = module("scene.sky")
    request = lambda: sky.WorldRequest(bpy.context.evaluated_depsgraph_get().scene_eval.world, (1, 0.0))  # noqa: E731
    assert request().width == sky.WIDTHS[0]
    for size, width in ((5000, 8192), (8192, 8192), (16384, 16384), (40_000, 16384)):
        world["around"].image = bpy.data.images.new("Large", size, 2)
        assert request().width == width
        bpy.data.images.remove(world["around"].image)
    world["around"].image = bpy.data.images["Around"]
    monkeypatch.setattr(sky, "WIDTHS", (128, 128))
    found = []
    for strip in (sky.STRIP, 24):
        monkeypatch.setattr(sky, "STRIP", strip)
        sky.sky.stop()
        sky.sky.ask(request())
        sky.sky.wait(GUARD)
        found.append(sky.sky.latest())
    np.testing.assert_array_equal(*(panorama.values for panorama in found))
    assert found[0].values.shape == (64, 128, 3) and np.ptp(found[0].values) > 0.5
    np.testing.assert_allclose(found[0].reduced(32).mean((0, 1)), found[0].values.mean((0, 1)), rtol=1e-5)


def test_a_world_that_cannot_be_rendered_is_told_and_its_plain_colour_shown(scene, world, module, add_camera, monkeypatch, render, caplog):
    monkeypatch.setattr(module("scene.sky"), "_CHILD", "raise SystemExit('no Cycles here')")
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.2, 0.3, 1)
    add_camera()
    np.testing.assert_allclose(render()["ViewLayer.Combined"][0, 0, :3], (0.1, 0.2, 0.3), rtol=1e-5)
    told = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert any("no Cycles here" in text for text in told)
    assert any(text.startswith('The world "Evening" could not be rendered') for text in told)


def test_what_changes_a_world_changes_its_key(scene, world, module):
    """And nothing else does."""
    sky = module("scene.sky")

    def key():
        return sky.WorldRequest(bpy.context.evaluated_depsgraph_get().scene_eval.world, (1, 0.0)).key

    tree, seen = scene.world.node_tree, [key()]
    world["around"].location.x += 50
    assert key() == seen[0]
    ramp = tree.nodes.new('ShaderNodeValToRGB')
    tree.links.new(world["mix"].outputs[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], tree.nodes["Background"].inputs["Color"])
    seen.append(key())
    for change in (lambda: setattr(ramp.color_ramp.elements[0], "position", 0.3), lambda: setattr(world["mix"], "operation", 'ADD'),
                   lambda: setattr(world["around"], "mute", True), lambda: setattr(world["around"], "interpolation", 'Closest'),
                   lambda: world["mix"].inputs[1].default_value.__setitem__(0, 0.1), lambda: setattr(world["around"], "image", None)):
        change()
        seen.append(key())
    assert len(set(seen)) == len(seen)


def test_a_viewport_asks_for_a_world_as_it_is_seen_and_as_it_lights(scene, world, module, monkeypatch):
    """Each once, until the scene changes."""
    scene.world.node_tree.nodes.new('ShaderNodeLightPath')
    asked, viewports = [], module("engine.viewport.spaces").Viewports()
    monkeypatch.setattr(module("scene.sky").sky, "ask", asked.append)
    monkeypatch.setattr(viewports, "start", lambda: None)
    for light in (False, True, False):
        assert viewports._panorama(scene, scene.world, light) is None
    viewports._background(scene, scene.view_layers[0])
    assert [request.light for request in asked] == [False, True, False, False]
    assert asked[0] is asked[2] is asked[3]
