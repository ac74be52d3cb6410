# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of captures: imported exactly, with their films and pictures as backgrounds in step."""
from __future__ import annotations

import os
import threading

import bpy
import by_hand
import image_files
import numpy as np
import pytest
from camera_checks import assert_same, in_world, make_camera, project, seen
from held_runs import GUARD
from mathutils import Matrix

FRAMES = 6


@pytest.mark.parametrize("seed", range(6))
def test_optics_are_the_inverse_of_what_the_engine_reads(scene, fg, module, now, seed):
    rng = np.random.default_rng(seed)
    wanted = make_camera(fg, rng, *((320, 240), (240, 320))[seed % 2])
    place = module("scene.cameras.placing")
    obj = bpy.data.objects.new("C", bpy.data.cameras.new("C"))
    scene.collection.objects.link(obj)
    place.set_optics(obj.data, wanted)
    place.set_pose(obj, wanted)
    place.use_render_size(scene, obj)
    assert_same(now(obj), wanted)
    assert scene.camera == obj


def test_a_very_wide_lens(scene, fg, module, now):
    wanted = fg.Camera(640, 480, 12, 12, 300, 260, np.eye(4))
    place = module("scene.cameras.placing")
    obj = bpy.data.objects.new("C", bpy.data.cameras.new("C"))
    scene.collection.objects.link(obj)
    place.set_optics(obj.data, wanted)
    place.set_pose(obj, wanted)
    place.use_render_size(scene, obj)
    assert_same(now(obj), wanted, 1e-3)


# ---- captures ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def capture(fg, module, tmp_path):
    """capture(lens=False, film=False): a folder with three cameras of FRAMES frames from picture number 11 on, and the cameras.

    The second camera moves.  Each picture is one grey value: 20 x camera + frame.
    """

    def write(lens=False, film=False, fps=24):
        Image = pytest.importorskip("PIL.Image")
        rng = np.random.default_rng(4)
        folder = tmp_path / "filmed"
        folder.mkdir()
        made = [make_camera(fg, rng, 64, 48) for _ in range(3)]
        path = [made[1]] + [make_camera(fg, rng, 64, 48) for _ in range(FRAMES - 1)]
        entries = []
        for i, camera in enumerate(made):
            pose = np.array([c.world_to_camera for c in path]) if i == 1 else camera.world_to_camera
            entries.append({"name": f"cam{i}", "width": 64, "height": 48, "fx": camera.fx, "fy": camera.fy, "cx": camera.cx,
                            "cy": camera.cy, "world_to_camera": pose, **({"distortion": {"model": "opencv", "k1": -0.1}} if lens else {})})
            grey = [np.full((48, 64, 3), 20 * i + f, np.uint8) for f in range(FRAMES)]
            if film:
                _film(pytest.importorskip("av"), folder / f"cam{i}.mp4", grey, fps)
            else:
                (folder / f"cam{i}").mkdir()
                for f, picture in enumerate(grey):
                    Image.fromarray(picture).save(folder / f"cam{i}" / f"{11 + f:04d}.png")
        module("fastgs_blender.captures.layouts.fastgs").write_cameras(folder, entries, frame_count=FRAMES, fps=fps, start_frame=11)
        return folder, made, path

    return write


def _film(av, path, pictures, fps):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "1"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


def settings_of(scene):
    return (scene.render.resolution_x, scene.render.resolution_y, scene.render.fps, scene.frame_start, scene.frame_end, scene.camera,
            scene.render.pixel_aspect_x, scene.render.pixel_aspect_y, scene.frame_current)


def test_a_captures_cameras_are_exact(scene, fg, module, capture, now):
    folder, made, path = capture()
    scene.frame_start = 5
    before = settings_of(scene)
    assert bpy.ops.fastgs.import_capture(filepath=str(folder)) == {'FINISHED'}
    assert settings_of(scene) == before
    collection = bpy.data.collections["filmed"]
    objects = [obj for obj in collection.objects if obj.type == 'CAMERA']
    assert [obj.data.fastgs.view for obj in objects] == ["cam0", "cam1", "cam2"]
    assert set(bpy.context.selected_objects) == set(objects)
    upright = module("scene.objects").axes_matrix("RDF")
    for frame in range(FRAMES):
        scene.frame_set(5 + frame)
        for i, obj in enumerate(objects):
            bpy.context.view_layer.objects.active = obj
            assert bpy.ops.fastgs.render_as_filmed() == {'FINISHED'}
            wanted = path[frame] if i == 1 else made[i]
            # intrinsics are the rig camera's, the pose the frame's
            wanted = fg.Camera(64, 48, made[i].fx, made[i].fy, made[i].cx, made[i].cy, wanted.world_to_camera)
            assert_same(now(obj), in_world(wanted, upright))


@pytest.mark.parametrize("film", [False, True])
def test_backgrounds_are_in_step(scene, capture, film):
    """On each frame of the scene the background shows the capture's picture of that frame."""
    folder, _, _ = capture(film=film)
    scene.frame_start = 100
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    for i in range(3):
        data = bpy.data.objects[f"cam{i}"].data
        assert data.show_background_images
        (background,) = data.background_images
        assert (background.frame_method, background.display_depth) == ('STRETCH', 'BACK')
        user, image = background.image_user, background.image
        assert image.source == ('MOVIE' if film else 'SEQUENCE')
        assert image.frame_duration == FRAMES or not film
        assert (user.frame_start, user.frame_duration, user.use_auto_refresh, user.use_cyclic) == (100, FRAMES, True, False)
        assert user.frame_offset == (0 if film else 10)
        assert bpy.path.abspath(image.filepath).startswith(str(folder))


def test_a_missing_picture_shifts_no_other(scene, capture):
    folder, _, _ = capture()
    sorted((folder / "cam1").iterdir())[2].unlink()
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    background = bpy.data.objects["cam1"].data.background_images[0]
    assert background.image.source == 'SEQUENCE' and background.image_user.frame_duration == FRAMES
    for frame in (1, 2, 4, 6):
        assert value_shown(scene, background, frame) == pytest.approx(20 + frame - 1, abs=1)


def test_films_play_in_step_in_a_render(scene, capture, tmp_path):
    """What Blender itself shows of a background's image on a frame, through a material."""
    folder, _, _ = capture(film=True)
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    background = bpy.data.objects["cam2"].data.background_images[0]
    for frame in (1, 3, 6):
        assert value_shown(scene, background, frame) == pytest.approx(40 + frame - 1, abs=2)


def test_sequences_play_in_step_in_a_render(scene, capture):
    folder, _, _ = capture()
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    background = bpy.data.objects["cam1"].data.background_images[0]
    for frame in (1, 3, 6):
        assert value_shown(scene, background, frame) == pytest.approx(20 + frame - 1, abs=1)


def value_shown(scene, background, frame):
    """The grey value (0..255) that a shader with the background's image and timing gives on a frame, seen by Cycles."""
    material = bpy.data.materials.new("Show")
    if bpy.app.version < (5, 0, 0):  # later ones always have nodes
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    texture, emission, output = (nodes.new(kind) for kind in ('ShaderNodeTexImage', 'ShaderNodeEmission', 'ShaderNodeOutputMaterial'))
    texture.image = background.image
    for name in ("frame_start", "frame_duration", "frame_offset", "use_cyclic", "use_auto_refresh"):
        setattr(texture.image_user, name, getattr(background.image_user, name))
    material.node_tree.links.new(texture.outputs[0], emission.inputs[0])
    material.node_tree.links.new(emission.outputs[0], output.inputs[0])
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([(-9, 0, -9), (9, 0, -9), (9, 0, 9), (-9, 0, 9)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new()
    mesh.materials.append(material)
    wall = bpy.data.objects.new("Wall", mesh)
    scene.collection.objects.link(wall)
    eye = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
    eye.matrix_world = Matrix(by_hand.blender_matrix(by_hand.look_at((0, -5, 0), (0, 0, 0))).tolist())
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = 'CYCLES', 1, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.frame_set(frame)
    path = bpy.app.tempdir + f"value{frame}.png"
    image_files.set_output(scene, "PNG")
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    bpy.data.objects.remove(wall)
    return float(image_files.read_png(path)[4, 4, 0])


def test_the_scene_follows_only_when_asked(scene, capture):
    folder, _, _ = capture(fps=30)
    scene.frame_start = 3
    bpy.ops.fastgs.import_capture(filepath=str(folder), set_scene=True, backgrounds='NONE')
    assert (scene.render.fps / scene.render.fps_base, scene.frame_start, scene.frame_end) == (30, 3, 2 + FRAMES)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)
    assert scene.camera.data.fastgs.view == "cam0" and not scene.camera.data.background_images


def test_cameras_stay_with_the_splats_they_filmed(scene, fg, capture, now, make_model, model_file, splat_object):
    folder, made, _ = capture()
    matrix = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, 'X') @ Matrix.Scale(2.5, 4)
    splats = splat_object(model_file(make_model()), matrix=np.array(matrix))
    splats.fastgs.start_frame = 42
    bpy.context.view_layer.objects.active = splats
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    obj = bpy.data.objects["cam0"]
    assert obj.data.background_images[0].image_user.frame_start == 42
    bpy.context.view_layer.objects.active = obj
    bpy.ops.fastgs.render_as_filmed()
    world = seen(made[0], np.random.default_rng(1))
    moved = world @ np.array(matrix)[:3, :3].T + np.array(matrix)[:3, 3]
    np.testing.assert_allclose(project(now(obj), moved), project(made[0], world), atol=3e-4)
    splats.location.x += 5
    bpy.context.view_layer.update()
    np.testing.assert_allclose(project(now(obj), moved + [5, 0, 0]), project(made[0], world), atol=3e-4)


def test_distorted_pictures_are_undistorted_once(scene, capture, capfd, module):
    folder, _, _ = capture(lens=True)
    bpy.ops.fastgs.import_capture(filepath=str(folder), backgrounds='FILES')
    assert "distort" in capfd.readouterr().out
    image = bpy.data.objects["cam0"].data.background_images[0].image
    assert bpy.path.abspath(image.filepath).startswith(str(folder))
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    background = bpy.data.objects["cam0.001"].data.background_images[0]
    path = bpy.path.abspath(background.image.filepath)
    assert path.endswith("00001.jpg") and "cam0" in path and background.image_user.frame_offset == 0
    assert image_files.read_png(path).shape[:2] == (48, 64) and background.image.source == 'SEQUENCE'
    stamp = os.stat(path).st_mtime_ns
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    assert os.stat(path).st_mtime_ns == stamp


def test_corrected_copies_keep_alpha(scene, capture, module):
    folder, _, _ = capture(lens=True)
    Image = pytest.importorskip("PIL.Image")
    for path in (folder / "cam2").glob("*.png"):
        pixels = np.full((48, 64, 4), 200, np.uint8)
        pixels[:, :32, 3] = 0
        Image.fromarray(pixels).save(path)
    bpy.ops.fastgs.import_capture(filepath=str(folder))
    path = bpy.path.abspath(bpy.data.objects["cam2"].data.background_images[0].image.filepath)
    copy = np.asarray(Image.open(path))
    assert path.endswith("00001.png") and (copy[24, [10, 54], 3] == [0, 255 * 200 // 255]).all() and copy[24, 54, 0] == 200
    assert bpy.path.abspath(bpy.data.objects["cam0"].data.background_images[0].image.filepath).endswith(".jpg")


def test_writing_undistorted_pictures_can_be_interrupted_and_goes_on(scene, capture, module, monkeypatch):
    """Every film is decoded once for all of its pictures; what an interruption has left is not written again."""
    undistorted = module("scene.cameras.undistorted")
    opened = module("fastgs_blender.captures").open_capture(capture(lens=True)[0])
    decode, calls = undistorted.decoding.decode, []

    def counted(shots, scale):
        calls.append(sorted(shot.frame for shot in shots))
        return decode(shots, scale)

    save, saved, held = undistorted._save, [], threading.Event()

    class Stop(threading.Event):
        def set(self):
            super().set()
            held.set()

    def saving(file, pixels):
        if len(saved) >= 4:
            held.wait(GUARD)  # until the interruption
        saved.append(file)
        save(file, pixels)

    monkeypatch.setattr(undistorted.decoding, "decode", counted)
    monkeypatch.setattr(undistorted, "_save", saving)
    monkeypatch.setattr(undistorted, "Event", Stop)
    steps = undistorted.steps(opened, opened.shots)
    while (now := next(steps))[0] < 4:
        assert now[1] == 3 * FRAMES
    steps.close()
    assert 4 <= len(saved) < 3 * FRAMES
    first, calls[:] = set(saved), []
    told = list(undistorted.steps(opened, opened.shots))
    assert told[0][0] >= len(first) and told[-1] == (3 * FRAMES,) * 2, "all are counted, those of before too"
    assert len(saved) == len(set(saved)) == 3 * FRAMES and all(file.exists() for file in saved)
    assert len(calls) <= 3 and sum(map(len, calls)) == 3 * FRAMES - len(first)


def test_what_is_no_capture_leaves_nothing(tmp_path, capture):
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "cameras", "collections", "images")}
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "empty", tmp_path / "absent"):
        with pytest.raises(RuntimeError) as error:
            bpy.ops.fastgs.import_capture(filepath=str(path))
        assert path.name in str(error.value) and len(str(error.value).strip().splitlines()) == 1
    folder, _, _ = capture()
    (folder / "cameras.json").unlink()
    with pytest.raises(RuntimeError, match="where.*cameras"):
        bpy.ops.fastgs.import_capture(filepath=str(folder))
    with pytest.raises(RuntimeError, match="capture.*chosen"):
        bpy.ops.fastgs.import_capture()
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before
