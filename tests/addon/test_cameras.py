# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras of captures and camera paths: in exactly, out again, with what was filmed behind them."""
from __future__ import annotations

import json
import os
import threading

import bpy
import by_hand
import image_files
import numpy as np
import pytest
from mathutils import Matrix

FRAMES = 6
POSE, PIXELS = 1e-5, 1e-4
"""What a round trip may lose: in poses, and at places of the picture."""


@pytest.fixture
def cameras(module):
    return module("scene.camera")


@pytest.fixture
def camera_paths(module):
    return module("fastgs_blender.cameras.paths")


def make_camera(fg, rng, width=320, height=240, full=True):
    """A camera that looks about; full: unequal focal lengths, principal point off the middle."""
    eye = rng.uniform(-4, 4, 3)
    focal = width * rng.uniform(0.6, 1.6)
    centre, stretch = (rng.uniform(0.4, 0.6, 2), rng.uniform(0.9, 1.1)) if full else ((0.5, 0.5), 1.0)
    return fg.Camera(width, height, focal, focal * stretch, centre[0] * width, centre[1] * height,
                     by_hand.look_at(eye, eye + rng.normal(size=3), up=rng.normal(size=3)))


def seen(camera, rng, count=30):
    """Points of the world within the camera's picture."""
    at, z = rng.uniform(0, 1, (count, 2)) * [camera.width, camera.height], rng.uniform(1, 8, count)
    local = np.stack([(at[:, 0] - camera.cx) / camera.fx * z, (at[:, 1] - camera.cy) / camera.fy * z, z], 1)
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def project(camera, world):
    x, y, z = (world @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)


def assert_same(got, wanted, pixels=PIXELS):
    assert (got.width, got.height) == (wanted.width, wanted.height)
    np.testing.assert_allclose(got.world_to_camera, wanted.world_to_camera, atol=POSE)
    points = seen(wanted, np.random.default_rng(0))
    np.testing.assert_allclose(project(got, points), project(wanted, points), atol=pixels)


def in_world(camera, matrix):
    """The camera of a capture's world in Blender's, to which `matrix` leads."""
    from dataclasses import replace

    return replace(camera, world_to_camera=camera.world_to_camera @ np.linalg.inv(np.array(matrix, float)), window=None)


@pytest.fixture
def now(scene, cameras):
    """now(object): the library's camera of a Blender camera on the current frame, through the engine's own eyes."""

    def read(obj):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return cameras.camera_of(obj.evaluated_get(depsgraph), cameras.render_area(scene.render), depsgraph)

    return read


@pytest.mark.parametrize("seed", range(6))
def test_optics_are_the_inverse_of_what_the_engine_reads(scene, fg, module, now, seed):
    rng = np.random.default_rng(seed)
    wanted = make_camera(fg, rng, *((320, 240), (240, 320))[seed % 2])
    place = module("operators.capture_cameras")
    obj = bpy.data.objects.new("C", bpy.data.cameras.new("C"))
    scene.collection.objects.link(obj)
    place.set_optics(obj.data, wanted)
    place.set_pose(obj, wanted)
    place.use_render_size(scene, obj)
    assert_same(now(obj), wanted)
    assert scene.camera == obj


def test_a_very_wide_lens(scene, fg, module, now):
    wanted = fg.Camera(640, 480, 12, 12, 300, 260, np.eye(4))
    place = module("operators.capture_cameras")
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


def test_writing_undistorted_pictures_can_be_interrupted_and_goes_on(scene, capture, module, monkeypatch):
    """Every film is decoded once for all of its pictures; what an interruption has left is not written again."""
    undistorted = module("scene.cameras.undistorted")
    opened = module("fastgs_blender.captures").open_capture(capture(lens=True)[0])
    decode, calls = undistorted.decoding.decode, []

    def counted(shots, scale):
        calls.append(sorted(shot.frame for shot in shots))
        return decode(shots, scale)

    save, saved, held = undistorted._save, [], threading.Event()

    def saving(file, pixels):
        if len(saved) >= 4:
            held.wait()  # until the interruption
        saved.append(file)
        save(file, pixels)

    monkeypatch.setattr(undistorted.decoding, "decode", counted)
    monkeypatch.setattr(undistorted, "_save", saving)
    steps = undistorted.steps(opened, opened.shots)
    while (now := next(steps))[0] < 4:
        assert now[1] == 3 * FRAMES
    threading.Timer(0.2, held.set).start()
    steps.close()
    assert 4 <= len(saved) < 3 * FRAMES
    first, calls[:] = set(saved), []
    assert list(undistorted.steps(opened, opened.shots))[-1] == (3 * FRAMES - len(first),) * 2
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
    with pytest.raises(RuntimeError, match="where its cameras are"):
        bpy.ops.fastgs.import_capture(filepath=str(folder))
    with pytest.raises(RuntimeError, match="No capture was chosen"):
        bpy.ops.fastgs.import_capture()
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before


# ---- camera paths --------------------------------------------------------------------------------------------------------

FORMATS = {'FASTGS': True, 'NERFSTUDIO': False, 'INSTANT_NGP': False, 'SUPERSPLAT': False, 'CAMERAS_JSON': True, 'COLMAP': True}
"""Each format, and whether it holds any intrinsics."""


@pytest.fixture
def flight(scene, fg, module):
    """flight(full): a Blender camera with a key on each of ten frames from 7 on, animated focal length; full: shifted, oblong pixels."""

    def fly(full):
        scene.frame_start, scene.frame_end = 7, 16
        scene.render.resolution_x, scene.render.resolution_y = 320, 240
        scene.render.pixel_aspect_y = 1.25 if full else 1.0
        obj = bpy.data.objects.new("Flight", bpy.data.cameras.new("Flight"))
        scene.collection.objects.link(obj)
        scene.camera = obj
        obj.data.shift_x, obj.data.shift_y = (0.07, -0.04) if full else (0, 0)
        obj.rotation_mode = 'QUATERNION'
        for i, frame in enumerate(range(7, 17)):
            eye = (3 * np.cos(0.2 * i), 3 * np.sin(0.2 * i), 1 + 0.1 * i)
            obj.matrix_world = Matrix(by_hand.blender_matrix(by_hand.look_at(eye, (0, 0, 0.3))).tolist())
            obj.data.lens = 30 + 2 * i
            obj.keyframe_insert("location", frame=frame)
            obj.keyframe_insert("rotation_quaternion", frame=frame)
            obj.data.keyframe_insert("lens", frame=frame)
        return obj

    return fly


def shots_of(scene, obj, now, first=7, last=16):
    found = []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        found.append(now(obj))
    return found


@pytest.mark.parametrize("splats", [False, True])
@pytest.mark.parametrize("kind", FORMATS)
def test_a_path_goes_out_and_comes_back(scene, flight, now, tmp_path, kind, splats, make_model, model_file, splat_object):
    obj = flight(FORMATS[kind])
    if splats:
        matrix = Matrix.Translation((1, 2, 0)) @ Matrix.Rotation(0.3 if kind != 'SUPERSPLAT' else np.pi / 2, 4, 'Z')
        matrix = matrix @ Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1))) @ Matrix.Scale(2, 4)
        splat_object(model_file(make_model()), matrix=np.array(matrix))
    wanted = shots_of(scene, obj, now)
    scene.frame_set(9)
    file = tmp_path / ("model" if kind == 'COLMAP' else "path.json")
    assert bpy.ops.fastgs.export_camera_path(filepath=str(file), format=kind) == {'FINISHED'}
    assert scene.frame_current == 9
    assert bpy.ops.fastgs.import_camera_path(filepath=str(file)) == {'FINISHED'}
    assert scene.camera != obj and scene.frame_current == 9
    for got, camera in zip(shots_of(scene, scene.camera, now), wanted, strict=True):
        assert_same(got, camera)


def test_the_file_holds_what_the_engine_renders(scene, flight, now, tmp_path, camera_paths, module):
    """Not only do export and import agree: the file itself is right, in the world of the capture's axes."""
    wanted = shots_of(scene, flight(True), now)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "cameras.json"), format='CAMERAS_JSON')
    upright = np.array(module("scene.objects").axes_matrix("RDF"))
    for entry, camera in zip(json.loads((tmp_path / "cameras.json").read_text()), wanted, strict=True):
        centre = np.linalg.inv(camera.world_to_camera)[:3, 3]
        np.testing.assert_allclose(upright[:3, :3] @ entry["position"], centre, atol=1e-6)
        np.testing.assert_allclose(upright[:3, :3] @ np.array(entry["rotation"])[:, 2], camera.world_to_camera[2, :3], atol=1e-6)
        assert (entry["fx"], entry["fy"], entry["cx"]) == (camera.fx, camera.fy, camera.cx)


def test_scaled_world_keeps_positions(scene, flight, now, tmp_path, make_model, model_file, splat_object):
    obj = flight(False)
    splats = splat_object(model_file(make_model()), matrix=np.diag([4.0, 4, 4, 1]))
    scene.frame_set(7)
    at = np.array(obj.matrix_world.translation)
    bpy.context.view_layer.objects.active = splats
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"), use_range=True, frame_start=7, frame_end=7)
    (entry,) = json.loads((tmp_path / "p.json").read_text())["frames"]
    np.testing.assert_allclose(np.linalg.inv(entry["world_to_camera"])[:3, 3], at / 4, atol=1e-6)
    splats.scale = (1, 2, 1)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="stretched"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))


def test_a_file_s_own_keys_are_fewer_and_editable(scene, fg, tmp_path, camera_paths, module):
    rng = np.random.default_rng(0)
    shots = [make_camera(fg, rng, 64, 48, full=False) for _ in range(21)]
    path = camera_paths.CameraPath(shots, 12.0, 1, "RFU", [(0.0, shots[0]), (10.0, shots[10]), (20.0, shots[20])])
    camera_paths.save_path(path, tmp_path / "p.json")
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), keys='KEYS', keep_speed=True)
    curves = list(module("scene.cameras.keys").curves(scene.camera))
    assert len(curves) == 7
    for curve in curves:
        assert [round(point.co.x, 4) for point in curve.keyframe_points] == [1, 21, 41], "twice as long at 24 frames a second"
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), set_scene=True)
    assert (scene.render.fps, scene.frame_end) == (12, 21)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)


def test_the_scenes_camera_can_take_the_path(scene, flight, now, tmp_path):
    obj = flight(False)
    wanted = shots_of(scene, obj, now)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))
    rig = bpy.data.objects.new("Rig", None)
    scene.collection.objects.link(rig)
    obj.parent = rig
    rig.location = (1, 1, 1)
    count = len(bpy.data.objects)
    bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / "p.json"), new_camera=False)
    assert scene.camera == obj and len(bpy.data.objects) == count
    for got, camera in zip(shots_of(scene, obj, now), wanted, strict=True):
        assert_same(got, camera)


def test_losses_and_errors_are_reported(scene, flight, add_camera, tmp_path, capfd):
    flight(True)
    bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"), format='NERFSTUDIO')
    assert "shift" in capfd.readouterr().out
    (tmp_path / "bad.json").write_text('{"camera_path": []}')
    before = len(bpy.data.objects)
    for path in ("bad.json", "absent.json"):
        with pytest.raises(RuntimeError, match=path):
            bpy.ops.fastgs.import_camera_path(filepath=str(tmp_path / path))
    assert len(bpy.data.objects) == before
    with pytest.raises(RuntimeError, match="absent"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "absent" / "p.json"))
    add_camera(type='ORTHO')
    with pytest.raises(RuntimeError, match="Perspective"):
        bpy.ops.fastgs.export_camera_path(filepath=str(tmp_path / "p.json"))


def test_menus():
    def entries(menu):
        return [f.__name__ for f in menu.draw._draw_funcs if "fastgs" in f.__module__]

    assert entries(bpy.types.TOPBAR_MT_file_import) == ["draw_import"]
    assert entries(bpy.types.TOPBAR_MT_file_export) == ["draw_export"]
