# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's own cameras as a source of training, and what the panel says."""
from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import panel_recorder
import pytest
from image_files import read_png
from mathutils import Matrix

CAMERAS = {
    "Left": dict(width=40, height=30, fx=44.0, fy=44.0, cx=21.5, cy=14.0),
    "Right": dict(width=40, height=30, fx=39.0, fy=41.0, cx=20.0, cy=15.0),
}


@pytest.fixture
def capture(module, tmp_path):
    """Two cameras of frames 10 to 12; the right one moves; its pixels are taller than wide."""
    write_png = module("fastgs_blender.util.picture_files").write_png
    folder, poses = tmp_path / "capture", {}
    for i, name in enumerate(CAMERAS):
        matrix = np.diag([1.0, -1, -1, 1])
        matrix[:3, 3] = 0.5 - i, 0.3, 4
        poses[name] = np.stack([matrix + 0.1 * k * i * np.eye(4, k=3) for k in range(3)])
        (folder / name).mkdir(parents=True)
        for k in range(3):
            write_png(folder / name / f"{k + 10:04}.png", np.full((30, 40, 3), 50 * k + i, np.uint8))
    module("fastgs_blender.captures.layouts.fastgs").write_cameras(
        folder, [dict(name=name, world_to_camera=poses[name], **lens) for name, lens in CAMERAS.items()],
        frame_count=3, fps=24, start_frame=10, axes="RFU")
    return folder


def opened(module, path):
    found = module("fastgs_blender.captures").open_capture(path)
    assert not module("fastgs_blender.captures.pixels.checks").problems(found)
    return {(shot.view, shot.frame): shot for shot in found.shots}


def test_cameras_with_pictures_are_a_capture(module, capture, scene, tmp_path):
    """What was imported as cameras comes back as it was: same lenses, poses, pictures, on the frames that the scene has."""
    scene.frame_start, scene.frame_end = 1, 2
    bpy.ops.fastgs.import_capture(filepath=str(capture / "cameras.json"))
    plates = module("scene.training.plates")
    assert plates.count(scene) == 2
    here = scene.frame_current
    out = plates.write_capture(bpy.context, tmp_path / "made")
    before, after = opened(module, capture), opened(module, out)
    assert set(after) == {(view, frame) for view in CAMERAS for frame in (0, 1)} and scene.frame_current == here
    for key, shot in after.items():
        for name in ("fx", "fy", "cx", "cy"):
            assert abs(getattr(shot.camera, name) - getattr(before[key].camera, name)) < 1e-3
        assert np.abs(shot.camera.world_to_camera - before[key].camera.world_to_camera).max() < 1e-5
        assert np.array_equal(read_png(shot.image.path), read_png(before[key].image.path))


def test_pictures_fill_the_frame_as_they_are_shown(module, add_camera, capture, scene):
    """A picture that is narrower than the camera's frame: stretched, fitted in and cropped; a point lands where Blender shows it."""
    plates = module("scene.training.plates")
    scene.render.resolution_x, scene.render.resolution_y = 80, 40
    camera = add_camera(lens=40, shift_x=0.1)
    background = camera.data.background_images.new()
    image = background.image = bpy.data.images.load(str(capture / "Left" / "0010.png"))
    image.source = 'SEQUENCE'
    background.image_user.frame_start, background.image_user.frame_duration, background.image_user.frame_offset = 5, 3, 9
    focal = 40 / 36 * 80
    for method, (across, down) in (('STRETCH', (2, 40 / 30)), ('FIT', (40 / 30,) * 2), ('CROP', (2, 2))):
        background.frame_method = method
        plate, = plates.filmed(scene).values()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        found = plates.picture_camera(plates._frame_camera(camera.evaluated_get(depsgraph), depsgraph), plate)
        assert np.allclose((found.fx, found.fy), (focal / across, focal / down), rtol=1e-5)
        assert np.allclose((found.cx, found.cy), (20 - 8 / across, 15), atol=1e-4)
    assert plate.file(5).name == "0010.png" and (plate.first, plate.last) == (5, 7)
    background.rotation = 0.2
    with pytest.raises(module("fastgs_blender").FastGSError, match="turned"):
        plates.filmed(scene)


def test_missing_pictures_are_named(module, capture, scene, tmp_path):
    scene.frame_start, scene.frame_end = 1, 3
    bpy.ops.fastgs.import_capture(filepath=str(capture / "cameras.json"))
    (capture / "Right" / "0011.png").unlink()
    with pytest.raises(module("fastgs_blender").FastGSError, match="0011.png.*frame 2.*missing"):
        module("scene.training.plates").write_capture(bpy.context, tmp_path / "made")


def test_films_may_begin_later(module, scene, tmp_path):
    """Frame 0 of a clip is frame video_start of a camera's film."""
    av = pytest.importorskip("av")
    folder = tmp_path / "films"
    folder.mkdir()
    for name in CAMERAS:
        with av.open(str(folder / f"{name}.mp4"), "w") as file:
            stream = file.add_stream("mpeg4", rate=24)
            stream.width, stream.height, stream.pix_fmt = 40, 30, "yuv420p"
            for k in range(6):
                frame = av.VideoFrame.from_ndarray(np.full((30, 40, 3), 40 * k, np.uint8))
                file.mux(stream.encode(frame))
            file.mux(stream.encode())
    matrix = np.diag([1.0, -1, -1, 1])
    for name in CAMERAS:
        data = bpy.data.cameras.new(name)
        obj = bpy.data.objects.new(name, data)
        obj.matrix_world = Matrix(np.linalg.inv(matrix).tolist())
        scene.collection.objects.link(obj)
        background = data.background_images.new()
        background.image = bpy.data.images.load(str(folder / f"{name}.mp4"))
        user = background.image_user
        user.frame_start, user.frame_duration, user.frame_offset = 1, 6, 0
    user.frame_start, user.frame_offset = 3, 1  # the right one: its frame 1 on scene frame 3
    scene.frame_start, scene.frame_end = 3, 5
    out = module("scene.training.plates").write_capture(bpy.context, tmp_path / "made")
    shots = opened(module, out)
    assert [shots["Left", k].image.frame for k in range(3)] == [2, 3, 4]
    assert [shots["Right", k].image.frame for k in range(3)] == [1, 2, 3]
    assert {e["name"]: e["video_start"] for e in json.loads(Path(out, "cameras.json").read_text())["cameras"]} == {"Left": 2, "Right": 1}


def progress(layout, factor=0.0, text=""):
    assert 0 <= factor <= 1
    layout.record.append(("progress", text, layout.alert))


@pytest.mark.parametrize(("kind", "words"), [
    ('TRAINING', "Training 25 %, 12 min left"), ('QUEUED', "Waiting for its turn"), ('FAILED', "no memory"), ('FINISHED', "31.25 dB"),
    ('PAUSED', "Paused")])
def test_the_panel_shows_runs(module, scene, monkeypatch, kind, words):
    jobs, watch = module("fastgs_blender.jobs.job"), module("scene.training.watch")
    values = {"iteration": 250, "iterations": 1000, "seconds_left": 700.0, "held_out_psnr": 31.25}
    texts = {'TRAINING': "Training", 'QUEUED': "Waiting for its turn", 'FAILED': "There is no memory", 'FINISHED': "Finished",
             'PAUSED': "Paused"}
    job = jobs.Job("1", "/out/robot", "/capture", "python")
    monkeypatch.setattr(watch, "_found", [(job, jobs.State(kind, texts[kind], values))])
    monkeypatch.setattr(panel_recorder.Layout, "progress", progress, raising=False)
    layout = panel_recorder.Layout()
    panel = next(cls for cls in module("ui").CLASSES if cls.__name__ == "FASTGS_PT_training_runs")
    context = SimpleNamespace(scene=scene, region=SimpleNamespace(width=300), preferences=bpy.context.preferences)
    panel.draw(SimpleNamespace(layout=layout), context)
    drawn = " ".join(text for _, text, _ in layout.record)
    assert words in drawn and "robot" in drawn
    assert ("fastgs.train_pause" in drawn) == (kind in ('TRAINING', 'QUEUED'))
    assert ("fastgs.train_resume" in drawn) == (kind in ('FAILED', 'PAUSED'))
    assert watch.line() == ("robot: training 25 %, 12 min left" if kind == 'TRAINING' else "")


def test_estimates_grow_with_the_work(module):
    costs = module("fastgs_blender.training.core.costs")
    assert costs.size_of('DRAFT') == (2500, 20_000) and costs.size_of('FINAL', 10, 20) == (10, 20)
    assert costs.size_of('DRAFT', pixels=5e6) == (2500, 40_000) and costs.size_of('STG', pixels=5e6) == costs.size_of('STG')
    assert costs.size_of('DRAFT', frames=150) == (3750, 20_000) and costs.size_of('DRAFT', 10, frames=150)[0] == 10
    # three segments of 139 frames, of which the later ones take half of the steps
    assert costs.size_of('DRAFT', frames=400) == (3475 + 2 * 1738, 20_000)
    small, large = costs.estimate(320 * 240, 2500, 20_000), costs.estimate(1920 * 1080, 30_000, 150_000)
    assert 30 < small[0] < large[0] and small[1] < large[1]


def test_disk_and_memory_are_looked_at(module, tmp_path, monkeypatch):
    checks = module("fastgs_blender.jobs.checks")
    monkeypatch.setattr(checks.shutil, "disk_usage", lambda path: SimpleNamespace(free=10 << 20))
    with pytest.raises(module("fastgs_blender").FastGSError, match="10 MB"):
        checks.before_start(str(tmp_path / "new" / "run"))
    monkeypatch.setattr(checks.shutil, "disk_usage", lambda path: SimpleNamespace(free=10 << 30))
    monkeypatch.setattr(checks, "available_memory", lambda: 2**31)
    estimate = module("fastgs_blender.training.core.costs").estimate
    few, many = (estimate(640 * 480, 100, gaussians, 100)[1] for gaussians in (20_000, 2_000_000))
    assert not checks.before_start(str(tmp_path), few)
    remark, = checks.before_start(str(tmp_path), many)
    assert "memory" in remark and f"{many / 1e9:.1f} GB" in remark


def test_the_memory_that_a_run_takes_is_known_before_it_starts(module, capture, scene, tmp_path, monkeypatch):
    """From the size and number of the capture's pictures and the most Gaussians."""
    checks, store = module("fastgs_blender.jobs.checks"), module("scene.training.installation")
    monkeypatch.setattr(checks, "latest", None)
    assert checks.picture_size(str(capture)) == (40 * 30, 2, 3) and checks.picture_size(str(tmp_path / "none")) == (0, 0, 0)
    told = []

    def before_start(out, memory):
        told.append(memory)
        raise module("fastgs_blender").FastGSError("enough.")

    monkeypatch.setattr(checks, "before_start", before_start)
    monkeypatch.setattr(store, "python", lambda: "python")
    with pytest.raises(RuntimeError, match="Enough"):
        bpy.ops.fastgs.train(capture=str(capture), out=str(tmp_path / "run"), max_gaussians=1000)
    assert told[0] == module("fastgs_blender.training.core.costs").estimate(1200, 1, 1000, 6)[1]


@pytest.mark.parametrize(("posed", "missing", "told"), [
    (False, {"pycolmap": "no"}, True), (False, {}, False), (True, {"pycolmap": "no"}, False)])
def test_check_says_what_a_capture_without_poses_needs(module, monkeypatch, posed, missing, told):
    checks = module("fastgs_blender.jobs.checks")
    report = checks.pythons.Report("python", "3.11", {}, missing)
    values = {"views": [{"width": 40, "height": 30}] * 3, "clip": {"frame_count": 5}, "layout": "films", "posed": posed, "problems": []}
    monkeypatch.setattr(checks.pythons, "inspect", lambda python: report)
    monkeypatch.setattr(checks, "Command", lambda *_: SimpleNamespace(wait=lambda: True, result=lambda: values))
    monkeypatch.setattr(checks, "latest", None)
    found = checks.inspect("python", "/dance")
    assert (found.views, found.frames, found.posed) == (3, 5, posed)
    assert ["pycolmap" in problem and "preferences" in problem for problem in found.problems] == [True] * told
