# SPDX-License-Identifier: GPL-3.0-or-later
"""A viewport's state: what it draws while it waits for an order, when it asks for a new one, and what it does when the GPU fails."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu
from held_runs import GUARD, until


@pytest.fixture
def worker(module):
    worker = module("engine.viewport.worker").Worker()
    yield worker
    worker.stop()


@pytest.fixture
def view(module, scene, worker):
    open_gpu(scene)
    view = module("engine.viewport.view").View(module("engine.viewport.atlas").Atlas(), worker)
    yield view
    view.free()


@pytest.fixture
def snapshot(module):
    """snapshot(*paths, at=0.0): objects that show these files, on a frame."""
    scene, retime = module("scene.snapshot"), module("scene.time").Retime(start_frame=0.0)

    def make(*paths, at=0.0):
        return scene.Snapshot([scene.FileInstance(path, path, np.eye(4), retime) for path in paths], at, 30.0)

    return make


@pytest.fixture
def eye(module):
    """eye(turn=0, size=(96, 64)): the camera of a region that looks at the origin from 4 units away."""

    def make(turn=0.0, size=(96, 64), orthographic=False):
        view = np.array([[np.cos(turn), 0, np.sin(turn), 0], [0, 1, 0, 0], [-np.sin(turn), 0, np.cos(turn), -4], [0, 0, 0, 1.0]])
        wide = size[0] / size[1]
        if orthographic:
            window = np.array([[0.5 / wide, 0, 0, 0.1], [0, 0.5, 0, -0.05], [0, 0, -0.01, 0], [0, 0, 0, 1]])
        else:
            window = np.array([[1.8 / wide, 0, 0.1, 0], [0, 1.8, -0.05, 0], [0, 0, -1.002, -0.2], [0, 0, -1, 0]])
        return module("engine.viewport.eye").eye(*size, view, window)[0]

    return make


@pytest.fixture
def draw(module, view):
    """draw(snapshot, camera, **options): the view's picture [h, w, 4]."""
    display = module("engine.viewport.view").Display(np.eye(3))
    return lambda snapshot, camera, **options: draw_offscreen(
        camera.width, camera.height, lambda framebuffer: view.draw(snapshot, camera, display, **options))


@pytest.fixture
def expected(module):
    """The final render's picture of a snapshot."""

    def picture(snapshot, camera):
        return module("engine.passes").images(snapshot.load()[0], camera, [])["Combined"]

    return picture


def psnr(a, b):
    return -10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2) + 1e-20)


def settle(view):
    """Wait until the thread has answered."""
    until(lambda: not view.waiting)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_region_shows_what_the_camera_of_its_matrices_renders(fg, make_model, model_file, snapshot, eye, draw, expected, orthographic):
    path = model_file(make_model(200))
    camera = eye(orthographic=orthographic)
    got = draw(snapshot(path), camera, wait=True)
    assert psnr(got, expected(snapshot(path), camera)) > 45 and got[..., 3].max() > 0.5


def test_the_window_is_the_matrices(module, eye):
    """Points are where the region's matrices put them, and so is their depth."""
    view = np.array([[0.8, 0, 0.6, 0.3], [0, 1, 0, -0.2], [-0.6, 0, 0.8, -4], [0, 0, 0, 1]])
    points = np.c_[np.random.default_rng(0).uniform(-1, 1, (20, 3)), np.ones(20)]
    for window in (np.array([[1.5, 0, 0.1, 0], [0, 2, -0.2, 0], [0, 0, -1.002, -0.2], [0, 0, -1, 0]]),
                   np.array([[0.3, 0, 0, 0.1], [0, 0.4, 0, -0.2], [0, 0, -0.01, 0.0], [0, 0, 0, 1]])):
        camera, depths = module("engine.viewport.eye").eye(100, 50, view, window)
        clip = points @ view.T @ window.T
        ndc = clip[:, :3] / clip[:, 3:]
        x, y, z = (points @ camera.world_to_camera.T)[:, :3].T
        scale = 1 if camera.orthographic else 1 / z
        np.testing.assert_allclose(camera.fx * x * scale + camera.cx, 50 * (1 + ndc[:, 0]))
        np.testing.assert_allclose(camera.fy * y * scale + camera.cy, 25 * (1 - ndc[:, 1]))
        np.testing.assert_allclose(depths.a + depths.b * (z if camera.orthographic else 1 / z), 0.5 + 0.5 * ndc[:, 2])
        assert (z > camera.near).all()


@pytest.mark.parametrize("orthographic", [False, True])
def test_through_a_camera_the_final_picture_is_part_of_the_region(module, scene, fg, make_model, model_file, snapshot, draw, add_camera,
                                                                  orthographic):
    """Zoomed out, off-centre: what lies within the camera's frame is F12's picture, splats outside of it included."""
    import bpy

    kind = {"type": 'ORTHO', "ortho_scale": 1.5} if orthographic else {"lens": 60}
    camera = add_camera(location=(0, -2, 0), **kind)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    wanted = module("scene.camera").camera_of(camera, module("scene.camera").render_area(scene.render), depsgraph)
    projection = np.array(camera.calc_matrix_camera(depsgraph, x=64, y=48))
    # a region of 160 x 144 that shows the 64 x 48 pixels of the frame from 40, 24 on, pixel by pixel
    zoom = np.diag([64 / 160, 48 / 144, 1, 1])
    zoom[0, 3], zoom[1, 3] = 2 * (40 + 32) / 160 - 1, 2 * (24 + 24) / 144 - 1
    window, eyes = zoom @ projection, module("engine.viewport.eye")
    frame = eyes.frame_in(window, projection)
    np.testing.assert_allclose(frame, (40 / 160, 24 / 144, 104 / 160, 72 / 144), atol=1e-6)
    eye, _ = eyes.eye(160, 144, np.linalg.inv(np.array(camera.matrix_world)), window, frame=frame)
    np.testing.assert_allclose(eye.tangent_limits(), wanted.tangent_limits(), atol=1e-5)
    path = model_file(make_model(200, spread=1.5))
    want = module("engine.passes").images(snapshot(path).load()[0], wanted, [])["Combined"]
    got = draw(snapshot(path), eye, wait=True)[144 - 72:144 - 24, 40:104]
    assert want[..., 3].max() > 0.5 and psnr(got, want) > 45


def test_drawing_never_waits_and_catches_up(fg, make_model, model_file, snapshot, eye, draw, view, expected):
    path = model_file(make_model(200))
    first = draw(snapshot(path), eye())
    assert not first.any(), "nothing is known yet"
    settle(view)
    assert view.stale
    np.testing.assert_array_equal(draw(snapshot(path), eye()), draw(snapshot(path), eye()))
    assert not view.stale and not view.waiting
    turned = draw(snapshot(path), eye(2.5))
    assert turned.any(), "the last order serves until the new one is there"
    settle(view)
    assert view.stale
    assert psnr(draw(snapshot(path), eye(2.5)), expected(snapshot(path), eye(2.5))) > 45


def test_time_needs_no_new_data(module, fg, make_model, model_file, snapshot, eye, draw, view, expected):
    sent = module("engine.viewport.textures").Sent
    model = make_model(400, motion=np.random.default_rng(1).normal(0, 0.3, (400, 10, 3)), basis=fg.Fourier(5), clip=fg.Clip(30))
    path = model_file(model)
    draw(snapshot(path), eye(), wait=True)
    for at in (3.25, 17.0):
        before = sent.bytes
        assert psnr(draw(snapshot(path, at=at), eye(), wait=True), expected(snapshot(path, at=at), eye())) > 45
        assert 0 < sent.bytes - before < 30_000


def test_density_while_moving_and_everything_when_still(module, fg, make_model, model_file, snapshot, eye, draw, view, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(module("engine.viewport.view"), "time", SimpleNamespace(monotonic=lambda: now[0]))
    path = model_file(make_model(300))
    draw(snapshot(path), eye(), wait=True, density=0.25)
    assert view._order[1].count > 200
    draw(snapshot(path), eye(0.3), wait=True, density=0.25)
    assert view.coarse and view._order[1].count <= 75
    now[0] += 2 * module("engine.viewport.view").RESTING
    draw(snapshot(path), eye(0.3), wait=True, density=0.25)
    assert not view.coarse and view._order[1].count > 200
    draw(snapshot(path), eye(0.3), wait=True, density=0.25, playing=True)
    assert view._order[1].count <= 75


def test_objects_come_and_go(make_model, model_file, snapshot, eye, draw, view, expected):
    one, two = model_file(make_model(50), "one.safetensors"), model_file(make_model(60, seed=1), "two.safetensors")
    for shown in (snapshot(one), snapshot(one, two), snapshot(two), snapshot(), snapshot(two, one, two)):
        got = draw(shown, eye(), wait=True)
        assert psnr(got, expected(shown, eye())) > 45 if shown.instances else not got.any()


def test_a_reloaded_file_is_drawn_anew(module, make_model, model_file, snapshot, eye, draw, expected):
    path = model_file(make_model(50))
    first = draw(snapshot(path), eye(), wait=True)
    model_file(make_model(50, seed=3))
    module("scene.objects").reload(path)
    second = draw(snapshot(path), eye(), wait=True)
    assert psnr(second, expected(snapshot(path), eye())) > 45 > psnr(second, first)


def test_a_missing_file_is_told_and_the_rest_drawn(make_model, model_file, snapshot, eye, draw, view, expected):
    path = model_file(make_model(50))
    got = draw(snapshot(path, "/nowhere/x.ply"), eye(), wait=True)
    draw(snapshot(path, "/nowhere/x.ply"), eye())
    assert "/nowhere/x.ply" in view.trouble
    assert psnr(got, expected(snapshot(path), eye())) > 45


def test_the_cpu_draws_where_shaders_do_not_compile(module, make_model, model_file, snapshot, eye, draw, view, expected, monkeypatch):
    def broken(*kind):
        raise Exception("Shader Compile Error")  # noqa: TRY002 (what Blender raises)

    monkeypatch.setattr(module("engine.viewport.shaders"), "splats", broken)
    path = model_file(make_model(100))
    draw(snapshot(path), eye(), wait=True)
    assert "CPU" in view.trouble
    draw(snapshot(path), eye(), wait=True)
    assert psnr(draw(snapshot(path), eye(), wait=True), expected(snapshot(path), eye())) > 45


def test_the_cpu_draws_both_colour_spaces_as_the_final_render_does(module, make_model, model_file, snapshot, eye):
    one = model_file(make_model(60), "encoded.safetensors")
    two = model_file(make_model(60, seed=1, colour_space="linear"), "linear.safetensors")
    shown, camera = snapshot(one, two), eye()
    want = module("engine.passes").images(shown.load()[0], camera, [], (0.1, 0.2, 0.3))["Combined"]
    got = module("engine.viewport.fallback").render(shown, camera, module("scene.colour").rec709_to_working(), (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(got[::-1], want)


@pytest.fixture
def data(module):
    """data(name): a pass to show, with its defaults."""
    settings = module("fastgs_blender.rendering.passes").DEFAULTS
    return lambda name, state=(): module("engine.viewport.fallback").DataPass(name, settings, None, state)


@pytest.fixture
def at_rest(module, monkeypatch):
    """No view counts as moving."""
    monkeypatch.setattr(module("engine.viewport.view"), "RESTING", -1.0)


@pytest.mark.slow
def test_passes_are_shown_in_their_false_colours(module, fg, make_model, model_file, snapshot, eye, draw, view, expected, data, at_rest):
    """Each pass is the final one; the picture comes back as the GPU draws it."""
    table, linear = module("fastgs_blender.rendering.passes").PASSES, module("fastgs_blender.rendering.colour").srgb_to_linear
    path = model_file(make_model(200, motion=np.random.default_rng(1).normal(0, 0.1, (200, 10, 3)), basis=fg.Fourier(5), clip=fg.Clip(30)))
    for name in ("depth", "normal", "cryptomatte_00", "count", "vector", "depth"):
        got = draw(snapshot(path), eye(), wait=True, data=data(name))
        image = fg.render(snapshot(path).load()[0], eye(), passes=[name])[name]
        assert got[..., :3] == pytest.approx(linear(table[name].display(image)), abs=2e-3) and (got[..., 3] == 1).all()
        assert got[..., :3].std() > 0.01 and view.as_final and view.shows
    assert psnr(draw(snapshot(path), eye(), wait=True), expected(snapshot(path), eye())) > 45
    assert not view.as_final and view.shows and not view.stale


def test_passes_are_coarse_while_the_view_moves(module, make_model, model_file, snapshot, eye, draw, view, data, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(module("engine.viewport.view"), "time", SimpleNamespace(monotonic=lambda: now[0]))
    path, coarse = model_file(make_model(100)), module("engine.viewport.fallback").COARSE
    draw(snapshot(path), eye(), wait=True, data=data("mist"))
    assert not view.coarse and view.fallback._values.shape == (64, 96, 4)
    for turned in (0.2, 0.3):
        draw(snapshot(path), eye(turned), data=data("mist"))
        settle(view)
        assert view.stale and view.coarse and view.fallback._values.shape == (64 // coarse, 96 // coarse, 4)
    now[0] += 2 * module("engine.viewport.view").RESTING
    draw(snapshot(path), eye(0.3), data=data("mist"))
    settle(view)
    assert draw(snapshot(path), eye(0.3), data=data("mist"))[..., :3].std() > 0.01
    assert not view.coarse and not view.stale and view.fallback._values.shape == (64, 96, 4)
    asked = view._asked
    draw(snapshot(path), eye(0.3), data=data("mist"))
    assert view._asked is asked, "a still pass is rendered once"


def test_the_menu_of_passes_has_each_of_blenders_once(module, scene):
    table, passes = module("fastgs_blender.rendering.passes").PASSES, module("engine.passes")
    items = module("scene.properties").FASTGS_PG_shading.bl_rna.properties["render_pass"].enum_items
    assert items[0].identifier == 'COMBINED' and len({item.name for item in items}) == len(items) and all(i.description for i in items)
    assert {p.blender for p in table.values() if not p.level and not p.colour} == {table[i.identifier.lower()].blender for i in items[1:]}

    def of(chosen):
        return passes.in_viewport(SimpleNamespace(fastgs=SimpleNamespace(render_pass=chosen)), scene)

    shown = {item.identifier: of(item.identifier) for item in items}
    assert shown['COMBINED'] is None and shown['DEPTH'] == "depth" and shown['CRYPTOMATTE_00'] == "cryptomatte_00"
    scene.fastgs.depth = 'MEDIAN'
    assert of('DEPTH') == "median_depth"


def test_a_broken_transform_keeps_no_other_object_from_the_gpu(module, make_model, model_file, snapshot, eye, draw, view, expected):
    path, other = model_file(make_model(50)), model_file(make_model(50, seed=1), "other.safetensors")
    shown = snapshot(path, other)
    shown.instances[1].placement[0, 3] = np.nan
    assert psnr(draw(shown, eye(), wait=True), expected(snapshot(path), eye())) > 45
    assert not view.fallback.needed and 'other.safetensors": ' in view.trouble and "transform" in view.trouble


def test_the_latest_wish_wins(worker):
    """Of what an owner asks for while the thread is busy, only the last is done."""
    import threading

    class Owner:
        def __init__(self):
            self.answers, self.errors = [], []

        def done(self, answer):
            self.answers.append(answer)

        def failed(self, error):
            self.errors.append(error)

    owner, other, gate, begun = Owner(), Owner(), threading.Event(), threading.Event()
    worker.ask(owner, lambda: (begun.set(), gate.wait(GUARD), "first")[2])
    assert begun.wait(GUARD)
    worker.ask(owner, lambda: "second")
    worker.ask(owner, lambda: "third")
    worker.ask(other, lambda: 1 / 0)
    assert worker.busy(owner) and worker.busy(other)
    gate.set()
    until(lambda: other.errors and len(owner.answers) == 2)
    until(lambda: not worker.busy(other))
    assert not worker.busy(owner) and not worker.busy(other)
    assert owner.answers == ["first", "third"] and isinstance(other.errors[0], ZeroDivisionError)
    worker.stop()
    worker.ask(owner, lambda: "after a stop")
    until(lambda: len(owner.answers) == 3)
    assert owner.answers[2] == "after a stop"


def test_models_that_nobody_shows_leave_the_gpu(module, fg, make_model, scene):
    open_gpu(scene)
    atlas = module("engine.viewport.atlas").Atlas()
    one, two, three = (make_model(50, seed=seed) for seed in range(3))
    atlas.upload([one, two])
    atlas.upload([three], keep=[one])
    assert atlas.has([one, three]) and not atlas.has([two])
    assert atlas.nbytes > 0
    atlas.clear()
    assert atlas.nbytes == 0 and not atlas.has([one]) and atlas.geometry is None


def test_the_gpu_holds_nothing_when_the_last_object_is_gone(make_model, model_file, snapshot, eye, draw, view):
    path = model_file(make_model(50))
    draw(snapshot(path), eye(), wait=True)
    assert view.atlas.nbytes > 0
    assert not draw(snapshot(), eye(), wait=True).any()
    assert view.atlas.nbytes == 0
    assert draw(snapshot(path), eye(), wait=True).any()


def test_replaced_textures_are_freed(module, make_model, model_file, snapshot, eye, draw, view):
    """Not even the picture that was drawn from them holds them."""
    import gc
    import sys

    draw(snapshot(model_file(make_model(50))), eye(), wait=True)
    texture = view.atlas.geometry
    view.atlas.upload([make_model(9000)])
    gc.collect()
    assert sys.getrefcount(texture) == 2


def test_a_model_too_large_for_textures_is_refused(module, fg, make_model, scene, monkeypatch):
    atlas = module("engine.viewport.atlas")
    monkeypatch.setattr(atlas, "ROWS", 0)
    with pytest.raises(atlas.TooLarge):
        atlas.Atlas().upload([make_model(5)])


def test_viewport_visibility_is_asked_for_objects_and_instancers(module, scene, make_model, model_file, splat_object):
    import bpy

    path = model_file(make_model(5))
    inside = bpy.data.collections.new("Inside")
    splat_object(path, "Instanced", collection=inside)
    splat_object(path, "Plain")
    empty = bpy.data.objects.new("Instancer", None)
    empty.instance_type, empty.instance_collection = 'COLLECTION', inside
    scene.collection.objects.link(empty)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    take = module("scene.snapshot").take
    assert [s.name for s in take(depsgraph).instances] == ["Plain", "Instanced"]
    assert [s.name for s in take(depsgraph, lambda obj: obj.name != "Plain").instances] == ["Instanced"]
    assert [s.name for s in take(depsgraph, lambda obj: obj.name != "Instancer").instances] == ["Plain"]


def test_nothing_is_left_after_unregister(module, addon, scene):
    import bpy

    spaces = module("engine.viewport.spaces")
    viewport = module("engine.viewport")
    viewport.unregister()
    try:
        lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
        functions = [f for handlers in lists if isinstance(handlers, list) for f in handlers]
        assert not [f for f in functions if f.__module__ == spaces.__name__]
        assert not spaces.viewports.views and not spaces.viewports.atlas.models and not viewport._drawing
        assert not bpy.app.timers.is_registered(spaces.viewports.timer)
    finally:
        viewport.register()
