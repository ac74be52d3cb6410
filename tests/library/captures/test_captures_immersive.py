# SPDX-License-Identifier: GPL-3.0-or-later
"""Google Immersive: fisheye cameras with axis-angle poses, undistorted on load."""
from __future__ import annotations

import json

import numpy as np
import pytest
from spots import SpotRig

from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures import Options
from fastgs_blender.captures.layouts import immersive
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.util.errors import FastGSError

NAMES = ["camera_0001", "camera_0002", "camera_0009"]
RIG = SpotRig(Intrinsics(400, 400, 322.5, 237, 640, 480), Lens("fisheye", (0.04, -0.02)), cameras=3, frames=2, sigma=6, spread=1.2)


def axis_angle(rotation):
    angle = np.arccos((np.trace(rotation) - 1) / 2)
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return axis / (2 * np.sin(angle)) * angle


def models(rig=RIG, names=NAMES):
    """models.json, with a camera more than there are videos."""
    found = []
    for i, name in enumerate([*names, "camera_0046"]):
        pose = rig.poses[i % len(rig.poses)]
        fx, _, cx, cy, width, height = rig.given
        found.append({"name": name, "position": (-pose[:3, :3].T @ pose[:3, 3]).tolist(), "orientation": axis_angle(pose[:3, :3]).tolist(),
                      "focal_length": fx, "pixel_aspect_ratio": 1.0, "principal_point": [cx, cy], "width": float(width),
                      "height": float(height), "radial_distortion": [rig.lens.k[0], rig.lens.k[1], 0.0], "projection_type": "fisheye"})
    return found


@pytest.fixture
def scene(tmp_path):
    for i, name in enumerate(NAMES):
        RIG.write_video(tmp_path / f"{name}.mp4", i)
    (tmp_path / "models.json").write_text(json.dumps(models()), "utf-8")
    return tmp_path


def load(path, **options):
    return immersive.load(path, Options(**options))


def test_fisheye_videos(scene, tmp_path_factory):
    assert immersive.recognises(scene) and immersive.recognises(scene / "models.json")
    capture = load(scene)
    assert capture.held_out_views == ["camera_0001"] and "camera_0046" in capture.notes[0]
    camera = capture.shots[0].camera
    assert (camera.width, camera.height, camera.fx, camera.cx) == (320, 240, 100, 322.5 / 2)  # half the size, half the focal length
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)
    RIG.check(load(scene, scale=1.0), tmp_path_factory.mktemp("cache"), NAMES)


def test_what_the_lens_does_not_see_is_masked(scene, tmp_path_factory):
    store = FrameStore(load(scene), folder=tmp_path_factory.mktemp("cache"))
    valid = store.pixels(store.capture.shots[0]).valid
    assert valid[120, 160] and not valid[0, 0] and 0.4 < valid.mean() < 0.95


def test_video_without_calibration_is_left_out(scene):
    (scene / "models.json").write_text(json.dumps(models()[:2]), "utf-8")
    capture = load(scene)
    assert capture.views == NAMES[:2] and "models.json: camera_0009" in capture.notes[0]


def test_known_exposures_are_evened(scene):
    welder = scene.rename(scene.with_name("01_Welder"))
    gains = {shot.view: shot.image.gain for shot in load(welder).shots}
    assert gains == {"camera_0001": 1, "camera_0002": 1, "camera_0009": pytest.approx(1 / 1.15)}


@pytest.mark.parametrize(("change", "sentence"), [
    (lambda m: m[0].pop("position"), "camera_0001.*position"),
    (lambda m: m[0].update(orientation=[0, 1]), "orientation.*3 finite"),
    (lambda m: m[0].update(focal_length="long"), "focal_length.*finite"),
    (lambda m: m[0].update(focal_length=-5), "above 0"),
    (lambda m: m[0].update(projection_type="mirror"), "'mirror'"),
    (lambda m: m[0].update(radial_distortion=[0.1]), "radial_distortion"),
    (lambda m: m[0].update(width=0), "width"),
    (lambda m: m[1].update(name="camera_0001"), "there twice"),
    (lambda m: m.clear(), "at least 1"),
    (lambda m: [entry.update(name=entry["name"] + "x") for entry in m], "none.*cameras"),
])
def test_damaged_models_are_one_sentence(scene, change, sentence):
    entries = models()
    change(entries)
    (scene / "models.json").write_text(json.dumps(entries), "utf-8")
    with pytest.raises(FastGSError, match=sentence) as error:
        load(scene)
    assert "models.json" in str(error.value)


def test_files_of_another_size_are_told(scene):
    entries = models()
    entries[1]["width"] = 700
    (scene / "models.json").write_text(json.dumps(entries), "utf-8")
    assert any("camera_0002" in text and "640 x 480" in text for text in problems(load(scene)))
