# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures and camera files that hang, fill the memory or leak other errors where nobody looks: each ends in one sentence, at once."""
from __future__ import annotations

import contextlib
import json
import os
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tiny_captures

import fastgs_blender as fg
from fastgs_blender.cameras.cameras_json import load_cameras
from fastgs_blender.cameras.paths import Picture, load_path
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.describe import describe, text
from fastgs_blender.captures.pixels import pictures, probe, video
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.captures.sources import Source


def refused(words, call, *args, **settings):
    with pytest.raises(fg.FastGSError, match=words) as error:
        call(*args, **settings)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.fixture(params=["pipe", "device"])
def endless(request, tmp_path):
    """Make a file that never ends or never answers."""

    def make(path: Path):
        path.unlink(missing_ok=True)
        if request.param == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to("/dev/zero")

    return make


@pytest.mark.posix
def test_pipes_and_devices_as_pictures(endless, tmp_path):
    tiny_captures.fastgs(tmp_path)
    for file in ("cam00/0001.png", "masks/cam00/0001.png"):
        endless(tmp_path / file)
    capture = open_capture(tmp_path)
    assert sum("pipe" in note for note in capture.notes) == 1 and not problems(capture)
    refused("pipe.*device", pictures.read, Source(tmp_path / "cam00/0001.png"))
    for name in ("a.exr", "a.mp4"):
        endless(tmp_path / name)
    refused("pipe.*device", probe.facts, Source(tmp_path / "a.exr"))
    refused("pipe.*device", video.index, tmp_path / "a.mp4")


@pytest.mark.posix
@pytest.mark.parametrize(("layout", "name"), [
    ("fastgs", "cameras.json"), ("panoptic", "train_meta.json"), ("transforms", "transforms.json"), ("n3v", "poses_bounds.npy"),
    ("technicolor", "cameras_parameters.txt"), ("qualisys", "calib.qca.txt"), ("colmap", "sparse/0/images.txt")])
def test_pipes_and_devices_as_descriptions(endless, tmp_path, layout, name):
    tiny_captures.LAYOUTS[layout][0](tmp_path)
    endless(tmp_path / name)
    with pytest.raises(fg.FastGSError):
        open_capture(tmp_path, layout=layout)
    with pytest.raises(fg.FastGSError):
        open_capture(tmp_path / name)
    with pytest.raises(fg.FastGSError):
        open_capture(tmp_path / name, layout=layout)


@pytest.mark.posix
def test_pipes_and_devices_as_camera_files(endless, tmp_path):
    endless(tmp_path / "a.json")
    refused("pipe.*device", load_cameras, tmp_path / "a.json")
    refused("pipe.*device", load_path, tmp_path / "a.json")


@pytest.mark.parametrize("name", [3, ["a"], "", None, {"a": 1}])
def test_names_that_are_no_texts(tmp_path, name):
    tiny_captures.immersive(tmp_path)
    models = json.loads((tmp_path / "models.json").read_text())
    (tmp_path / "models.json").write_text(json.dumps([models[0], models[1] | {"name": name}]))
    refused("camera 1.*name.*text", open_capture, tmp_path)


@pytest.mark.parametrize("stated", ["/", ".", "..", "a/..", "a" * 5000, "\0"])
def test_paths_that_name_no_picture(tmp_path, stated):
    tiny_captures.transforms(tmp_path)
    values = json.loads((tmp_path / "transforms.json").read_text())
    values["frames"][0]["file_path"] = stated
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    try:
        capture = open_capture(tmp_path)
    except fg.FastGSError:
        return
    assert any("left out" in note for note in capture.notes)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('left="4"', 'left="36"', "calibrated for 0 x 24"), ('right="39"', 'right="-1"', "one pixel"),
    ('focalLengthU="1920"', 'focalLengthU="0"', "focalLengthU"), ('sensorMaxU="2559"', 'sensorMaxU="1e300"', "one pixel"),
    ("<calibration", '<!DOCTYPE c [<!ENTITY a "b">]><calibration', "entities")])
def test_calibrations_of_nothing(tmp_path, old, new, words):
    tiny_captures.qualisys(tmp_path)
    file = tmp_path / "calib.qca.txt"
    file.write_text(file.read_text().replace(old, new))
    refused(words, open_capture, tmp_path, layout="qualisys")


def test_entities_in_another_encoding(tmp_path):
    tiny_captures.qualisys(tmp_path)
    file = tmp_path / "calib.qca.txt"
    body = file.read_text().partition("\n")[2]
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "x" * 50}">' for i in range(9))
    file.write_bytes(f'<?xml version="1.0" encoding="UTF-16"?>\n<!DOCTYPE c [{entities}]>{body}'.encode("utf-16"))
    refused("entities", open_capture, file, layout="qualisys")


def test_a_folder_without_pictures_that_is_called_like_a_video(tmp_path):
    tiny_captures.qualisys(tmp_path)
    (tmp_path / "film 1000").rename(tmp_path / "other")
    (tmp_path / "film 1000.mp4").mkdir()
    assert open_capture(tmp_path, layout="qualisys").views == ["1001"]


def test_numbers_far_apart(tmp_path):
    tiny_captures.n3v(tmp_path / "n3v")
    tiny_captures.picture(tmp_path / "n3v/cam00/images/999999999.png", 0, 0)
    refused("missing", open_capture, tmp_path / "n3v")
    tiny_captures.technicolor(tmp_path / "technicolor")
    tiny_captures.picture(tmp_path / "technicolor/Fabien_undist_999999999_00.png", 0, 0)
    refused("1000000 pictures", open_capture, tmp_path / "technicolor")
    tiny_captures.colmap_frames(tmp_path / "colmap")
    (tmp_path / "colmap/colmap_1").rename(tmp_path / "colmap/colmap_99999999999999999999")
    refused("1000000 pictures", open_capture, tmp_path / "colmap", layout="colmap")
    tiny_captures.qualisys(tmp_path / "qualisys")
    tiny_captures.picture(tmp_path / "qualisys/film 1000/999999999.png", 0, 0)
    refused("missing", open_capture, tmp_path / "qualisys")


def test_a_view_with_an_escape_sequence(tmp_path):
    tiny_captures.panoptic(tmp_path)
    file = tmp_path / "train_meta.json"
    values = json.loads(file.read_text())
    values["cam_id"] = [["\udcff\x1b[31m"], ["\udcff\x1b[31m"]]
    file.write_text(json.dumps(values))
    capture = open_capture(tmp_path, layout="panoptic")
    assert capture.views[0] == "\\udcff\\x1b[31m"
    text(describe(capture)).encode()
    assert open_capture(tmp_path, layout="panoptic", held_out=[capture.views[0]]).held_out_views == [capture.views[0]]


def png(width=8, height=8, length=None) -> bytes:
    """A PNG of 8 bits of grey whose header and first data chunk say what they like."""
    import zlib

    def chunk(kind, content, length=None):
        size = len(content) if length is None else length
        return struct.pack(">I", size) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(bytes(9 * 8)), length) + chunk(b"IEND", b""))


@pytest.mark.parametrize(("content", "words"), [
    (png(length=2**31 - 1), None), (png(length=2**32 - 1), None), (png(60_000, 60_000), "more than"),
    (png(10_000, 10_000), "short.*10000 x 10000"), (b"GIF89a" + bytes(40), "no PNG or JPEG")])
@pytest.mark.posix
def test_pictures_that_claim_too_much(tmp_path, content, words):
    import resource

    file = tmp_path / "a.png"
    file.write_bytes(png())
    pictures.read(Source(file))
    file.write_bytes(content)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + 2**28, before[1]))
    try:
        if words:
            refused(words, pictures.read, Source(file))
        else:  # the pixels are there, and the length is not believed
            assert pictures.read(Source(file))[0].shape == (8, 8, 3)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_exr_offsets_beyond_any_file(tmp_path):
    planes = {name: np.zeros((6, 8), np.float32) for name in "RGB"}
    file = tmp_path / "a.exr"
    OpenEXR.File({"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(str(file))
    good = file.read_bytes()
    table = good.index(struct.pack("<Q", len(good) - 6 * (8 + 3 * 4 * 8)))
    for offset in (2**63, 2**64 - 1, 2**63 - 1, 2**40):
        file.write_bytes(good[:table] + struct.pack("<Q", offset) + good[table + 8:])
        with contextlib.suppress(fg.FastGSError):
            assert pictures.read(Source(file))[0].shape == (6, 8, 3)  # OpenEXR makes a damaged table again where it can


def test_a_playlist_is_no_video(tmp_path):
    tiny_captures.video(tmp_path / "real.mp4")
    (tmp_path / "a.ts").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nreal.mp4\n#EXT-X-ENDLIST\n")
    (tmp_path / "b.mp4").write_text("ffconcat version 1.0\nfile real.mp4\n")
    for name in ("a.ts", "b.mp4"):
        refused(name, video.index, tmp_path / name)


def test_a_video_without_a_known_codec(tmp_path):
    tiny_captures.video(tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "b.mp4").write_bytes(data.replace(b"avc1\0\0\0\0", b"zzzz\0\0\0\0").replace(b"avcC", b"zzzC"))
    refused("b.mp4: .*(decoder|cannot be read)", video.index, tmp_path / "b.mp4")


@pytest.mark.slow
def test_a_few_keyframes_make_no_endless_path(tmp_path):
    keys = [{"R": [0, 0, 0, 1], "T": [0, 0, 0], "fov": 50, "timestamp": t} for t in (1, 20000)]
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"path": keys, "loop": True}))
    assert file.stat().st_size < 200
    refused("43200.*keyframes", load_path, file, Picture(fps=24))
    keys[1]["timestamp"] = 1700
    file.write_text(json.dumps({"path": keys, "loop": True}))
    assert len(load_path(file, Picture(fps=24))) == 40801


def test_the_two_kinds_of_cameras_json(tmp_path):
    tiny_captures.fastgs(tmp_path)
    refused("fast-gs capture", load_cameras, tmp_path / "cameras.json")
    (tmp_path / "other").mkdir()
    entry = {"id": 0, "img_name": "a", "width": 8, "height": 8, "position": [0, 0, 0], "rotation": np.eye(3).tolist(), "fx": 9, "fy": 9}
    (tmp_path / "other/cameras.json").write_text(json.dumps([entry]))
    assert load_cameras(tmp_path / "other/cameras.json")[0].name == "a" and len(load_path(tmp_path / "other/cameras.json")) == 1
    refused("another program's", open_capture, tmp_path / "other/cameras.json", layout="fastgs")
    refused("no camera path", load_path, tmp_path / "cameras.json")


NETWORK = (r"\\host\share\1.png", "//host/share/1.png", r"\\?\UNC\host\share\1.png")


@pytest.mark.parametrize("stated", NETWORK)
@pytest.mark.parametrize("key", ["file_path", "mask_path", "ply_file_path"])
def test_transforms_ask_no_other_machine(key, stated, tmp_path):
    """Windows would tell that machine the user's name and a hash of the password."""
    tiny_captures.transforms(tmp_path)
    file = tmp_path / "transforms.json"
    values = json.loads(file.read_text())
    (values if key == "ply_file_path" else values["frames"][0])[key] = stated
    file.write_text(json.dumps(values))
    assert key in refused("on this machine", open_capture, tmp_path)


@pytest.mark.parametrize("stated", NETWORK)
def test_colmap_and_panoptic_ask_no_other_machine(stated, tmp_path):
    tiny_captures.panoptic(tmp_path / "p")
    file = tmp_path / "p" / "train_meta.json"
    values = json.loads(file.read_text())
    values["fn"][0][0] = stated
    file.write_text(json.dumps(values))
    refused("fn .*picture", open_capture, tmp_path / "p")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "cameras.txt").write_text("1 PINHOLE 8 8 8 8 4 4\n")
    (tmp_path / "c" / "images.txt").write_text(f"1 1 0 0 0 0 0 0 1 {stated}\n\n")
    refused("name.*picture", load_path, tmp_path / "c")
