# SPDX-License-Identifier: GPL-3.0-or-later
"""transforms.json as nerfstudio, instant-ngp, D-NeRF, 4D-Gaussian converters and BlenderNeRF write it."""
from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from spots import SpotRig

import fastgs_blender as fg
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.captures.pixels.store import FrameStore

NAMES = ["cam00", "cam01", "cam02"]
SIMPLE = Intrinsics(150, 152, 81, 59, 160, 120)
CENTRED = Intrinsics(150, 150, 80, 60, 160, 120)
RIG = SpotRig(SIMPLE, cameras=3, sigma=2.5)


def opengl(pose) -> list:
    """Camera-to-world with y up and z backwards, of a world-to-camera pose in OpenCV's axes."""
    return (np.linalg.inv(pose) @ np.diag([1, -1, -1, 1])).tolist()


def intrinsics(given) -> dict:
    return dict(zip(("fl_x", "fl_y", "cx", "cy", "w", "h"), given))


def write(path, frames, **top):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**top, "frames": frames}))


def frame(rig, camera, name, **more) -> dict:
    return {"file_path": name, "transform_matrix": opengl(rig.poses[camera]), **more}


def write_rig(folder, rig=RIG, pattern="images/{name}/{frame:04}.png", start=1, timed=None, per_frame=lambda i: {}):
    """Pictures of a rig, and their frames of a transforms.json."""
    frames = []
    for i, name in enumerate(NAMES[:len(rig.poses)]):
        for k in range(rig.frames):
            place = pattern.format(name=name, frame=k + start)
            rig.write_picture(folder / place, i, k)
            frames.append(frame(rig, i, place, **({} if timed is None else {"time": timed(k)}), **per_frame(i)))
    return frames


@pytest.mark.parametrize("pattern", ["images/{name}/{frame:04}.png", "./images/{name}_{frame:04}.png", "{name}/frame_{frame:05}.jpg"])
@pytest.mark.parametrize("timed", [None, lambda k: k / 3, lambda k: k, lambda k: k / 30])
def test_a_rig(tmp_path, tmp_path_factory, pattern, timed):
    write(tmp_path / "transforms.json", write_rig(tmp_path, pattern=pattern, timed=timed), **intrinsics(SIMPLE))
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.axes, capture.views, capture.clip.frame_count) == ("transforms.json", "RFU", NAMES, 3)
    step = 1 / 30 if timed and timed(1) == 1 / 30 else 1 / 3
    assert sorted({shot.t for shot in capture.shots}) == pytest.approx([0, step, 2 * step])
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_seconds_beyond_one_become_frames(tmp_path):
    rig = SpotRig(SIMPLE, cameras=2, frames=40, sigma=2.5)
    frames = [frame(rig, i, f"{NAMES[i]}/{k:03}.png", time=k / 25) for i in range(2) for k in range(40)]
    for entry in frames:
        (tmp_path / entry["file_path"]).parent.mkdir(exist_ok=True)
        Image.new("RGB", (160, 120)).save(tmp_path / entry["file_path"])
    write(tmp_path / "transforms.json", frames, **intrinsics(SIMPLE))
    capture = open_capture(tmp_path)
    assert capture.clip.frame_count == 40 and capture.clip.fps == pytest.approx(25)
    assert [shot.t for shot in capture.shots[::2]] == pytest.approx(np.arange(40) / 40)


def test_nerfstudio_with_lenses_of_single_pictures(tmp_path, tmp_path_factory):
    """Static, distortion per frame, masks that rule pixels out, a file of points, splits by name."""
    lens = Lens("opencv", (-0.1, 0.02, 0.003), (0.002, -0.001))
    rig = SpotRig(SIMPLE, lens, cameras=3, frames=1, sigma=2.5)
    coefficients = dict(k1=-0.1, k2=0.02, k3=0.003, k4=0.0, p1=0.002, p2=-0.001)
    more = {**intrinsics(SIMPLE), **coefficients, "mask_path": "masks/m.png"}
    frames = write_rig(tmp_path, rig, "images/{name}.png", per_frame=lambda i: more)
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.full((120, 160), 255, np.uint8)).save(tmp_path / "masks" / "m.png")
    columns = "".join(f"property float {axis}\n" for axis in "xyz")
    (tmp_path / "cloud.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{columns}end_header\n1 2 3\n")
    write(tmp_path / "transforms.json", frames, camera_model="OPENCV", ply_file_path="cloud.ply", test_filenames=["images/cam01.png"])
    capture = open_capture(tmp_path)
    assert capture.mask_means == "valid" and capture.held_out_views == ["cam01"] and capture.clip.frame_count == 1
    assert capture.shots[0].mask is not None and len(capture.points) == 1
    rig.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


@pytest.mark.parametrize("top", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True, "aabb_scale": 16}])
def test_fisheye(tmp_path, tmp_path_factory, top):
    rig = SpotRig(SIMPLE, Lens("fisheye", (0.03, -0.01, 0.002, 0.001)), cameras=2, frames=1, sigma=2.5)
    frames = write_rig(tmp_path, rig, "images/{name}.png")
    write(tmp_path / "transforms.json", frames, **top, **intrinsics(SIMPLE), k1=0.03, k2=-0.01, k3=0.002, k4=0.001)
    rig.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES[:2])


MATRIX = [[150, 0, 81], [0, 152, 59], [0, 0, 1]]


@pytest.mark.parametrize(("key", "matrix"), [
    ("K", MATRIX), ("intrinsic_matrix", [[*row, 0] for row in MATRIX] + [[0, 0, 0, 1]])])
def test_a_matrix_with_each_picture(tmp_path, tmp_path_factory, key, matrix):
    """As a studio's converter wrote them: w and h at the top, and no focal length."""
    frames = write_rig(tmp_path, per_frame=lambda i: {key: matrix})
    write(tmp_path / "transforms.json", frames, w=160, h=120)
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)


@pytest.mark.parametrize("given", ["capture", "train"])
def test_neus2_has_a_file_for_each_moment(tmp_path, tmp_path_factory, given):
    """DATA_CONVENTION.md of 19reborn/NeuS2: from_na means OpenCV's camera axes."""
    for k in range(RIG.frames):
        for split, cameras in (("train", range(2)), ("test", [2])):
            frames = []
            for i in cameras:
                place = f"images/{280 + k:06}/image_c_{i:03}_f_{280 + k:06}.png"
                RIG.write_picture(tmp_path / place, i, k)
                frames.append({"file_path": f"../{place}", "transform_matrix": np.linalg.inv(RIG.poses[i]).tolist(),
                               "intrinsic_matrix": [[*row, 0] for row in MATRIX] + [[0, 0, 0, 1]]})
            write(tmp_path / split / f"transform_{280 + k:06}.json", frames, from_na=True, w=160, h=120, scale=0.5, offset=[0.5] * 3)
    if given == "train":
        capture = open_capture(tmp_path / "train")
        assert len(capture) == 2 * RIG.frames and not capture.held_out_views
        return
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.clip.frame_count, capture.held_out_views) == ("transforms.json", 3, ["cam02"])
    RIG.check(capture, tmp_path_factory.mktemp("cache"), ["cam00", "cam01", "cam02"])


@pytest.fixture
def dnerf(tmp_path):
    """One moving camera, splits in three files, RGBA pictures without sizes or endings in the files."""
    rig = SpotRig(CENTRED, cameras=5, frames=1, sigma=2.5)
    angle = 2 * np.arctan(80 / 150)
    cameras = iter(range(5))
    for split, count in (("train", 3), ("val", 1), ("test", 1)):
        frames = []
        for k in range(count):
            i = next(cameras)
            rgb = rig.picture(i, 0)
            (tmp_path / split).mkdir(exist_ok=True)
            Image.fromarray(np.concatenate([rgb, np.full((120, 160, 1), 200, np.uint8)], -1)).save(tmp_path / split / f"r_{k:03}.png")
            frames.append(frame(rig, i, f"./{split}/r_{k:03}", time=k / 2 if count > 1 else 0.25, rotation=0.31))
        write(tmp_path / f"transforms_{split}.json", frames, camera_angle_x=angle)
    return tmp_path, rig


def test_dnerf(dnerf, tmp_path_factory):
    path, rig = dnerf
    capture = open_capture(path)
    assert capture.views == ["train", "val", "test"] and capture.held_out_views == ["val", "test"]
    assert [shot.t for shot in capture.training] == [0, 0.5, 1] and [shot.t for shot in capture.held_out] == [0.25, 0.25]
    camera = capture.shots[0].camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (160, 120, 80, 60) and camera.fx == camera.fy == pytest.approx(150)
    places = {("train", 0): 0, ("train", 0.5): 1, ("train", 1): 2, ("val", 0.25): 3, ("test", 0.25): 4}
    for shot in capture.shots:
        np.testing.assert_allclose(shot.camera.world_to_camera, rig.poses[places[shot.view, shot.t]], atol=1e-9)
    assert not problems(capture)
    pixels = FrameStore(capture, folder=tmp_path_factory.mktemp("cache")).pixels(capture.shots[0])
    np.testing.assert_allclose(pixels.mask, 200 / 255, atol=1e-6)


def test_one_split_alone(dnerf):
    path, _ = dnerf
    assert open_capture(path / "transforms_train.json").views == ["train"]


def test_rig_in_splits_as_4d_converters_write_it(tmp_path, tmp_path_factory):
    """images/camNN_0000 without ending, the held-out camera in the file of tests, frames from 0."""
    frames = write_rig(tmp_path, pattern="images/{name}_{frame:04}.png", start=0, timed=lambda k: k / 3)
    for entry in frames:
        entry["file_path"] = entry["file_path"].removesuffix(".png")
    write(tmp_path / "transforms_train.json", frames[3:], **intrinsics(SIMPLE))
    write(tmp_path / "transforms_test.json", frames[:3], **intrinsics(SIMPLE))
    capture = open_capture(tmp_path)
    assert capture.held_out_views == ["cam00"]
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_blendernerf(tmp_path, tmp_path_factory):
    """Static pictures whose camera has a scale in Blender."""
    rig = SpotRig(CENTRED, cameras=3, frames=1, sigma=2.5)
    frames = write_rig(tmp_path, rig, "train/{name}.png")
    for entry in frames:
        entry["transform_matrix"] = (np.array(entry["transform_matrix"]) @ np.diag([2, 2, 2, 1.0])).tolist()
    write(tmp_path / "transforms_train.json", frames, camera_angle_x=2 * np.arctan(80 / 150), camera_angle_y=2 * np.arctan(60 / 150),
          fl_x=150, fl_y=150, k1=0, k2=0, p1=0, p2=0, cx=80.0, cy=60.0, w=160, h=120, aabb_scale=4)
    rig.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)


def test_missing_pictures_are_told(tmp_path):
    frames = write_rig(tmp_path)
    write(tmp_path / "transforms.json", frames, **intrinsics(SIMPLE))
    (tmp_path / "images/cam01/0002.png").unlink()
    capture = open_capture(tmp_path)
    assert not problems(capture) and len(capture) == 8 and any("cam01 lacks the frame 1" in note for note in capture.notes)
    for entry in frames:
        (tmp_path / entry["file_path"]).unlink(missing_ok=True)
    with pytest.raises(fg.FastGSError, match="none.*9 pictures"):
        open_capture(tmp_path)


@pytest.mark.parametrize(("change", "words"), [
    (lambda v: v.pop("frames"), "lacks frames"), (lambda v: v.update(frames=[]), "at least 1"),
    (lambda v: v["frames"][1].pop("file_path"), "frame 1"),
    (lambda v: v["frames"][1].pop("transform_matrix"), "frame 1: its transform_matrix"), (lambda v: v.update(fl_x=0), "above 0"),
    (lambda v: v["frames"][1].update(transform_matrix=np.zeros((4, 4)).tolist()), "no length"),
    (lambda v: v["frames"][1].update(transform_matrix=np.diag([1, 1, -1, 1.0]).tolist()), "rotation"),
    (lambda v: v["frames"][1]["transform_matrix"][0].__setitem__(3, float("nan")), "finite"), (lambda v: v.update(w=10**9), "between"),
    (lambda v: v.update(camera_model="EQUIRECTANGULAR"), "EQUIRECTANGULAR"), (lambda v: v.update(k4=0.5), "k4"),
    (lambda v: v["frames"][2].update(time=0.5), "no time"), (lambda v: v.update(cx="left"), "principal point"),
    (lambda v: v.pop("fl_x"), "focal"),
    (lambda v: (v.pop("fl_x"), v.update(K=[[1, 2], [3, 4]])), "its K"),
    (lambda v: (v.pop("fl_x"), v["frames"][0].update(intrinsic_matrix="large")), "frame 0: its intrinsic_matrix"),
])
def test_what_is_wrong_is_one_sentence(tmp_path, change, words):
    values = {"frames": write_rig(tmp_path), **intrinsics(SIMPLE)}
    change(values)
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(fg.FastGSError, match=words) as error:
        open_capture(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"[]", b'{"frames": 3}'])
def test_damaged_files(tmp_path, content):
    (tmp_path / "transforms.json").write_bytes(content)
    with pytest.raises(fg.FastGSError, match="transforms.json"):
        open_capture(tmp_path)


def test_a_part_of_stated_times_is_a_clip_of_its_own(dnerf):
    path, _ = dnerf
    part = open_capture(path / "transforms_train.json", frames=slice(1, None))
    assert [shot.t for shot in part.shots] == [0, 0.5] and part.clip.frame_count == 2


@pytest.mark.parametrize(("listed", "film"), [
    ("{}.mp4", "{}.mp4"), ("films/{}/GX010010.MP4", "films/{}/GX010010.MP4"), ("images/{}.png", "films/{}.mp4"),
    ("./images/{}_frame_0001.jpg", "{}.mov"), ("images/{}", "films/{}/GX010010.MP4")])
def test_films_that_are_listed_or_lie_beside_their_pictures(tmp_path, tmp_path_factory, listed, film):
    """A picture of each was enough for its pose; photographs of a walk among them have no films."""
    for i, name in enumerate(NAMES):
        place = tmp_path / film.format(name)
        RIG.write_video(place.parent / "film.mp4", i, fps=50)
        (place.parent / "film.mp4").rename(place)
        if listed != film:
            picture = tmp_path / listed.format(name)
            RIG.write_picture(picture.with_suffix(picture.suffix or ".png"), i, 0)
    frames = [frame(RIG, i, listed.format(name)) for i, name in enumerate(NAMES)]
    RIG.write_picture(tmp_path / "images" / "IMG_7.png", 1, 0)
    write(tmp_path / "transforms.json", [*frames, frame(RIG, 1, "images/IMG_7.png")], **intrinsics(SIMPLE))
    capture = open_capture(tmp_path)
    assert capture.clip == fg.Clip(3, 50, 0) and "IMG_7" in capture.notes[0] and not problems(capture)
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)



@pytest.mark.parametrize("film", [False, True])
def test_pictures_that_share_a_folder_or_a_film_are_photographs(tmp_path, film):
    """Splits in folders of their own, as in synthetic scenes that stand still; pictures that were taken from two films of walks."""
    for split in ("train", "test"):
        pictures = [f"{split}/{split}_{i}.png" for i in range(3)]
        for i, picture in enumerate(pictures):
            RIG.write_picture(tmp_path / picture, i, 0)
        if film:
            RIG.write_video(tmp_path / f"{split}.mp4", 0)
        write(tmp_path / f"transforms_{split}.json", [frame(RIG, i, picture) for i, picture in enumerate(pictures)], **intrinsics(SIMPLE))
    capture = open_capture(tmp_path)
    assert capture.clip.frame_count == 1 and len(capture) == 6 and "one moment" in capture.notes[0]
