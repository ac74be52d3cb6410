# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoptic Sports as Dynamic 3D Gaussians prepared it: two JSON files, pictures, masks of 0 and 1, points."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from spots import SpotRig

from fastgs_blender.cameras.lens import Intrinsics
from fastgs_blender.captures import Options
from fastgs_blender.captures.layouts import panoptic
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.util.errors import FastGSError

NAMES = ["1", "2", "7", "0"]
RIG = SpotRig(Intrinsics(301, 299, 163, 118.5, 320, 240))
TRAIN, TEST = (0, 1, 2), (3,)


def meta(cameras, rig=RIG):
    """The content of train_meta.json or test_meta.json."""
    fx, fy, cx, cy, width, height = rig.given
    k = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    frames = range(rig.frames)
    return {"w": width, "h": height, "k": [[k for _ in cameras] for _ in frames],
            "w2c": [[rig.poses[c].tolist() for c in cameras] for _ in frames],
            "fn": [[f"{NAMES[c]}/{t:06d}.jpg" for c in cameras] for t in frames],
            "cam_id": [[int(NAMES[c]) for c in cameras] for _ in frames]}


def write(folder, train=None, test=None):
    (folder / "train_meta.json").write_text(json.dumps(train or meta(TRAIN)), "utf-8")
    (folder / "test_meta.json").write_text(json.dumps(test or meta(TEST)), "utf-8")


@pytest.fixture
def scene(tmp_path):
    for c, name in enumerate(NAMES):
        for frame in range(RIG.frames):
            RIG.write_picture(tmp_path / "ims" / name / f"{frame:06d}.jpg", c, frame)
            mask = np.uint8(RIG.picture(c, frame)[..., 0] > 20)
            (tmp_path / "seg" / name).mkdir(parents=True, exist_ok=True)
            Image.fromarray(mask).save(tmp_path / "seg" / name / f"{frame:06d}.png")
    np.savez(tmp_path / "init_pt_cld.npz", data=np.c_[RIG.points(0), np.full((9, 3), 0.25), np.ones(9)])
    write(tmp_path)
    return tmp_path


def load(path, **options):
    return panoptic.load(path, Options(**options))


def test_pictures(scene, tmp_path_factory):
    assert panoptic.recognises(scene) and panoptic.recognises(scene / "train_meta.json")
    capture = load(scene)
    assert capture.held_out_views == ["0"] and capture.clip.frame_count == 3 and capture.mask_means == "foreground"
    np.testing.assert_allclose(capture.points.xyz, RIG.points(0), atol=1e-6)
    assert (capture.points.rgb == 0.25).all() and (capture.points.t == 0).all()
    RIG.check(capture, tmp_path_factory.mktemp("cache"), NAMES)


def test_masks_of_0_and_1_are_black_and_white(scene, tmp_path_factory):
    capture = load(scene)
    mask = FrameStore(capture, folder=tmp_path_factory.mktemp("cache")).pixels(capture.shots[0]).mask
    np.testing.assert_array_equal(mask, RIG.picture(NAMES.index(capture.shots[0].view), 0)[..., 0] > 20)


def test_without_masks_points_and_test_cameras(scene):
    (scene / "test_meta.json").unlink()
    (scene / "init_pt_cld.npz").unlink()
    (scene / "seg").rename(scene / "gone")
    capture = load(scene)
    assert capture.views == NAMES[:3] and not capture.held_out and capture.points is None and capture.shots[0].mask is None


def test_missing_picture_is_told(scene):
    (scene / "ims" / "2" / "000001.jpg").unlink()
    capture = load(scene)
    assert not problems(capture) and "1 of 12 pictures" in capture.notes[0] and str(Path("ims/2/000001.jpg")) in capture.notes[0]


@pytest.mark.parametrize(("change", "sentence"), [
    (lambda m: m.pop("w2c"), "lacks w2c"),
    (lambda m: m["k"].pop(), "k .*2.*fn.*3"),
    (lambda m: m["k"][1].pop(), "frame 1 has 2 k, 3 w2c, 3 fn, 3 cam_id"),
    (lambda m: m["fn"][0].__setitem__(0, "../../secret.jpg"), "picture.*ims/"),
    (lambda m: m["fn"][0].__setitem__(0, 5), "picture.*ims/"),
    (lambda m: m["w2c"][0].__setitem__(0, np.zeros((4, 4)).tolist()), "frame 0, camera 1.*w2c.*rotation"),
    (lambda m: m["k"][0].__setitem__(0, np.zeros((3, 3)).tolist()), "its k"),
    (lambda m: m["cam_id"][0].__setitem__(0, 2), "camera 2 .*twice"),
    (lambda m: m.update(w="wide"), "width"),
    (lambda m: m.update(fn=[]), "fn .*list"),
])
def test_damaged_description_is_one_sentence(scene, change, sentence):
    values = meta(TRAIN)
    change(values)
    write(scene, values)
    with pytest.raises(FastGSError, match=sentence) as error:
        load(scene)
    assert "train_meta.json" in str(error.value)


def test_other_damage(scene):
    write(scene, test=meta((0, 3)))
    with pytest.raises(FastGSError, match="cameras 1 .*train_meta.json"):
        load(scene)
    write(scene)
    (scene / "init_pt_cld.npz").write_bytes(b"PK")
    with pytest.raises(FastGSError, match=r"init_pt_cld.npz.*'data'"):
        load(scene)
    np.savez(scene / "init_pt_cld.npz", points=np.zeros((3, 7)))
    with pytest.raises(FastGSError, match="cannot be read .*'data'"):
        load(scene)
    (scene / "train_meta.json").write_text("{", "utf-8")
    with pytest.raises(FastGSError, match="not JSON"):
        load(scene)
