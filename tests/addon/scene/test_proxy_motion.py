# SPDX-License-Identifier: GPL-3.0-or-later
"""Proxies move with time in every engine: their points lie where the Gaussians are on the frame, in viewports and in final renders."""
from types import SimpleNamespace

import bpy
import numpy as np
import panel_recorder
import pytest

HEIGHT = 2.0


@pytest.fixture
def moving(fg, make_model, model_file):
    """The file of a model that moves by several times its height in 60 frames, in curves; a part of it lives for a while only."""
    n, rng = 300, np.random.default_rng(8)
    motion = rng.normal(size=(n, 10, 3)) * 0.2 + rng.normal(size=(1, 10, 3)) * 2
    windows = np.tile([-1.0, 2.0, -6.0, -6.0], (n, 1))
    windows[::3, 0], windows[::3, 1] = 0.5, 0.8
    return model_file(make_model(n, basis=fg.Fourier(5), motion=motion, opacity=np.full(n, 5.0), clip=fg.Clip(60, 24), axes="RDF",
                                 temporal_kind=fg.Window(), temporal=windows))


class _Reader(bpy.types.RenderEngine):
    """An engine that keeps what other engines would draw of each mesh, on each frame that it renders."""

    bl_idname = "FASTGS_test_reader"
    bl_label = "Reader"
    seen: list = []

    def render(self, depsgraph):
        scene = depsgraph.scene
        for instance in depsgraph.object_instances:
            if instance.object.type == 'MESH':
                matrix = np.array(instance.matrix_world)
                self.seen.append((scene.frame_current + scene.frame_subframe, *balls(instance.object.data, matrix)))
        self.end_result(self.begin_result(0, 0, 8, 8))


@pytest.fixture
def reader():
    bpy.utils.register_class(_Reader)
    _Reader.seen.clear()
    yield _Reader.seen
    bpy.utils.unregister_class(_Reader)


def balls(mesh, matrix):
    """({Gaussian: middle of its octahedron}, {Gaussian: largest extent}) of an evaluated proxy, in the world."""
    at, number = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.vertices), np.int32)
    mesh.vertices.foreach_get("co", at)
    mesh.attributes["Gaussian"].data.foreach_get("value", number)
    faces = {i for face in mesh.polygons for i in face.vertices}
    at = at.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    corners = {k: np.array([i for i in np.flatnonzero(number == k) if i in faces]) for k in np.unique(number) if k >= 0}
    return {k: at[c].mean(0) for k, c in corners.items()}, {k: np.ptp(at[c], axis=0).max() for k, c in corners.items()}


def assert_where_the_gaussians_are(fg, path, placement, frame, middles, sizes):
    model = fg.load(path)
    s = fg.slice_model(model, (frame - 1) / 60, cull=False)
    truth = s.position @ placement[:3, :3].T + placement[:3, 3]
    seen = s.opacity >= model.raster.alpha_cut
    assert seen.sum() > 100 and len(middles) == len(model)
    away = [np.linalg.norm(middles[k] - truth[k]) for k in middles if seen[k]]
    assert np.mean(away) <= 0.001 * HEIGHT
    assert all((sizes[k] > 0) == seen[k] for k in sizes)
    largest = s.scale.max(1)
    grown = [sizes[k] / largest[k] for k in sizes if seen[k]]
    assert min(grown) > 1.0 and max(grown) < 2 * 1.5 + 1e-3


def test_final_renders_of_other_engines_move(scene, fg, module, moving, reader, add_camera):
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj = bpy.context.object
    obj.location, obj.rotation_euler = (1, 2, 3), (0.3, 0.2, 0.1)
    add_camera()
    scene.render.engine = _Reader.bl_idname
    scene.render.resolution_x = scene.render.resolution_y = 8
    for frame, part in ((5, 0.0), (20, 0.0), (45, 0.5)):
        scene.frame_set(frame, subframe=part)
        bpy.ops.render.render()
    rest = np.array([v.co for v in obj.data.vertices])
    assert [frame for frame, *_ in reader] == [5, 20, 45.5]
    placement = module("scene.model_space").placement(obj)
    for frame, middles, sizes in reader:
        assert_where_the_gaussians_are(fg, moving, placement, frame, middles, sizes)
    assert np.array_equal(rest, [v.co for v in obj.data.vertices])  # the file itself is left alone


def test_our_own_final_renders_move_no_points(scene, module, moving, reader, add_camera):
    bpy.ops.import_scene.fastgs(filepath=moving)
    add_camera()
    scene.render.resolution_x = scene.render.resolution_y = 8
    found = []

    def look(_, depsgraph):
        if depsgraph.mode == 'RENDER':
            found.extend(module("scene.splats.proxy_motion").MOVED in each.data for each in depsgraph.objects if each.type == 'MESH')

    bpy.app.handlers.frame_change_post.append(look)
    try:
        for engine in ('FASTGS', _Reader.bl_idname):
            scene.render.engine = engine
            found.clear()
            bpy.ops.render.render()
            assert set(found) == {engine != 'FASTGS'}
    finally:
        bpy.app.handlers.frame_change_post.remove(look)


def test_points_follow_the_objects_own_time(scene, fg, module, moving):
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj = bpy.context.object
    obj.fastgs.start_frame, obj.fastgs.before = 11, 'HIDE'
    obj.update_tag()  # as the interface does
    placement = module("scene.model_space").placement(obj)

    def now():
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
        return balls(evaluated.data, np.array(evaluated.matrix_world))

    scene.frame_set(30)
    assert_where_the_gaussians_are(fg, moving, placement, 20, *now())
    scene.frame_set(5)
    assert max(now()[1].values()) == 0


@pytest.fixture
def still(scene, fg, module, moving):
    """now(): (middles, sizes, {Gaussian: colour}) of the object's points on frame 20; the object, and now."""
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj = bpy.context.object

    def now(frame=20):
        scene.frame_set(frame)
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.data
        colour, number = np.empty(4 * len(mesh.vertices), np.float32), np.empty(len(mesh.vertices), np.int32)
        mesh.attributes["Color"].data.foreach_get("color", colour)
        mesh.attributes["Gaussian"].data.foreach_get("value", number)
        return *balls(mesh, np.array(evaluated.matrix_world)), dict(zip(number.tolist(), colour.reshape(-1, 4)[:, :3]))

    return obj, now


def test_points_follow_looks(still, fg, moving):
    obj, now = still
    _, sizes, colours = now()
    seen = [k for k in sizes if sizes[k] > 0]
    obj.fastgs.splat_scale, obj.fastgs.exposure, obj.fastgs.tint = 2.0, 1.0, (1.0, 0.5, 0.25)
    _, larger, brighter = now()
    assert [larger[k] for k in seen] == pytest.approx([2 * sizes[k] for k in seen], rel=1e-3)
    wanted = np.array([colours[k] * (2.0, 1.0, 0.5) for k in seen])
    assert np.allclose([brighter[k] for k in seen], wanted, atol=1e-4) and wanted.max() > 0.1
    obj.fastgs.splat_scale, obj.fastgs.opacity = 1.0, 0.25
    _, fainter, _ = now()
    assert [fainter[k] for k in seen] == pytest.approx([0.5 * sizes[k] for k in seen], rel=1e-3)
    obj.fastgs.opacity, obj.fastgs.opacity_cut = 1.0, 0.999  # theirs is 0.993
    assert max(now()[1].values()) == 0
    obj.fastgs.opacity_cut = 0.0
    obj.fastgs.filters.add().high = 1e9  # all sizes
    assert max(now()[1].values()) == 0


def test_echoes_share_the_points(still, fg, moving):
    """Two of three points show the frame itself, one the echo of half the opacity; together they cover as much as both."""
    obj, now = still
    here, sizes, _ = now()
    before, sizes_before, _ = now(10)
    obj.fastgs.echoes, obj.fastgs.echo_spacing, obj.fastgs.echo_fade = 1, 10.0, 0.5
    middles, larger, _ = now()
    echo = np.array([np.allclose(middles[k], before[k], atol=1e-4) for k in middles])
    assert all(np.allclose(middles[k], before[k] if is_echo else here[k], atol=1e-4) for k, is_echo in zip(middles, echo))
    assert echo.mean() == pytest.approx(1 / 3, abs=0.01)
    wanted = [np.sqrt(1.5) * (sizes_before if is_echo else sizes)[k] for k, is_echo in zip(middles, echo)]
    assert [larger[k] for k in middles] == pytest.approx(wanted, rel=1e-3)
    obj.fastgs.echoes = 0
    assert {k: tuple(v) for k, v in now()[0].items()} == {k: tuple(v) for k, v in here.items()}


def test_other_engines_panel_says_what_they_show(scene, module, moving):
    panel = module("ui.render_panels").FASTGS_PT_other_engine
    scene.render.engine = 'CYCLES'
    assert not panel.poll(bpy.context)
    bpy.ops.import_scene.fastgs(filepath=moving)
    assert panel.poll(bpy.context)
    layout = panel_recorder.Layout()
    panel.draw(SimpleNamespace(layout=layout), SimpleNamespace(
        region=SimpleNamespace(width=300), preferences=bpy.context.preferences, scene=scene, object=bpy.context.object,
        engine=scene.render.engine))
    kinds = [kind for kind, *_ in layout.record]
    assert kinds[0] == "label" and "operator" in kinds and any("FAST-GS" in text for _, text, _ in layout.record)
    scene.render.engine = 'FASTGS'
    assert not panel.poll(bpy.context)
