# SPDX-License-Identifier: GPL-3.0-or-later
"""Qualisys: an XML calibration in 1/64 pixels, millimetres and OpenGL axes, and the videos that belong to it."""
from __future__ import annotations

import numpy as np
import pytest
from spots import SpotRig, project

from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import Options, open_capture
from fastgs_blender.captures.layouts import qualisys
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.util.errors import FastGSError

NAMES = ["26580", "26581", "26583"]
LEFT, TOP = 10, 6  # of the part of the sensor that was filmed
RIG = SpotRig(Intrinsics(300.25, 299.5, 163, 118.5, 320, 240), Lens("opencv", (-0.15, 0.08, 0.01), (0.002, -0.001)), cameras=3)


def camera(i, binning=1, **changes):
    """The <camera> of the rig's i-th camera as QTM writes it; changes: attributes by name."""
    fx, fy, cx, cy, width, height = RIG.given
    pose = RIG.poses[i]
    turn, centre = np.diag([1, -1, -1]) @ pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3] * 1000
    unit = 64 * binning
    fov = dict(left=LEFT, top=TOP, right=LEFT + width - 1, bottom=TOP + height - 1)
    transform = dict(zip("xyz", centre)) | {f"r{a + 1}{b + 1}": turn[a, b] for a in range(3) for b in range(3)}
    k, p = RIG.lens.k, RIG.lens.p
    intrinsic = dict(
        focallength=9.3, sensorMinU=0, sensorMaxU=400 * unit - 1, sensorMinV=0, sensorMaxV=300 * unit - 1, focalLengthU=fx * unit,
        focalLengthV=fy * unit, centerPointU=(cx + LEFT) * unit, centerPointV=(cy + TOP) * unit, skew=0, radialDistortion1=k[0],
        radialDistortion2=k[1], radialDistortion3=k[2], tangentalDistortion1=p[0], tangentalDistortion2=p[1])
    head = dict(active=1, serial=NAMES[i], model="Miqus Video", viewrotation=0)
    parts = []
    for tag, values in (("fov_video_max", dict(left=0, top=0, right=399, bottom=299)), ("fov_video", fov), ("transform", transform),
                        ("intrinsic", intrinsic)):
        values = {key: changes.get(f"{tag}_{key}", value) for key, value in values.items()}
        parts.append(f"<{tag} " + " ".join(f'{key}="{value}"' for key, value in values.items() if value is not None) + "/>")
    parts = [part for part in parts if part[1:].split()[0] not in changes.get("without", ())]
    head = " ".join(f'{key}="{changes.get(key, value)}"' for key, value in head.items())
    return f"<camera {head}>{''.join(parts)}</camera>"


def calibration(*cameras):
    return f'<?xml version="1.0"?>\n<calibration type="regular"><results std-dev="0.4"/><cameras>{"".join(cameras)}</cameras></calibration>'


@pytest.fixture
def scene(tmp_path):
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / f"walk_Miqus_1_{name}.mp4", i, fps=50)
    marker_camera = camera(0, serial="11111", model="Miqus M3")
    (tmp_path / "Calib.qca.txt").write_text(calibration(*map(camera, range(3)), marker_camera), "utf-8")
    return tmp_path


def load(path, **options):
    return qualisys.load(path, Options(**options))


def test_videos(scene, tmp_path_factory):
    assert qualisys.recognises(scene) and qualisys.recognises(scene / "Calib.qca.txt")
    capture = load(scene)
    assert capture.held_out_views == ["26583"] and capture.clip.fps == 50 and capture.axes == "RFU"
    assert capture.notes == ["left out for want of a video: 11111"]
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    RIG.check(load(scene / "Calib.qca.txt", scale=0.5), tmp_path_factory.mktemp("cache"), NAMES)
    assert load(scene, held_out=("26580",)).held_out_views == ["26580"]


def test_binned_video(scene, tmp_path_factory):
    text = calibration(*(camera(i, binning=2) for i in range(3)))
    (scene / "Calib.qca.txt").write_text(text, "utf-8")
    RIG.check(load(scene), tmp_path_factory.mktemp("cache"), NAMES)


def test_folders_of_their_own(scene, tmp_path_factory):
    for folder in ("videos", "calibration"):
        (scene / folder).mkdir()
    (scene / "Calib.qca.txt").rename(scene / "calibration" / "Calib.qca.txt")
    for i, video in enumerate(sorted(scene.glob("*.mp4"))):
        if i == 0:
            for frame in range(RIG.frames):
                RIG.write_picture(scene / "videos" / NAMES[0] / f"{frame + 1:03d}.png", 0, frame)
        else:
            video.rename(scene / "videos" / video.name)
    for video in scene.glob("*.mp4"):
        video.unlink()
    RIG.check(load(scene), tmp_path_factory.mktemp("cache"), NAMES)


@pytest.mark.parametrize(("text", "sentence"), [
    (calibration(camera(0))[:-60], "not XML"),
    (calibration(), "serial"),
    (calibration(camera(0), camera(0)), "26580.*twice"),
    (calibration(camera(0, serial="9")), "no video"),
    (calibration(camera(0, without=("transform",))), "camera 26580 lacks <transform>"),
    (calibration(camera(0, transform_r11="5")), "transform.*rotation"),
    (calibration(camera(0, transform_x="far")), "x .*number.*'far'"),
    (calibration(camera(0, intrinsic_focalLengthU=None)), "focalLengthU.*<intrinsic>"),
    (calibration(camera(0, intrinsic_focalLengthU="0")), "focal"),
    (calibration(camera(0, intrinsic_centerPointV="nan")), "centerPointV.*finite"),
    (calibration(camera(0, fov_video_right=LEFT + 239, fov_video_bottom=TOP + 319)), "calibrated for 240 x 320"),
    ("<!DOCTYPE x [<!ENTITY a 'b'>]>" + calibration(camera(0)).partition("\n")[2], "entities"),
])
def test_damaged_calibration_is_one_sentence(scene, text, sentence):
    (scene / "Calib.qca.txt").write_text(text, "utf-8")
    with pytest.raises(FastGSError, match=sentence) as error:
        load(scene)
    assert str(scene) in str(error.value) and str(error.value).count("\n") == 0


def test_ambiguous_files_are_refused(scene):
    RIG.write_video(scene / "again_26581.mp4", 0)
    with pytest.raises(FastGSError, match="26581"):
        load(scene)
    (scene / "copy.txt").write_text(calibration(camera(0)), "utf-8")
    with pytest.raises(FastGSError, match="2 Qualisys calibrations"):
        load(scene)


BOLTS = [
    {0: (67, 1054), 1: (414, 1034), 2: (914, 1219), 3: (885, 1430)}, {0: (280, 1357), 2: (532, 1069), 3: (931, 1057)},
    {0: (513, 1032), 1: (822, 1061), 2: (520, 1491), 3: (324, 1464)}, {1: (801, 1262), 2: (139, 1257), 3: (486, 1133)}]
"""Four bolts in the treadmill's surface, in pixels of the videos in which they are seen, read off by eye."""


def triangulated(seen, cameras):
    """The point nearest to the rays through the pixels of a camera each, in the least-squares sense."""
    system, right = np.zeros((3, 3)), np.zeros(3)
    for i, pixel in seen.items():
        c = cameras[i]
        ray = np.r_[(np.array(pixel) - [c.cx, c.cy]) / [c.fx, c.fy], 1] @ c.world_to_camera[:3, :3]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        system += across
        right += across @ (-c.world_to_camera[:3, :3].T @ c.world_to_camera[:3, 3])
    return np.linalg.solve(system, right)


def test_real_cameras_agree_about_their_treadmill(shared_data):
    """Its surface is the plane z = 0.  The published videos are shifted by 5 to 25 pixels against their calibration."""
    capture = open_capture(shared_data / "people")
    assert capture.layout == "Qualisys" and capture.views == ["cam01", "cam02", "cam03", "cam04"] and capture.held_out_views == ["cam04"]
    assert (capture.clip.frame_count, capture.clip.fps) == (100, 60) and not problems(capture)
    shots = capture.at_frame(0)
    errors = []
    for bolt in BOLTS:
        seen = {}
        for i, pixel in bolt.items():
            lens, given, camera = shots[i].image.lens, shots[i].image.intrinsics, shots[i].camera
            flat = lens.undistort((np.array(pixel) - given[2:4]) / given[:2])
            seen[i] = flat * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        xyz = triangulated(seen, [shot.camera for shot in shots])
        assert abs(xyz[2]) < 0.02  # metres
        errors += [np.linalg.norm(project(shots[i].camera, [xyz])[0] - pixel) for i, pixel in seen.items()]
    assert np.median(errors) < 10 and max(errors) < 20
