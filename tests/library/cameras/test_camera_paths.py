# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera paths of other programs: what is written is read again, and what their own files say is understood."""
from __future__ import annotations

import dataclasses
import json
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import tiny_captures
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.cameras.paths import FORMATS, CameraPath, Picture, load_path, save_path
from fastgs_blender.captures import open_capture
from fastgs_blender.util.errors import LossWarning
from fastgs_blender.util.rotations import to_matrices

NAMES = [module.name for module in FORMATS]
FULL = ("fastgs", "cameras.json", "colmap", "transforms.json")
"""Formats that hold any intrinsics."""
PARTS = st.text("ab z09-_.é", min_size=1, max_size=8).filter(lambda part: part not in (".", ".."))
CAMERA_NAMES = st.lists(PARTS, min_size=1, max_size=3).map("/".join)
"""Of cameras: paths of pictures, with blanks too."""


def random_path(rng, frames: int, full: bool, level: bool) -> CameraPath:
    """Cameras that fly about; full: any principal point and pixels; level: without roll, y down, seldom straight up or down."""
    width, height = (int(v) for v in rng.integers(16, 2000, 2))
    cameras = []
    for _ in range(frames):
        q = rng.normal(size=4)
        rotation = to_matrices((q / np.linalg.norm(q))[None])[0]
        if level:
            forward = rotation[2] * [1, 0.5, 1]
            right = np.cross([0, 1, 0], forward)
            rotation = np.stack([right / np.linalg.norm(right), np.zeros(3), forward / np.linalg.norm(forward)])
            rotation[1] = np.cross(rotation[2], rotation[0])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, rng.uniform(-10, 10, 3)
        focal = max(width, height) * rng.uniform(0.3, 4)
        centre, stretch = (rng.uniform(0.3, 0.7, 2), rng.uniform(0.8, 1.2)) if full else ((0.5, 0.5), 1.0)
        cameras.append(fg.Camera(width, height, focal, focal * stretch, centre[0] * width, centre[1] * height, pose))
    return CameraPath(cameras, float(rng.integers(8, 61)), int(rng.integers(-50, 5000)), "RDF")


def project(camera, world) -> np.ndarray:
    """Pixels [n, 2] of points [n, 3]."""
    x, y, z = (world @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
    return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)


def seen(camera, rng, count: int = 20) -> np.ndarray:
    """Points [n, 3] of the world that the camera sees within its picture."""
    at = rng.uniform(0, 1, (count, 2)) * [camera.width, camera.height]
    z = rng.uniform(0.5, 20, count)
    local = np.stack([(at[:, 0] - camera.cx) / camera.fx * z, (at[:, 1] - camera.cy) / camera.fy * z, z], 1)
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def assert_same(got, wanted, rng):
    assert len(got) == len(wanted)
    for a, b in zip(got, wanted, strict=True):
        assert (a.width, a.height) == (b.width, b.height)
        np.testing.assert_allclose(a.world_to_camera, b.world_to_camera, atol=1e-9)
        points = seen(b, rng)
        np.testing.assert_allclose(project(a, points), project(b, points), atol=1e-6)


def saved(path, file, name) -> str:
    """What is told of losses when a path is written."""
    with warnings.catch_warnings(record=True) as lost:
        warnings.simplefilter("always")
        save_path(path, file, name)
    assert all(w.category is LossWarning for w in lost)
    return " ".join(str(w.message) for w in lost)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 2**32 - 1), full=st.booleans(), level=st.booleans(), start=st.integers(-50, 100_001), fps=st.floats(1, 200),
       names=st.one_of(st.integers(1, 40), st.lists(CAMERA_NAMES, min_size=1, max_size=9, unique=True)))
@settings(max_examples=40)
def test_all_comes_back_or_the_loss_is_told(name, seed, full, level, start, fps, names, tmp_path):
    """Number, names, poses, intrinsics, sizes and times; far within the 1e-5 of a pose and the 1e-4 pixels that are promised."""
    rng = np.random.default_rng(seed)
    still = isinstance(names, list)
    path = random_path(rng, len(names) if still else names, full, level)
    sizes = rng.integers(16, 2000, (len(path), 2)).tolist() if full and level else [[c.width, c.height] for c in path.cameras]
    cameras = [dataclasses.replace(c, width=w, height=h, window=(0, 0, w, h)) for c, (w, h) in zip(path.cameras, sizes, strict=True)]
    path = CameraPath(cameras, fps, start, "RDF", names=names if still else ())
    file = tmp_path / f"{seed}-{len(path)}-{fps}"
    told = saved(path, file, name)
    moves = not still and len(path) > 1
    fits, upright = name in FULL or not full, name != "supersplat" or level
    rate = name in ("cameras.json", "colmap") and moves
    assert [word in told for word in ("shift", "square", "roll", "no size", "no names", "holds no frame rate;")] == [
        not fits, not fits, not upright, name == "supersplat", name == "supersplat" and still, rate]
    assert told or (fits and upright and not rate)
    got = load_path(file, Picture(*sizes[0], fps) if "no size" in told else None)
    if "rate below" in told:
        return
    order = sorted(range(len(path)), key=lambda i: path.names[i]) if still and name == "colmap" else range(len(path))
    assert len(got) == len(path)
    if still and "no names" not in told:
        assert list(got.names) == [path.names[i] for i in order]
    if moves and not rate:
        assert got.fps == pytest.approx(fps, rel=1e-12)
    if fits and upright:
        assert_same(got.cameras, [path.cameras[i] for i in order], rng)
    elif upright:
        for a, i in zip(got.cameras, order, strict=True):
            np.testing.assert_allclose(a.world_to_camera, path.cameras[i].world_to_camera, atol=1e-9)


def test_our_own_keeps_keys_too(rng, tmp_path):
    path = random_path(rng, 5, True, False)
    path = CameraPath(path.cameras, 25.0, 3, "RUB", [(0.0, path.cameras[0]), (2.5, path.cameras[3])])
    save_path(path, tmp_path / "p.json")
    got = load_path(tmp_path / "p.json")
    assert (got.axes, [frame for frame, _ in got.keys]) == ("RUB", [0.0, 2.5])
    assert_same([camera for _, camera in got.keys], [camera for _, camera in path.keys], rng)


@pytest.mark.parametrize("name", ["nerfstudio", "instant-ngp", "supersplat"])
def test_what_a_format_cannot_hold_is_told(name, rng, tmp_path):
    with pytest.warns(LossWarning) as lost:
        save_path(random_path(rng, 3, True, False), tmp_path / "p.json", name)
    text = " ".join(str(w.message) for w in lost)
    assert "shift" in text and "square" in text and ("roll" in text) == (name == "supersplat")


@pytest.mark.parametrize("name", NAMES)
def test_orthographic_cameras_are_refused(name, tmp_path):
    camera = fg.Camera(8, 8, 1, 1, 4, 4, np.eye(4), orthographic=True)
    with pytest.raises(fg.FastGSError, match="Perspective") as error:
        save_path(CameraPath([camera]), tmp_path / "p.json", name)
    assert "p.json" in str(error.value) and not list(tmp_path.glob("p.json*"))


def write(tmp_path, values, name="path.json") -> Path:
    file = tmp_path / name
    file.write_text(json.dumps(values))
    return file


def test_nerfstudio_as_its_viewer_writes_it(tmp_path):
    """A camera at (0, -5, 0) that looks along y with z up, 90 degrees high."""
    matrix = [1, 0, 0, 0, 0, 0, -1, -5, 0, 1, 0, 0, 0, 0, 0, 1]
    path = load_path(write(tmp_path, {
        "camera_type": "perspective", "render_height": 600, "render_width": 800, "fps": 30, "seconds": 2, "keyframes": [],
        "camera_path": [{"camera_to_world": matrix, "fov": 90.0, "aspect": 800 / 600}]}))
    (camera,) = path.cameras
    assert (camera.width, camera.height, path.fps) == (800, 600, 30)
    np.testing.assert_allclose(project(camera, np.array([[0, 0, 0], [0, 0, 5], [5, 0, 0]])), [[400, 300], [400, 0], [700, 300]], atol=1e-9)


def ngp_key(position, fov=90.0, **more):
    """A keyframe that looks along the capture's x, z up, at a place of the capture."""
    # camera to capture: x right = -y, y down = -z, forward = x; instant-ngp's axes are the capture's y, z, x
    capture = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    own = capture[[1, 2, 0]]
    np.testing.assert_array_equal(own, np.diag([-1, -1, 1]))  # half a turn about z
    x, y, z, w = 0, 0, 1, 0
    return {"R": [x, y, z, w], "T": (np.asarray(position, float)[[1, 2, 0]] * 0.33 + 0.5).tolist(), "fov": fov, "slice": 0.0, "scale": 1.0,
            "aperture_size": 0.0, **more}


def test_instant_ngp_frames_and_axes(tmp_path):
    file = write(tmp_path, {"path": [ngp_key((-5, 0, 0))], "time": 0.0, "loop": False})
    (camera,) = load_path(file, Picture(800, 600, 24)).cameras
    np.testing.assert_allclose(project(camera, np.array([[0, 0, 0], [0, 0, 5], [0, -5, 0]])), [[400, 300], [400, 0], [700, 300]], atol=1e-6)


def test_instant_ngp_spline(tmp_path):
    """Keyframes drawn by hand: five seconds, a B-spline, which on evenly spaced places is an even motion between its ends."""
    keys = [ngp_key((i, 0, 0), 40 + i, timestamp=(i + 1) / 7) for i in range(7)]
    values = {"path": keys, "time": 0.3, "duration_seconds": 1.0, "spline_order": 3, "loop": False}
    path = load_path(write(tmp_path, values), Picture(64, 48, 12))
    assert len(path) == 61 and len(path.keys) == 7
    x = np.array([-camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3] for camera in path.cameras])[:, 0]
    np.testing.assert_allclose(np.diff(x)[10:50], 0.1, atol=1e-9)
    assert x[0] == pytest.approx(1 / 6) and x[30] == pytest.approx(3)
    fov = np.degrees(2 * np.arctan(24 / path.cameras[30].fy))
    assert fov == pytest.approx(43)
    np.testing.assert_allclose([frame for frame, _ in path.keys], np.arange(7) * 10)


@pytest.mark.parametrize(("order", "between"), [(0, 1.0), (1, 0.75), (2, 0.5 * 0.75**2)])
def test_instant_ngp_other_orders_and_its_own_times(tmp_path, order, between):
    keys = [ngp_key((x, 0, 0), timestamp=t) for x, t in ((0, 1.0), (1, 3.0), (2, 4.0))]
    path = load_path(write(tmp_path, {"path": keys, "duration_seconds": 4.0, "spline_order": order}), Picture(64, 48, 4))
    assert len(path) == 13
    x = [-(camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3])[0] for camera in path.cameras]
    assert x[3] == pytest.approx(between)
    if order < 2:
        assert x[4] == pytest.approx(1) and x[12] == pytest.approx(2)


def splat_settings(**track):
    return {"version": 2, "cameras": [], "annotations": [], "animTracks": [{
        "name": "cameraAnim", "duration": 40 / 20, "frameRate": 20, "loopMode": "none", "interpolation": "spline", "smoothness": 1,
        "keyframes": {"times": [0, 10, 30], "values": {
            "position": [0, 0, 5, 5, 0, 5, 5, 4, 5], "target": [0, 0, 0, 5, 0, 0, 5, 4, 0], "fov": [90, 60, 60]}}, **track}]}


def test_supersplat_settings(tmp_path):
    """At (0, 0, 5), looking at the origin, y up; splat files lie in PlayCanvas' world with x and y turned round."""
    path = load_path(write(tmp_path, splat_settings()), Picture(800, 600, 24))
    assert (len(path), path.fps, [frame for frame, _ in path.keys]) == (40, 20, [0, 10, 30])
    np.testing.assert_allclose(project(path.cameras[0], np.array([[0, 0, 0], [-1, 0, 0], [0, -1, 0.0]])),
                               [[400, 300], [480, 300], [400, 220]], atol=1e-9)
    for frame, key in path.keys:
        np.testing.assert_allclose(path.cameras[int(frame)].world_to_camera, key.world_to_camera, atol=1e-12)
    places = np.array([-camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3] for camera in path.cameras])
    assert np.abs(np.diff(places, 2, axis=0)).max() < 0.25, "smooth, also across keyframes"
    tall = load_path(write(tmp_path, splat_settings()), Picture(600, 800, 24)).cameras[0]
    assert tall.fy == pytest.approx(400), "the field of view is that of the longer side"
    steps = load_path(write(tmp_path, splat_settings(interpolation="step")), Picture(800, 600, 24)).cameras
    np.testing.assert_array_equal(steps[9].world_to_camera, steps[0].world_to_camera)


def test_supersplat_first_version_and_tracks_in_seconds(tmp_path):
    old = splat_settings()
    del old["version"], old["animTracks"][0]["frameRate"], old["animTracks"][0]["smoothness"]
    del old["animTracks"][0]["keyframes"]["values"]["fov"]
    old["animTracks"][0]["keyframes"]["times"] = [0, 1, 2]
    old["camera"] = {"fov": 90}
    path = load_path(write(tmp_path, old), Picture(800, 600, 24))
    assert (path.fps, [frame for frame, _ in path.keys]) == (30, [0, 30, 60])
    assert path.cameras[7].fx == pytest.approx(400)
    slow = load_path(write(tmp_path, splat_settings(frameRate=1, duration=40)), Picture(800, 600, 24))
    assert (slow.fps, len(slow), [frame for frame, _ in slow.keys]) == (24, 960, [0, 240, 720])


def test_supersplat_project(tmp_path):
    poses = [{"name": "b", "frame": 20, "position": [5, 0, 5], "target": [5, 0, 0], "fov": 60},
             {"name": "a", "frame": 0, "position": [0, 0, 5], "target": [0, 0, 0]},
             {"name": "late", "frame": 999, "position": [0, 0, 5], "target": [0, 0, 0]}]
    document = {"camera": {"fov": 90}, "poseSets": [{"name": "set0", "poses": poses}],
                "timeline": {"frames": 50, "frameRate": 25, "smoothness": 1, "loop": False}}
    file = tmp_path / "scene.ssproj"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("document.json", json.dumps(document))
        archive.writestr("splat_0.ply", b"")
    path = load_path(file, Picture(800, 600))
    assert (len(path), path.fps, [frame for frame, _ in path.keys]) == (50, 25, [0, 20])
    np.testing.assert_allclose(path.cameras[49].world_to_camera, path.cameras[20].world_to_camera, atol=1e-12)
    assert path.cameras[0].fx == pytest.approx(400)


@pytest.mark.parametrize(("values", "words"), [
    ({"camera_path": []}, "at least 1"), ({"camera_path": [{}]}, "camera_to_world"),
    ({"camera_type": "fisheye", "camera_path": []}, "fisheye"),
    ({"camera_path": [{"camera_to_world": [0] * 16, "fov": 50}]}, "rotation"),
    ({"camera_path": [{"camera_to_world": np.eye(4).ravel().tolist(), "fov": 180}]}, "field of view"),
    ({"path": [{"R": [0, 0, 0, 0], "T": [0, 0, 0], "fov": 50}]}, "not be 0"),
    ({"path": [{"R": [0, 0, 0, 1], "T": [0, 0, 0], "fov": 50}], "spline_order": 9}, "spline_order"),
    ({"path": [{"R": [0, 0, 0, 1], "T": [0, 0, 0], "fov": 50, "timestamp": t} for t in (1, 1e12, 2e12)]}, "too long"),
    ({"animTracks": []}, "animation"), (splat_settings(keyframes={"times": [0], "values": {}}), "position"),
    (splat_settings(keyframes={"times": [0], "values": {"position": [0, 0, 0], "target": [0, 0, 0], "fov": [50]}}), "nowhere"),
    (splat_settings(duration=1e7), "too long"), ({"poseSets": []}, "keyframes"),
    ({"format": "fast-gs camera path", "version": 2}, "newer"), ({"format": "fast-gs camera path", "frames": [{}]}, "finite number"),
    ({"something": 1}, "no camera path"), ([], "no camera path"), (3, "no camera path"),
])
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, values, words):
    file = write(tmp_path, values)
    with pytest.raises(fg.FastGSError, match=words) as error:
        load_path(file)
    assert "path.json" in str(error.value) and len(str(error.value).splitlines()) == 1


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.json").write_text("{")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("a.txt", "a")
    expected = {"absent.json": "no such file", "empty": "no COLMAP model", "text.json": "not JSON", "other.zip": "SuperSplat"}
    for name, words in expected.items():
        with pytest.raises(fg.FastGSError, match=words):
            load_path(tmp_path / name)
    with pytest.raises(fg.FastGSError, match="p.json"):
        save_path(CameraPath([fg.Camera(8, 8, 8, 8, 4, 4, np.eye(4))]), tmp_path / "absent" / "p.json")


def test_colmap_reads_ours_and_we_read_its_text(rng, tmp_path):
    """COLMAP itself; in images.txt it ends a name at its first blank, so ours are binary."""
    names = ["a/left eye.png", "b/right.png", "c.png"]
    path = CameraPath(random_path(rng, 3, True, False).cameras, names=names)
    save_path(path, tmp_path / "sparse" / "0", "colmap")
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    images = sorted(model.images.values(), key=lambda image: image.name)
    assert [image.name for image in images] == names
    for image, camera in zip(images, path.cameras, strict=True):
        np.testing.assert_allclose(image.cam_from_world().matrix(), camera.world_to_camera[:3], atol=1e-12)
        np.testing.assert_array_equal(image.camera.params, [camera.fx, camera.fy, camera.cx, camera.cy])
    (tmp_path / "text").mkdir()
    model.write_text(tmp_path / "text")
    assert_same(load_path(tmp_path / "text").cameras, path.cameras, rng)


def test_a_colmap_model_is_no_file(rng, tmp_path):
    with pytest.raises(fg.FastGSError, match="c.json.*COLMAP.*folder"):
        save_path(random_path(rng, 2, True, False), tmp_path / "c.json", "colmap")
    assert not list(tmp_path.iterdir())


def test_names_that_a_format_cannot_hold(rng, tmp_path):
    path = CameraPath(random_path(rng, 2, False, True).cameras, 25.0, names=["left eye", "a/../b"])
    with pytest.raises(fg.FastGSError, match="a/../b"):
        save_path(path, tmp_path / "model", "colmap")


def test_a_colmap_model_with_points_is_not_replaced(rng, tmp_path):
    tiny_captures.colmap_model(tmp_path, ["a.png", "b.png"], True)
    before = tiny_captures.contents(tmp_path)
    with pytest.raises(fg.FastGSError, match="points"):
        save_path(random_path(rng, 2, True, False), tmp_path, "colmap")
    assert tiny_captures.contents(tmp_path) == before


def test_transforms_json_by_nerfstudio_s_rules(rng, tmp_path):
    """What its dataparser asks for in each frame, whose z points backwards and y up; it sorts by the names of files, which must open."""
    path = random_path(rng, 12, True, False)
    save_path(CameraPath(path.cameras, 25.0, 99_995), tmp_path / "transforms.json", "transforms.json")
    values = json.loads((tmp_path / "transforms.json").read_text())
    frames = sorted(values["frames"], key=lambda frame: frame["file_path"])
    assert frames == values["frames"] and values["camera_model"] == "PINHOLE" and values["fps"] == 25
    assert all(Path(frame["file_path"]).suffix == ".png" for frame in frames)
    assert [frame["time"] for frame in frames] == [i / 12 for i in range(12)]
    for frame, camera in zip(frames, path.cameras, strict=True):
        world = seen(camera, rng)
        x, y, z = (np.linalg.inv(frame["transform_matrix"]) @ np.hstack([world, np.ones((20, 1))]).T)[:3]
        pixels = np.stack([frame["fl_x"] * x / -z + frame["cx"], frame["fl_y"] * -y / -z + frame["cy"]], 1)
        np.testing.assert_allclose(pixels, project(camera, world), atol=1e-6)
        assert (frame["w"], frame["h"]) == (camera.width, camera.height)


@pytest.mark.parametrize("names", [(), ("left eye", "b.jpg", "c/d")])
def test_transforms_json_opens_as_a_capture(names, rng, tmp_path):
    """Beside the pictures that it names."""
    path = CameraPath(random_path(rng, 3, True, False).cameras, 12.5, names=names)
    save_path(path, tmp_path / "transforms.json", "transforms.json")
    for frame, camera in zip(json.loads((tmp_path / "transforms.json").read_text())["frames"], path.cameras, strict=True):
        picture = tmp_path / frame["file_path"]
        picture.parent.mkdir(exist_ok=True)
        Image.new("RGB", (camera.width, camera.height)).save(picture)
    capture = open_capture(tmp_path)
    assert_same([shot.camera for shot in capture.shots], path.cameras, rng)
    assert (capture.views, capture.clip.frame_count) == ((["left eye", "b", "c/d"], 1) if names else (["camera"], 3))
    assert capture.clip.fps == 12.5
    assert [shot.t for shot in capture.shots] == ([0, 0, 0] if names else pytest.approx([0, 1 / 3, 2 / 3]))


def test_transforms_json_of_others(tmp_path):
    """D-NeRF: an angle for all frames, no sizes, and frames in any order of time; nerfstudio: a lens with distortion."""
    pose = np.eye(4).tolist()
    frames = [{"file_path": f"./train/r_{i}", "time": t, "transform_matrix": [*pose[:2], [0, 0, 1, t], pose[3]]}
              for i, t in enumerate((0.5, 0, 1))]
    values = {"camera_angle_x": np.pi / 2, "frames": frames}
    path = load_path(write(tmp_path, values), Picture(800, 600))
    assert [-camera.world_to_camera[:3, 3] @ camera.world_to_camera[:3, 2] for camera in path.cameras] == [0, 0.5, 1]
    assert all((c.fx, c.fy, c.cx, c.height) == pytest.approx((400, 400, 400, 600)) for c in path.cameras) and not path.names
    frames = [{"file_path": f"images/{i}.jpg", "transform_matrix": pose} for i in (2, 1)]
    values = {"w": 80, "h": 60, "fl_x": 50, "k1": 0.1, "frames": frames}
    with pytest.warns(LossWarning, match="distortion"):
        path = load_path(write(tmp_path, values))
    assert path.names == ("images/2.jpg", "images/1.jpg") and path.cameras[0].width == 80
