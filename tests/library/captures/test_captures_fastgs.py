# SPDX-License-Identifier: GPL-3.0-or-later
"""FAST-GS captures, folders without poses, and what all layouts share: options, pictures' kinds, masks."""
from __future__ import annotations

import json

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from spots import SpotRig

import fastgs_blender as fg
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import identify, open_capture
from fastgs_blender.captures.layouts.fastgs import write_cameras
from fastgs_blender.captures.pixels.checks import check, problems
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.captures.posing import with_cameras
from fastgs_blender.rendering.colour import srgb_to_linear

NAMES = ["cam00", "cam01", "left eye"]
SIMPLE = Intrinsics(150, 152, 81, 59, 160, 120)
RIG = SpotRig(SIMPLE, cameras=3, sigma=2.5)


def describe(folder, rig=RIG, names=NAMES, distortion=None, **more):
    """Write cameras.json for a rig."""
    cameras = [dict(name=name, **_intrinsics(rig.given), world_to_camera=rig.poses[i], **({"distortion": distortion} if distortion else {}))
               for i, name in enumerate(names)]
    return write_cameras(folder, cameras, **{"frame_count": rig.frames, "fps": 25, "held_out": names[:1]} | more)


def _intrinsics(given):
    return dict(zip(("fx", "fy", "cx", "cy", "width", "height"), given))


@pytest.fixture
def capture_folder(tmp_path):
    """A complete capture of PNGs."""
    describe(tmp_path, axes="RFU")
    for i, name in enumerate(NAMES):
        for frame in range(RIG.frames):
            RIG.write_picture(tmp_path / name / f"{frame + 1:04}.png", i, frame)
    return tmp_path


def test_pictures(capture_folder, tmp_path_factory):
    capture = open_capture(capture_folder)
    assert (capture.layout, capture.axes, capture.views, capture.held_out_views) == ("fast-gs capture", "RFU", NAMES, ["cam00"])
    assert capture.clip == fg.Clip(3, 25, 1) and [shot.t for shot in capture.at_frame(1)] == [1 / 3] * 3
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    RIG.check(open_capture(capture_folder / "cameras.json"), tmp_path_factory.mktemp("cache"), NAMES)


def test_films_that_are_not_beside_the_description_are_told(tmp_path):
    """Every camera that has neither a folder nor a film there, whose ending may be in capital letters."""
    describe(tmp_path)
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / "films" / f"{name}.mp4", i)
    with pytest.raises(fg.FastGSError, match="called cam00 beside"):
        open_capture(tmp_path)
    for name in NAMES:
        (tmp_path / "films" / f"{name}.mp4").rename(tmp_path / f"{name}.MP4")
    assert not problems(open_capture(tmp_path))


def test_half_size_is_the_mean_of_four_pixels(capture_folder, tmp_path_factory):
    capture = open_capture(capture_folder, scale=0.5)
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    store = FrameStore(capture, folder=tmp_path_factory.mktemp("cache"), whole=True)
    for shot in capture.shots[::4]:
        exact = RIG.picture(NAMES.index(shot.view), shot.frame).reshape(60, 2, 80, 2, 3).mean((1, 3))
        assert np.abs(store.pixels(shot).rgb * 255 - exact).max() <= 0.5001
        camera = shot.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height) == (75, 76, 40.5, 29.5, 80, 60)


def test_other_sizes_keep_spots_in_place(capture_folder, tmp_path_factory):
    RIG.check(open_capture(capture_folder, scale=0.7), tmp_path_factory.mktemp("cache"), NAMES)


@pytest.mark.parametrize(("model", "lens"), [
    ({"model": "opencv", "k1": -0.1, "k2": 0.02, "p1": 0.003, "p2": -0.002}, Lens("opencv", (-0.1, 0.02), (0.003, -0.002))),
    ({"model": "fisheye", "k1": 0.02, "k3": -0.01}, Lens("fisheye", (0.02, 0, -0.01))),
])
def test_distortion_is_undone(tmp_path, tmp_path_factory, model, lens):
    rig = SpotRig(SIMPLE, lens, cameras=2, frames=2)
    describe(tmp_path, rig, NAMES[:2], distortion=model)
    for i, name in enumerate(NAMES[:2]):
        for frame in range(2):
            rig.write_picture(tmp_path / name / f"{frame + 1}.png", i, frame)
    rig.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES[:2])


def test_videos_and_jpegs(tmp_path, tmp_path_factory):
    describe(tmp_path)
    RIG.write_video(tmp_path / "cam00.mp4", 0)
    RIG.write_video(tmp_path / "cam01.mkv", 1)
    for frame in range(RIG.frames):
        RIG.write_picture(tmp_path / "left eye" / f"take2_{frame + 1:03}.jpg", 2, frame)
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)


def test_one_camera_with_many_poses(tmp_path, tmp_path_factory):
    rig = SpotRig(SIMPLE, cameras=3, frames=1)
    write_cameras(tmp_path, [dict(name="hand", **_intrinsics(SIMPLE), world_to_camera=np.array(rig.poses))], frame_count=3, fps=30)
    for i in range(3):
        rig.write_picture(tmp_path / "hand" / f"{i + 1}.png", i, 0)
    capture = open_capture(tmp_path)
    assert [shot.t for shot in capture.shots] == [0, 1 / 3, 2 / 3] and capture.views == ["hand"]
    for shot, pose in zip(capture.shots, rig.poses):
        np.testing.assert_allclose(shot.camera.world_to_camera, pose, atol=1e-12)


def test_options(capture_folder):
    part = open_capture(capture_folder, frames=slice(1, None), held_out=["left eye", "cam01"])
    assert part.clip == fg.Clip(2, 25, 2) and {shot.frame for shot in part.shots} == {0, 1} and {shot.t for shot in part.shots} == {0, 0.5}
    assert part.held_out_views == ["cam01", "left eye"] and {shot.view for shot in part.training} == {"cam00"}
    assert part.shots[0].image.path.name == "0002.png"
    assert not [note for note in part.notes if "asked for" in note]
    beyond = open_capture(capture_folder, frames=slice(1, 99999))
    assert beyond.clip == part.clip and any(note.startswith("the part asked for goes on behind") for note in beyond.notes)
    every_second = open_capture(capture_folder, frames=slice(0, None, 2))
    assert every_second.clip == fg.Clip(2, 12.5, 1) and not open_capture(capture_folder, held_out=[]).held_out
    for options, words in (({"held_out": ["cam9"]}, "no view 'cam9'"), ({"held_out": NAMES}, "held out.*train"), ({"scale": 0}, "scale"),
                           ({"scale": 1.5}, "scale"), ({"frames": slice(7, 9)}, "none.*3 frames"), ({"layout": "x"}, "no layout"),
                           ({"frames": slice(None, None, -1)}, "forwards"), ({"layout": "n3v"}, "poses_bounds.npy")):
        with pytest.raises(fg.FastGSError, match=words):
            open_capture(capture_folder, **options)


def test_size_and_focus_of_the_scene(capture_folder):
    capture = open_capture(capture_folder, held_out=[])
    centres = np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in RIG.poses])
    assert capture.extent == pytest.approx(1.1 * np.linalg.norm(centres - centres.mean(0), axis=1).max())
    assert np.linalg.norm(capture.focus) < 0.3  # the cameras look at about the origin, from 3 away


# Colours, alpha, masks


def one_picture(folder, shape=(6, 8), **more):
    height, width = shape
    return write_cameras(folder, [dict(name="a", width=width, height=height, fx=9, fy=9, cx=4, cy=3, world_to_camera=np.eye(4))],
                         frame_count=1, fps=24, **more)


def pixels(folder, cache, **options):
    capture = open_capture(folder, **options)
    check(capture)
    return FrameStore(capture, folder=cache).pixels(capture.shots[0])


def write_exr(path, rgba):
    path.parent.mkdir(exist_ok=True)
    planes = {name: np.ascontiguousarray(rgba[..., i], np.float32) for i, name in enumerate("RGBA"[:rgba.shape[2]])}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(str(path))


def test_exr_is_scene_linear_and_premultiplied(tmp_path, tmp_path_factory, rng):
    one_picture(tmp_path)
    shown, alpha = rng.uniform(0, 1, (6, 8, 3)).astype(np.float32), rng.uniform(0.2, 1, (6, 8)).astype(np.float32)
    linear = srgb_to_linear(shown)
    linear[0, 0] = 40  # brighter than white is white
    write_exr(tmp_path / "a" / "1.exr", np.concatenate([linear * alpha[..., None], alpha[..., None]], -1))
    found = pixels(tmp_path, tmp_path_factory.mktemp("cache"))
    shown[0, 0] = 1
    assert np.abs(found.rgb - shown).max() < 2e-5 and np.abs(found.mask - alpha).max() < 1e-5  # 16 bits


def test_exr_that_the_file_calls_display_colours(tmp_path, tmp_path_factory, rng):
    one_picture(tmp_path, colour="srgb")
    shown = rng.uniform(0, 1, (6, 8, 3)).astype(np.float32)
    write_exr(tmp_path / "a" / "1.exr", shown)
    found = pixels(tmp_path, tmp_path_factory.mktemp("cache"))
    assert np.abs(found.rgb - shown).max() < 2e-5 and found.mask is None


def test_alpha_and_mask_file_end_in_one_mask_and_alpha_stays(tmp_path, tmp_path_factory, rng):
    one_picture(tmp_path)
    rgba, mask = rng.integers(0, 256, (6, 8, 4), np.uint8), rng.integers(0, 256, (6, 8), np.uint8)
    for place, picture in (("a", rgba), ("masks/a", mask)):
        (tmp_path / place).mkdir(parents=True)
        Image.fromarray(picture).save(tmp_path / place / "0001.png")
    found = pixels(tmp_path, tmp_path_factory.mktemp("cache"))
    np.testing.assert_array_equal(np.round(found.rgb * 255), rgba[..., :3])
    assert np.abs(found.mask - rgba[..., 3] / 255.0 * mask / 255.0).max() <= 0.51 / 255
    np.testing.assert_array_equal(np.round(found.alpha * 255), rgba[..., 3])
    half = pixels(tmp_path, tmp_path_factory.mktemp("cache"), scale=0.5)
    assert np.abs(half.alpha - rgba[..., 3].reshape(3, 2, 4, 2).mean((1, 3)) / 255).max() <= 0.51 / 255


def test_transparent_colour_does_not_bleed_into_smaller_pictures(tmp_path, tmp_path_factory):
    one_picture(tmp_path)
    rgba = np.zeros((6, 8, 4), np.uint8)
    rgba[:] = 0, 255, 0, 0
    rgba[:, ::2] = 200, 100, 50, 255
    (tmp_path / "a").mkdir()
    Image.fromarray(rgba).save(tmp_path / "a" / "0001.png")
    found = pixels(tmp_path, tmp_path_factory.mktemp("cache"), scale=0.5)
    assert np.abs(found.rgb * 255 - [200, 100, 50]).max() < 0.6 and np.abs(found.mask - 0.5).max() < 0.51 / 255


def test_points_with_times(capture_folder):
    header = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property float {c}\n" for c in "xyzt") + "".join(
        f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_header\n"
    (capture_folder / "points.ply").write_text(header + "1 2 3 0.5 255 0 51\nnan 0 0 0 0 0 0\n")
    points = open_capture(capture_folder).points
    np.testing.assert_allclose(points.xyz, [[1, 2, 3]])
    np.testing.assert_allclose(points.rgb, [[1, 0, 0.2]], atol=1e-6)
    np.testing.assert_allclose(points.t, [0.5])


# What is wrong


BROKEN = {
    "not JSON": (None, '{"format": "fast-gs capture", ', "not JSON"), "no cameras": ("cameras", [], "list of at least 1"),
    "newer": ("version", 9, "newer"), "no frames": ("frame_count", 0, "frame_count"),
    "too many frames": ("frame_count", 10**12, "frame_count"),
    "axes": ("axes", "XYZ", "axes"), "held out": ("held_out", ["nobody"], "nobody"), "colour": ("colour", "aces", "colour"),
    "fps": ("fps", 0, "fps"), "masks": ("masks", "?", "masks"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_broken_descriptions_are_one_sentence(capture_folder, what):
    key, value, words = BROKEN[what]
    file = capture_folder / "cameras.json"
    file.write_text(value if key is None else json.dumps(json.loads(file.read_text()) | {key: value}))
    with pytest.raises(fg.FastGSError, match=words) as error:
        open_capture(capture_folder)
    assert str(file) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("key", "value", "words"), [
    ("name", "../elsewhere", "name"), ("name", "cam01", "camera cam01 is there twice"), ("name", 3, "name"), ("width", 0, "width"),
    ("fx", -1, "above 0"), ("fy", None, "finite"), ("world_to_camera", np.full((4, 4), 2).tolist(), "rotation"),
    ("world_to_camera", [np.eye(4).tolist()] * 2, "2 poses for 3 frames"), ("world_to_camera", "x", "finite"),
    ("distortion", {"model": "anamorphic"}, "anamorphic"), ("distortion", {"model": "opencv", "k9": 1}, "k9"),
])
def test_broken_cameras_are_one_sentence(capture_folder, key, value, words):
    file = capture_folder / "cameras.json"
    values = json.loads(file.read_text())
    values["cameras"][0][key] = value
    file.write_text(json.dumps(values))
    with pytest.raises(fg.FastGSError, match=words) as error:
        open_capture(capture_folder)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("cut", [0, 100, 300, -20])
def test_damaged_exr_is_one_sentence(tmp_path, tmp_path_factory, cut, rng):
    one_picture(tmp_path)
    file = tmp_path / "a" / "1.exr"
    write_exr(file, rng.uniform(0, 1, (6, 8, 3)))
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(fg.FastGSError, match="1.exr") as error:
        pixels(tmp_path, tmp_path_factory.mktemp("cache"))
    assert "\n" not in str(error.value)


def test_exr_that_claims_to_be_huge(tmp_path, tmp_path_factory):
    one_picture(tmp_path)
    file = tmp_path / "a" / "1.exr"
    write_exr(file, np.zeros((6, 8, 3)))
    small, huge = (np.array([0, 0, w - 1, h - 1], "<i4").tobytes() for w, h in ((8, 6), (60_000, 60_000)))
    content = file.read_bytes()
    assert content.count(small) == 2
    file.write_bytes(content.replace(small, huge))
    with pytest.raises(fg.FastGSError, match="1.exr"):
        pixels(tmp_path, tmp_path_factory.mktemp("cache"))


def test_nan_poses_are_refused(capture_folder):
    file = capture_folder / "cameras.json"
    values = json.loads(file.read_text())
    values["cameras"][1]["world_to_camera"][0][3] = float("nan")
    file.write_text(json.dumps(values))
    with pytest.raises(fg.FastGSError, match="camera 1 .cam01.*finite"):
        open_capture(capture_folder)


def test_what_is_no_capture(tmp_path):
    for path, words in ((tmp_path / "none", "no such capture"), (tmp_path, "no capture")):
        with pytest.raises(fg.FastGSError, match=words):
            open_capture(path)
    (tmp_path / "cameras.json").write_text("[]")
    with pytest.raises(fg.FastGSError, match="no capture"):
        identify(tmp_path / "cameras.json")


# Without poses


def test_folders_without_poses(tmp_path, tmp_path_factory):
    for i, name in enumerate(NAMES):
        for frame in range(RIG.frames):
            RIG.write_picture(tmp_path / name / f"{frame + 17:05}.png", i, frame)
    capture = open_capture(tmp_path, scale=0.5)
    assert not capture.posed and capture.views == NAMES and capture.clip == fg.Clip(3, 30, 17) and not problems(capture)
    assert FrameStore(capture, folder=tmp_path_factory.mktemp("cache")).size(capture.shots[0]) == (80, 60)
    cameras = {name: fg.Camera(80, 60, 75, 76, 40.5, 29.5, RIG.poses[i]) for i, name in enumerate(NAMES)}
    posed = with_cameras(capture, cameras)
    assert posed.posed
    RIG.check(posed, tmp_path_factory.mktemp("cache"), NAMES)
    two = with_cameras(capture, {name: cameras[name] for name in NAMES[:2]})
    assert two.views == NAMES[:2] and "left eye" in two.notes[-1]
    with pytest.raises(fg.FastGSError, match="none.*views"):
        with_cameras(capture, {})


def test_a_lens_that_was_found_later(tmp_path, tmp_path_factory):
    rig = SpotRig(SIMPLE, Lens("opencv", (-0.12,)), cameras=2, frames=1)
    for i in range(2):
        rig.write_picture(tmp_path / NAMES[i] / "1.png", i, 0)
    capture = open_capture(tmp_path)
    cameras = {name: fg.Camera(160, 120, *SIMPLE[:4], rig.poses[i]) for i, name in enumerate(NAMES[:2])}
    rig.check(with_cameras(capture, cameras, dict.fromkeys(cameras, rig.lens)), tmp_path_factory.mktemp("cache"), NAMES[:2])


def test_videos_without_poses(tmp_path):
    for i in range(2):
        RIG.write_video(tmp_path / f"{NAMES[i]}.mp4", i, fps=50)
    capture = open_capture(tmp_path)
    assert not capture.posed and capture.views == NAMES[:2] and capture.clip == fg.Clip(3, 50, 0) and not problems(capture)
