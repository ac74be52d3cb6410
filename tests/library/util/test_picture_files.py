# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures written with NumPy are what Pillow and OpenEXR read; generated rigs look where they should; held files are told."""
import json
import struct
import subprocess
import sys
from pathlib import Path

import mutations
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.captures import generated
from fastgs_blender.captures.point_files import load_points
from fastgs_blender.util import locks
from fastgs_blender.util.picture_files import read_exr, write_exr, write_png

ROOT = Path(__file__).resolve().parents[3]
SIDES = st.integers(1, 9) | st.sampled_from([16, 17, 64, 70])


@given(SIDES, SIDES, st.sampled_from([None, 3, 4]), st.integers(0, 2**32 - 1))
def test_png_is_what_pillow_reads(tmp_path_factory, height, width, channels, seed):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, *([channels] if channels else [])), np.uint8)
    path = tmp_path_factory.getbasetemp() / "a.png"
    write_png(path, pixels)
    assert np.array_equal(np.asarray(Image.open(path)), pixels)


@given(SIDES, SIDES, st.sets(st.sampled_from(["Z", "R", "Layer.Combined.G", "a"]), min_size=1), st.integers(0, 2**32 - 1))
def test_exr_comes_back_and_openexr_reads_it(tmp_path_factory, height, width, names, seed):
    rng = np.random.default_rng(seed)
    planes = {name: rng.normal(size=(height, width)).astype(np.float32) for name in names}
    path = tmp_path_factory.getbasetemp() / "a.exr"
    write_exr(path, planes, {"comments": "frame 1; é", "a name of more than thirty-one letters": ""})
    again, _ = read_exr(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert file.header()["comments"] == "frame 1; é"
        theirs = {name: channel.pixels for name, channel in file.channels().items()}
    assert set(again) == set(theirs) == set(names)
    for name, plane in planes.items():
        assert np.array_equal(again[name], plane) and np.array_equal(theirs[name], plane)


@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "ZIPS_COMPRESSION", "ZIP_COMPRESSION"])
def test_exrs_of_openexr_are_read(tmp_path, rng, compression):
    planes = {"Z": rng.normal(size=(37, 11)).astype(np.float32), "half": np.ones((37, 11), np.float16), "n": np.zeros((37, 11), np.uint32)}
    header = {"compression": getattr(OpenEXR, compression), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict(planes)).write(str(tmp_path / "a.exr"))
    again, _ = read_exr(tmp_path / "a.exr")
    for name, plane in planes.items():
        assert again[name].dtype == plane.dtype and np.array_equal(again[name], plane)


def test_mutations_of_exrs(tmp_path, rng):
    seeds = {}
    for name in ("NO_COMPRESSION", "ZIP_COMPRESSION"):
        header = {"compression": getattr(OpenEXR, name), "type": OpenEXR.scanlineimage}
        parts = [OpenEXR.Part(dict(header), {c: rng.random((20, 7)).astype("f4")}, c) for c in ("a", "b")]
        OpenEXR.File(parts).write(str(tmp_path / f"{name}.exr"))
        seeds[name] = {"a.exr": (tmp_path / f"{name}.exr").read_bytes()}

    def read(folder):
        planes, _ = read_exr(folder / "a.exr")
        assert all(plane.ndim == 2 for plane in planes.values())

    told = mutations.campaign("exr", read, seeds, tmp_path)
    assert min(told.values()) > 0
    plain = seeds["NO_COMPRESSION"]["a.exr"]
    at = plain.index(struct.pack("<Q", plain.index(struct.pack("<iii", 0, 0, 28))))
    attacks = {"an offset beyond 2^63": {"a.exr": plain[:at] + b"\xff" * 8 + plain[at + 8:]},
               "2^31 lines": {"a.exr": plain.replace(struct.pack("<4i", 0, 0, 6, 19), struct.pack("<4i", 0, 0, 2**31 - 2, 2**31 - 2))},
               "one line many times": {"a.exr": plain.replace(struct.pack("<4i", 0, 0, 6, 19), struct.pack("<4i", 0, 0, 6, -1))}}
    assert mutations.attacks("exr", read, attacks, tmp_path) == {"accepted": 0, "refused": 3}


def test_other_exrs_and_cut_ones_are_refused(tmp_path):
    plane = np.zeros((4, 5), np.float32)
    with OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Z": plane}) as file:
        file.write(str(tmp_path / "piz.exr"))
    write_exr(tmp_path / "whole.exr", {"Z": plane})
    whole = (tmp_path / "whole.exr").read_bytes()
    for i, data in enumerate(((tmp_path / "piz.exr").read_bytes(), b"", b"\x89PNG", whole[:40], whole[:-1])):
        (tmp_path / f"{i}.exr").write_bytes(data)
        with pytest.raises(fg.FastGSError, match="EXR.*scan lines"):
            read_exr(tmp_path / f"{i}.exr")


@pytest.mark.parametrize("rig", ["dome", "arc"])
def test_rigs_look_at_the_middle_from_different_places(rig):
    eyes = np.array([1, 2, 3]) + 4 * generated.directions(12, rig)
    for eye in eyes:
        matrix = fg.look_at(eye, np.array([1, 2, 3]))
        assert np.allclose(matrix @ [1, 2, 3, 1], [0, 0, 4, 1]) and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3))
        assert matrix[1, 2] < 0, "up in the picture is up in the world"
    apart = np.linalg.norm(eyes[:, None] - eyes[None], axis=2)[~np.eye(12, dtype=bool)]
    assert apart.min() > 0.3 and (eyes[:, 2] > 3).all()


def test_cover_and_points(tmp_path):
    code = np.uint32(0x3F001234)
    identity = np.full((2, 3), 7, np.uint32)
    identity[0, 1] = code
    zero = np.zeros((2, 3), np.float32)
    planes = {f"CryptoObject00.{letter}": zero for letter in "ba"} | {"CryptoObject00.r": identity.view(np.float32)}
    planes["CryptoObject00.g"] = zero + 0.75
    share = generated.cover(planes, json.dumps({"Ball": "3f001234", "Floor": "00000009"}), {"Ball"})
    assert share[0, 1] == 0.75 and np.count_nonzero(share) == 1
    identity[0, 1] = 0x8099CDB4  # Cycles' manifests hold the hash, 8019cdb4, which as a float would be denormalised
    np.testing.assert_array_equal(generated.cover(planes, json.dumps({"torso": "8019cdb4", "Floor": "3f001234"}), {"torso"}), share)

    camera = fg.Camera(3, 2, 4.0, 5.0, 1.4, 1.1, fg.look_at(np.array([3.0, -2, 1]), np.zeros(3)))
    xyz = generated.unproject(camera, zero + 2.5, np.array([0, 1]), np.array([2, 0]))
    seen = np.c_[xyz, np.ones(2)] @ camera.world_to_camera.T
    assert np.allclose(seen[:, 2], 2.5)
    assert np.allclose(4 * seen[:, 0] / 2.5 + 1.4, [2.5, 0.5]) and np.allclose(5 * seen[:, 1] / 2.5 + 1.1, [0.5, 1.5])
    generated.write_points(tmp_path / "points.ply", xyz, np.array([[0, 128, 255]] * 2), np.array([0.5, np.nan]))
    points = load_points(tmp_path / "points.ply")
    assert np.allclose(points.xyz, xyz) and np.allclose(points.rgb[0], [0, 128 / 255, 1])
    assert points.t[0] == 0.5 and np.isnan(points.t[1])


def test_a_held_file_is_free_when_its_process_is_killed(tmp_path):
    path = tmp_path / "lock"
    assert not locks.is_locked(path)
    code = "import sys; from fastgs_blender.util import locks; f = locks.acquire(sys.argv[1]); print('held', flush=True); sys.stdin.read()"
    child = subprocess.Popen([sys.executable, "-c", code, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert child.stdout.readline() == "held\n"
        assert locks.is_locked(path) and locks.acquire(path) is None
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
        child.stdin.close()
    assert not locks.is_locked(path)
    with locks.acquire(path) as mine:
        assert mine is not None
