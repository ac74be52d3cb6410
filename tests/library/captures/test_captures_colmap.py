# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP workspaces: text and binary, rigs, moments, a workspace for each frame, all camera models."""
from __future__ import annotations

import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from spots import SpotRig

import fastgs_blender as fg
from fastgs_blender.cameras.colmap_files import MODELS
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.cameras.paths.colmap import folder_of
from fastgs_blender.captures import open_capture, open_scan
from fastgs_blender.captures.pixels.checks import problems

NAMES = ["cam00", "cam01", "cam02"]
SIMPLE = Intrinsics(150, 152, 81, 59, 160, 120)
RIG = SpotRig(SIMPLE, cameras=3, sigma=2.5)
POINTS = np.array([[0.5, -1, 2], [1, 2, 3.25]])
COLOURS = np.array([[255, 0, 51], [0, 102, 255]])


def quaternion(rotation):
    """w x y z of a rotation matrix whose angle is below 180 degrees."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    return [w, *((rotation[[2, 0, 1], [1, 2, 0]] - rotation[[1, 2, 0], [2, 0, 1]]) / (4 * w))]


def write_model(folder, names, rig=RIG, model="PINHOLE", parameters=None, binary=True, points=True, which=None):
    """A model with a camera for each picture, as COLMAP writes it; which: the rig's camera of each name."""
    folder.mkdir(parents=True, exist_ok=True)
    parameters = list(rig.given[:4]) if parameters is None else parameters
    which = range(len(names)) if which is None else which
    width, height = rig.given[4:]
    poses = [(*quaternion(rig.poses[i][:3, :3]), *rig.poses[i][:3, 3]) for i in which]
    points = list(zip(POINTS, COLOURS)) if points else []
    seen = [range(len(points)) if i < 2 else () for i in range(len(names))]  # the first two pictures see all points
    if not binary:
        cameras = [f"{i + 1} {model} {width} {height} {' '.join(map(repr, map(float, parameters)))}" for i in range(len(names))]
        images = [f"{i + 1} {' '.join(repr(float(v)) for v in pose)} {i + 1} {name}\n{' '.join(f'1.5 2.5 {k}' for k in seen[i])}"
                  for i, (name, pose) in enumerate(zip(names, poses))]
        tracks = [f"{i} {' '.join(map(str, xyz))} {' '.join(map(str, rgb))} 0.5 1 {i} 2 {i}" for i, (xyz, rgb) in enumerate(points)]
        for name, lines in (("cameras", cameras), ("images", images), ("points3D", tracks)):
            (folder / f"{name}.txt").write_text("# made by a test\n#\n" + "\n".join(lines) + "\n")
        return
    number = MODELS[model][0]
    (folder / "cameras.bin").write_bytes(struct.pack("<Q", len(names)) + b"".join(
        struct.pack(f"<IiQQ{len(parameters)}d", i + 1, number, width, height, *parameters) for i in range(len(names))))
    (folder / "images.bin").write_bytes(struct.pack("<Q", len(names)) + b"".join(
        struct.pack("<I7dI", i + 1, *pose, i + 1) + name.encode() + b"\0" + struct.pack("<Q", len(seen[i]))
        + b"".join(struct.pack("<ddQ", 1.5, 2.5, k) for k in seen[i]) for i, (name, pose) in enumerate(zip(names, poses))))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", len(points)) + b"".join(
        struct.pack("<Q3d3Bd", i, *xyz, *map(int, rgb), 0.5) + struct.pack("<QIIII", 2, 1, i, 2, i) for i, (xyz, rgb) in enumerate(points)))


def write_rig(folder, rig=RIG, names=NAMES, start=1):
    for i, name in enumerate(names):
        for frame in range(rig.frames):
            rig.write_picture(folder / name / f"{frame + start:04}.png", i, frame)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
def test_a_rig_of_sequences(tmp_path, tmp_path_factory, binary, place):
    write_rig(tmp_path / "images")
    write_model(tmp_path / place, [f"{name}/0001.png" for name in NAMES], binary=binary)
    capture = open_capture(tmp_path)
    assert capture.layout == "COLMAP" and capture.views == NAMES and capture.clip == fg.Clip(3, 30, 1) and not capture.held_out
    np.testing.assert_allclose(capture.points.xyz, POINTS)
    np.testing.assert_allclose(capture.points.rgb, COLOURS / 255, atol=1e-6)
    assert capture.points.t is None
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_photographs_that_belong_to_no_film_are_a_scan(tmp_path):
    write_rig(tmp_path / "images", names=NAMES[:2])
    RIG.write_picture(tmp_path / "images" / "walk.png", 2, 0)
    write_model(tmp_path / "sparse/0", [*(f"{name}/0001.png" for name in NAMES[:2]), "walk.png"])
    assert open_capture(tmp_path).views == NAMES[:2]
    scan = open_scan(tmp_path)
    assert scan.views == ["walk"] and len(scan) == 1
    np.testing.assert_allclose(scan.shots[0].camera.world_to_camera, RIG.poses[2], atol=1e-9)
    write_model(tmp_path / "sparse/0", [f"{name}/0001.png" for name in NAMES[:2]])
    with pytest.raises(fg.FastGSError, match="belong to films"):
        open_scan(tmp_path)


def test_the_largest_of_several_models_is_used(tmp_path):
    """COLMAP's mapper may write a pair of photographs first, and the rig as its second model."""
    write_rig(tmp_path / "images")
    write_model(tmp_path / "sparse/0", [f"{name}/0001.png" for name in NAMES[1:]], which=[1, 2])
    write_model(tmp_path / "sparse/1", [f"{name}/0001.png" for name in NAMES])
    capture = open_capture(tmp_path)
    assert capture.views == NAMES and "model 1" in capture.notes[0]
    assert folder_of(tmp_path) == tmp_path / "sparse/1" and folder_of(tmp_path / "sparse/0") == tmp_path / "sparse/0"


def test_pictures_named_after_their_camera_stand_for_its_sequence(tmp_path, tmp_path_factory):
    write_rig(tmp_path / "images")
    write_model(tmp_path / "sparse/0", [f"{name}.png" for name in NAMES])
    RIG.check(open_capture(tmp_path, held_out=["cam01"]), tmp_path_factory.mktemp("cache"), NAMES)


def test_or_for_its_video(tmp_path, tmp_path_factory):
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / "images" / f"{name}.mp4", i, fps=60)
    write_model(tmp_path / "sparse/0", [f"{name}.png" for name in NAMES])
    capture = open_capture(tmp_path)
    assert capture.clip == fg.Clip(3, 60, 0)
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_films_in_folders(tmp_path, tmp_path_factory):
    """As cameras' cards are copied; the registered picture lies beside the folder, beside the film, or is called otherwise."""
    places = ["set/left/one/GX010010.MP4", "set/right/one/GX010010.MP4", "set/two/GX010011.MP4"]
    names = ["set/left/one.png", "set/right/one/GX010010.png", "set/two/first.png"]
    for i, (place, name) in enumerate(zip(places, names)):
        folder = (tmp_path / "images" / place).parent
        folder.mkdir(parents=True)
        RIG.write_video(folder / "film.mp4", i, fps=60)
        (folder / "film.mp4").rename(tmp_path / "images" / place)
        RIG.write_picture(tmp_path / "images" / name, i, 0)
    write_model(tmp_path / "sparse/0", names)
    capture = open_capture(tmp_path)
    assert capture.clip == fg.Clip(3, 60, 0)
    RIG.check(capture, tmp_path_factory.mktemp("cache"), ["left/one", "right/one", "two"])


@pytest.mark.parametrize(("registered", "film"), [
    ("{}.png", "films/{}.mp4"), ("{}/frame_0001.png", "films/{}.MP4"), ("{}_0001.jpg", "my films/{}.MOV"),
    ("{}.png", "films/{}/DCIM/100GOPRO/GX010010.MP4")])
def test_films_beside_the_pictures_that_colmap_used(tmp_path, tmp_path_factory, registered, film):
    """In a folder of their own, with the pictures or without them, and with photographs of a walk."""
    for i, name in enumerate(NAMES):
        place = tmp_path / film.format(name)
        RIG.write_video(place.parent / "film.mp4", i, fps=60)
        (place.parent / "film.mp4").rename(place)
        RIG.write_picture(tmp_path / "images" / registered.format(name), i, 0)
    RIG.write_picture(tmp_path / "images" / "IMG_7.png", 1, 0)
    write_model(tmp_path / "sparse/0", [*(registered.format(name) for name in NAMES), "IMG_7.png"], which=[0, 1, 2, 1])
    assert open_scan(tmp_path).views == ["IMG_7"]
    for _ in range(2):
        capture = open_capture(tmp_path)
        assert capture.clip == fg.Clip(3, 60, 0) and "IMG_7" in capture.notes[0]
        RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
        shutil.rmtree(tmp_path / "images", ignore_errors=True)


def test_pictures_that_are_gone_are_one_sentence(tmp_path):
    """Without them, and without two films that are called like them, nothing can be shown."""
    RIG.write_video(tmp_path / "films" / "cam00.mp4", 0)
    write_model(tmp_path / "sparse/0", [f"{name}.png" for name in NAMES])
    with pytest.raises(fg.FastGSError, match=r"cam00\.png.*copy the pictures.*film"):
        open_capture(tmp_path)


def test_a_film_with_several_registered_pictures_stands_still(tmp_path):
    """COLMAP gives each of its pictures a pose of its own, which differ a little."""
    rig = SpotRig(SIMPLE, cameras=3, frames=3, sigma=2.5)
    for i, name in enumerate(NAMES):
        rig.write_video(tmp_path / "films" / f"{name}.mp4", i)
    rig.poses = [pose for pose in rig.poses for _ in range(2)]
    rig.poses[1] = rig.poses[0] + np.eye(4)[:, [3, 0, 1, 2]] * [1e-3, 0, 0, 0]
    write_model(tmp_path / "sparse/0", [f"{name}_{number:04}.png" for name in NAMES for number in (1, 90)], rig)
    capture = open_capture(tmp_path)
    assert len(capture) == 9 and sum("stand still" in note for note in capture.notes) == 3
    np.testing.assert_allclose(capture.shots[0].camera.world_to_camera, rig.poses[0], atol=1e-9)


def test_pictures_of_a_film_of_a_walk_are_photographs(tmp_path):
    """A phone's film of the place, of which pictures were taken for COLMAP, beside the films of a rig."""
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / "images" / f"{name}.mp4", i)
        RIG.write_picture(tmp_path / "images" / f"walk_{i + 1:04}.png", i, 0)
    RIG.write_video(tmp_path / "images" / "walk.mp4", 0)
    write_model(tmp_path / "sparse/0", [*(f"{name}.png" for name in NAMES), *(f"walk_{i + 1:04}.png" for i in range(3))],
                which=[0, 1, 2, 0, 1, 2])
    assert open_capture(tmp_path).views == NAMES and open_scan(tmp_path).views == [f"walk_{i + 1:04}" for i in range(3)]


def test_a_workspace_for_each_frame(tmp_path, tmp_path_factory):
    for frame in range(3):
        folder = tmp_path / f"colmap_{frame}"
        for i, name in enumerate(NAMES):
            RIG.write_picture(folder / "images" / f"{name}.png", i, frame)
        write_model(folder / "sparse/0", [f"{name}.png" for name in NAMES], binary=frame != 1, points=frame != 2)
    capture = open_capture(tmp_path)
    np.testing.assert_allclose(capture.points.t, [0, 0, 1 / 3, 1 / 3])
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    part = open_capture(tmp_path, frames=slice(1, 3))
    assert part.clip == fg.Clip(2, 30, 1) and (part.points.t == 0).all() and len(part.points) == 2
    (tmp_path / "colmap_1" / "images" / "cam02.png").unlink()
    capture = open_capture(tmp_path)
    assert not problems(capture) and any(str(Path("colmap_1/images/cam02.png")) in text for text in capture.notes)


def test_a_moment(tmp_path, tmp_path_factory):
    rig = SpotRig(SIMPLE, cameras=3, frames=1, sigma=2.5)
    for i, name in enumerate(("IMG_0123", "IMG_0124", "other/IMG_7")):
        rig.write_picture(tmp_path / "images" / f"{name}.jpg", i, 0)
    names = ["IMG_0123", "IMG_0124", "other/IMG_7"]
    write_model(tmp_path / "sparse/0", [f"{name}.jpg" for name in names[:2]], rig)
    capture = open_capture(tmp_path)
    assert capture.views == names[:2] and capture.clip.frame_count == 1 and "one moment" in capture.notes[0]
    rig.check(capture, tmp_path_factory.mktemp("cache"), names[:2])


def test_a_camera_that_moves(tmp_path):
    rig = SpotRig(SIMPLE, cameras=3, frames=1)
    for i in range(3):
        rig.write_picture(tmp_path / "images" / "hand" / f"{i:04}.png", i, 0)
        rig.write_picture(tmp_path / "images" / "fixed" / f"{i:04}.png", 1, 0)
    write_model(tmp_path / "sparse/0", [*(f"hand/{i:04}.png" for i in (0, 2)), "fixed/0001.png"], rig, which=[0, 2, 1])
    capture = open_capture(tmp_path)
    assert [shot.frame for shot in capture.shots if shot.view == "hand"] == [0, 2] and "hand moves" in capture.notes[0]
    assert [shot.frame for shot in capture.shots if shot.view == "fixed"] == [0, 1, 2]
    for shot in capture.shots:
        np.testing.assert_allclose(shot.camera.world_to_camera, rig.poses[shot.frame if shot.view == "hand" else 1], atol=1e-9)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize(("model", "rest", "lens"), [
    ("SIMPLE_PINHOLE", [], Lens()), ("SIMPLE_RADIAL", [-0.08], Lens("opencv", (-0.08,))),
    ("RADIAL", [-0.08, 0.02], Lens("opencv", (-0.08, 0.02))),
    ("OPENCV", [-0.08, 0.02, 0.002, -0.003], Lens("opencv", (-0.08, 0.02), (0.002, -0.003))),
    ("OPENCV_FISHEYE", [0.02, -0.01, 0.003, 0.001], Lens("fisheye", (0.02, -0.01, 0.003, 0.001))),
    ("FULL_OPENCV", [-0.08, 0.02, 0.002, -0.003, 0.01, 0.02, 0.01, 0.003],
     Lens("opencv", (-0.08, 0.02, 0.01, 0.02, 0.01, 0.003), (0.002, -0.003))),
    ("SIMPLE_RADIAL_FISHEYE", [0.02], Lens("fisheye", (0.02,))), ("RADIAL_FISHEYE", [0.02, -0.01], Lens("fisheye", (0.02, -0.01))),
])
def test_camera_models(tmp_path, tmp_path_factory, model, rest, lens, binary):
    one_focal = MODELS[model][2].startswith("f ")
    given = SIMPLE._replace(fy=150) if one_focal else SIMPLE
    rig = SpotRig(given, lens, cameras=2, frames=1, sigma=2.5)
    write_rig(tmp_path / "images", rig, NAMES[:2])
    write_model(tmp_path / "sparse/0", [f"{name}/0001.png" for name in NAMES[:2]], rig, model, [*given[one_focal:4], *rest], binary)
    capture = open_capture(tmp_path)
    if lens.model == "pinhole":
        assert capture.shots[0].camera.fy == 150
    rig.check(capture, tmp_path_factory.mktemp("cache"), NAMES[:2])


@pytest.mark.parametrize("binary", [True, False])
def test_pycolmap_reads_the_test_files_the_same_way(tmp_path, binary):
    write_model(tmp_path, [f"{name}.png" for name in NAMES], binary=binary)
    other = pycolmap.Reconstruction(str(tmp_path))
    assert other.num_images() == 3 and other.num_points3D() == 2
    for image in other.images.values():
        pose = RIG.poses[NAMES.index(image.name[:-4])]
        np.testing.assert_allclose(image.cam_from_world().matrix(), pose[:3], atol=1e-9)


def test_files_that_pycolmap_writes(tmp_path, tmp_path_factory):
    write_rig(tmp_path / "images")
    source = tmp_path / "text"
    write_model(source, [f"{name}/0001.png" for name in NAMES], binary=False)
    (tmp_path / "sparse").mkdir()
    pycolmap.Reconstruction(str(source)).write_binary(str(tmp_path / "sparse"))
    RIG.check(open_capture(tmp_path), tmp_path_factory.mktemp("cache"), NAMES)


# What is wrong


@pytest.fixture
def workspace(tmp_path):
    """A function: the folder of a small capture whose model is binary or text."""
    rig = SpotRig(SIMPLE, cameras=2, frames=1)
    write_rig(tmp_path / "images", rig, NAMES[:2])

    def workspace(binary=True, **more):
        write_model(tmp_path / "sparse/0", [f"{name}/0001.png" for name in NAMES[:2]], rig, binary=binary, **more)
        return tmp_path

    return workspace


@pytest.mark.parametrize(("file", "change", "words"), [
    ("cameras.bin", lambda b: b[:-3], "cut short"), ("cameras.bin", lambda b: struct.pack("<Q", 2**60) + b[8:], "cut short"),
    ("cameras.bin", lambda b: b[:12] + struct.pack("<i", 7) + b[16:], "model number 7"), ("images.bin", lambda b: b[:40], "cut short"),
    ("images.bin", lambda b: struct.pack("<Q", 10**9) + b[8:], "cut short"), ("images.bin", lambda b: struct.pack("<Q", 0), "no picture"),
    ("images.bin", lambda b: b[:12] + struct.pack("<d", np.nan) + b[20:], "finite"),
    ("images.bin", lambda b: b.replace(b"cam00", b"../00"), "name.*picture"), ("points3D.bin", lambda b: b[:-4], "cut short"),
    ("points3D.bin", lambda b: struct.pack("<Q", 2**63) + b[8:], "cut short"), ("cameras.bin", lambda b: b"", "cut short"),
    ("cameras.txt", lambda b: b.replace(b"PINHOLE", b"THIN_PRISM_FISHEYE"), "THIN_PRISM_FISHEYE"),
    ("cameras.txt", lambda b: b.replace(b"150.0", b"nan"), "finite"), ("cameras.txt", lambda b: b.replace(b" 59.0", b""), "3 parameters"),
    ("images.txt", lambda b: b.replace(b" 1 cam00", b" 9 cam00"), "camera 9"), ("images.txt", lambda b: b[:60], "makes no sense"),
    ("points3D.txt", lambda b: b + b"7 1 2 three\n", "makes no sense"),
    ("cameras.txt", lambda b: b"\xff\xfe\x00", "makes no sense|camera 1"),
])
def test_damaged_files_are_one_sentence(workspace, file, change, words):
    path = workspace(binary=file.endswith("bin"))
    target = path / "sparse/0" / file
    target.write_bytes(change(target.read_bytes()))
    with pytest.raises(fg.FastGSError, match=words) as error:
        open_capture(path)
    assert str(path / "sparse/0") in str(error.value) and "\n" not in str(error.value)


def test_pictures_of_another_size_are_told(workspace):
    path = workspace()
    SpotRig(SIMPLE._replace(width=80)).write_picture(path / "images/cam01/0001.png", 1, 0)
    assert problems(open_capture(path)) == ["cam01 has pictures of 80 x 120 pixels where its calibration is for 160 x 120 (frames 1)"]
