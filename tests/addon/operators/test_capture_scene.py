# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene is filmed from many sides, and left as it was."""
from __future__ import annotations

import shutil
import sys

import bpy
import numpy as np
import pytest

SIZE = dict(width=32, height=24)


@pytest.fixture
def moving_scene(scene, module, monkeypatch):
    """A ball that crosses a floor in two frames, lit, rendered by Cycles; what is filmed is baked with few Gaussians."""
    monkeypatch.setattr(module("scene.filming.baked"), "COUNT", 30_000)
    scene.render.engine = 'CYCLES'
    scene.cycles.samples = 77
    scene.view_settings.view_transform = 'AgX'
    scene.frame_start, scene.frame_end = 3, 4
    for name, size in (("Ball", 0.5), ("Floor", 9.0)):
        corners = size * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        if name == "Floor":
            corners[:, 2] = np.where(corners[:, 2] > 0, -0.5, -0.6)
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(corners.tolist(), [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        obj = bpy.data.objects.new(name, mesh)
        scene.collection.objects.link(obj)
        if name == "Ball":
            for frame, x in ((3, -0.5), (4, 0.5)):
                obj.location.x = x
                obj.keyframe_insert("location", frame=frame)
    light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    light.data.energy = 3
    scene.collection.objects.link(light)
    scene.frame_set(3)
    return scene


def settings_of(group, depth=2):
    """All plain values of Blender's settings, groups within included."""
    values = {}
    for name in group.bl_rna.properties.keys():  # noqa: SIM118 (it is no dictionary)
        if name in ("use_nodes", "uv_sculpt"):  # Blender 4.2 crashes when the latter is read
            continue
        value = getattr(group, name)
        if isinstance(value, (str, int, float, bool)):
            values[name] = value
        elif depth and isinstance(value, bpy.types.bpy_struct) and not isinstance(value, bpy.types.ID) and name != "rna_type":
            values |= {f"{name}.{key}": v for key, v in settings_of(value, depth - 1).items()}
    return values


def everything():
    """Names of the datablocks; the image of Blender's last render is its own affair."""
    kinds = ("scenes", "objects", "cameras", "images", "worlds")
    return {name: sorted({item.name for item in getattr(bpy.data, name)} - {"Render Result"}) for name in kinds}


def test_a_scene_is_filmed_and_left_as_it_was(moving_scene, module, fg, tmp_path):
    out = tmp_path / "film"
    before = settings_of(moving_scene), everything()
    assert bpy.ops.fastgs.capture_scene(out=str(out), count=4, samples=1, **SIZE) == {'FINISHED'}
    after = settings_of(moving_scene), everything()
    changed = {name for name in before[0] if before[0][name] != after[0][name]}
    assert changed <= {"fastgs.training.capture", "training.capture"} and before[1] == after[1]

    open_capture = module("fastgs_blender.captures").open_capture
    capture = open_capture(out)
    module("fastgs_blender.captures.pixels.checks").check(capture)
    assert capture.views == ["cam00", "cam01", "cam02", "cam03"] and capture.held_out_views == ["cam00"]
    assert (capture.clip.frame_count, capture.axes) == (2, "RFU")
    # the bake beside the pictures follows the ball, on the capture's own time line
    bake = fg.load(capture.model)
    assert (bake.clip.frame_count, bake.clip.start_frame, bake.axes) == (2, 1, "RFU")
    for frame, x in enumerate((-0.5, 0.5)):
        places = fg.slice_model(bake, frame / 2).position
        ball = places[places[:, 2] > -0.4]
        assert len(ball) > 50 and np.abs(ball[:, 0] - x).max() < 0.52, frame
    # the masks show the ball, in every view where the ball is: its centre is known
    store = module("fastgs_blender.captures.pixels.store").FrameStore(capture, 2**20, folder=tmp_path / "cache")
    for shot in capture.shots:
        pixels = store.pixels(shot)
        centre = np.array([(-0.5, 0.5)[shot.frame], 0, 0, 1])
        x, y, z = (shot.camera.world_to_camera @ centre)[:3]
        u, v = shot.camera.fx * x / z + shot.camera.cx, shot.camera.fy * y / z + shot.camera.cy
        rows, columns = np.nonzero(pixels.mask > 0.5)
        assert abs(columns.mean() + 0.5 - u) < 2 and abs(rows.mean() + 0.5 - v) < 2
    # points from depth lie on the ball's and the floor's surfaces, those that move belong to their frame
    points = capture.points
    moves = np.isfinite(points.t)
    assert 100 < moves.sum() < len(points)
    x = np.where(points.t[moves] == 0, -0.5, 0.5)
    assert np.quantile(np.abs(np.abs(points.xyz[moves] - np.c_[x, 0 * x, 0 * x]).max(1) - 0.5), 0.9) < 0.05
    assert np.quantile(np.abs(points.xyz[~moves, 2] + 0.5), 0.9) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("world", "textured", "filmed"), [
    ('AUTO', False, False), ('AUTO', True, True), ('FILM', False, True), ('LEAVE_OUT', True, False)])
def test_a_world_that_our_engine_shows_itself_is_left_out(moving_scene, module, tmp_path, world, textured, filmed):
    shown = moving_scene.world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        shown.use_nodes = True
    if textured:
        tree = shown.node_tree
        tree.links.new(tree.nodes.new('ShaderNodeTexGradient').outputs[0], tree.nodes["Background"].inputs["Color"])
    bpy.data.objects["Floor"].hide_render = True
    bpy.ops.fastgs.capture_scene(out=str(tmp_path / "film"), count=2, samples=1, frame_end=3, world=world, **SIZE)
    assert not moving_scene.render.film_transparent
    capture = module("fastgs_blender.captures").open_capture(tmp_path / "film")
    store = module("fastgs_blender.captures.pixels.store").FrameStore(capture, 2**20, folder=tmp_path / "cache", whole=True)
    pixels = store.pixels(capture.shots[0])
    assert (pixels.alpha is None) == filmed
    if not filmed:
        assert pixels.alpha[12, 16] == 1 and pixels.alpha[0, 0] == 0 and np.abs(pixels.alpha - pixels.mask).max() < 0.1


def test_a_finished_model_hides_what_was_filmed(moving_scene, add_camera, module, tmp_path, make_model, model_file, splat_object):
    """What the pictures show is hidden, in viewports and renders: no cameras, no lights, no splats, nothing that was hidden before."""
    camera = add_camera()
    bpy.data.objects["Floor"].hide_render = True
    splats = splat_object(model_file(make_model()))
    bpy.ops.fastgs.capture_scene(out=str(tmp_path / "film"), count=2, samples=1, frame_end=3, **SIZE)
    jobs, results = module("fastgs_blender.jobs.job"), module("scene.training.results")
    (tmp_path / "run").mkdir()
    shutil.copy(model_file(make_model(30)), tmp_path / "run" / "model.safetensors")
    job = jobs.Job("1", str(tmp_path / "run"), str(tmp_path / "film"), "python")
    shown = results.add_finished(bpy.context, job)
    assert not any(obj.hide_get() for obj in moving_scene.objects), "it was not asked for"
    job.scene["hide"] = True
    assert results.add_finished(bpy.context, job) == shown
    assert {obj.name for obj in moving_scene.objects if obj.hide_get()} == {"Ball"} and bpy.data.objects["Ball"].hide_render
    for obj in (shown, splats, camera, bpy.data.objects["Sun"]):
        assert not obj.hide_render


def test_filming_goes_on_where_it_stopped(moving_scene, tmp_path):
    out = tmp_path / "film"
    options = dict(out=str(out), count=3, samples=1, frame_end=3, **SIZE)
    bpy.ops.fastgs.capture_scene(**options)
    times = {path: path.stat().st_mtime_ns for path in out.rglob("0001.png")}
    (out / "cam01" / "0001.png").unlink()
    bpy.ops.fastgs.capture_scene(**options)
    again = {path for path, time in times.items() if path.stat().st_mtime_ns != time}
    assert again == {out / "cam01" / "0001.png", out / "masks" / "cam01" / "0001.png"}
    with pytest.raises(RuntimeError, match="other settings"):
        bpy.ops.fastgs.capture_scene(**(options | {"count": 4}))


def test_nothing_is_left_when_filming_fails(moving_scene, tmp_path):
    before = everything()
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="written.*folder"):
        bpy.ops.fastgs.capture_scene(out=str(tmp_path / "file" / "film"), count=3, samples=1, **SIZE)
    assert everything() == before
    with pytest.raises(RuntimeError, match="two cameras"):
        bpy.ops.fastgs.capture_scene(out=str(tmp_path), cameras='ALL')


def test_own_cameras_film_as_they_move(moving_scene, add_camera, module, tmp_path):
    cameras = [add_camera((x, -6, 1), (85, 0, 0), lens=30) for x in (-1, 1)]
    cameras[1].keyframe_insert("location", frame=3)
    cameras[1].location.z = 2
    cameras[1].keyframe_insert("location", frame=4)
    bpy.ops.fastgs.capture_scene(out=str(tmp_path / "film"), cameras='ALL', samples=1, **SIZE)
    capture = module("fastgs_blender.captures").open_capture(tmp_path / "film")
    heights = {(shot.view, shot.frame): np.linalg.inv(shot.camera.world_to_camera)[2, 3] for shot in capture.shots}
    assert np.allclose([heights[view, frame] for view in ("Camera", "Camera.001") for frame in (0, 1)], [1, 1, 1, 2])
    assert abs(capture.shots[0].camera.fx - 30 / 36 * 32) < 1e-4


def test_the_button_trains_on_a_film_of_the_scene_as_the_command_line_does(moving_scene, module, tmp_path, monkeypatch):
    """The same capture and the same defaults: the same plan, which begins with the bake that lies beside the pictures."""
    cli, installation, plans = module("fastgs_blender.cli"), module("scene.training.installation"), []
    monkeypatch.setattr(module("fastgs_blender.training.run.session"), "run", lambda capture, store, plan, *rest, **more: (
        plans.append((capture, plan)) or {"model": "", "gaussians": 0, "iterations": 0}))
    monkeypatch.setattr(module("fastgs_blender.util.backends"), "choose_device", lambda device=None: ("cpu", ""))
    monkeypatch.setattr(installation, "python", lambda: sys.executable)
    jobs = installation.jobs()
    monkeypatch.setattr(type(jobs), "start_next", lambda self: None)
    film, names = tmp_path / "film", module("operators.train").FROM_PANEL
    bpy.ops.fastgs.capture_scene(out=str(film), count=3, samples=1, **SIZE)
    panel = moving_scene.fastgs.training
    panel.capture, panel.out, panel.source = str(film), str(tmp_path / "run"), 'FOLDER'
    assert bpy.ops.fastgs.train(wait=False, **{name: getattr(panel, name) for name in names}) == {'FINISHED'}
    job = jobs.all()[-1]
    try:
        command = jobs.command(job)
        assert cli.main(command[command.index("train"):]) == 0 and cli.main(["train", str(film), "--out", str(tmp_path / "other")]) == 0
    finally:
        jobs.forget(job)
    (capture, pressed), (_, typed) = plans
    differing = {name for name, value in vars(typed.settings).items() if vars(pressed.settings)[name] != value}
    assert differing <= {"preview_every"} and pressed.source == typed.source, differing
    assert module("fastgs_blender.training.initial.warm_start").starting_model(capture, pressed.settings, print) is not None
