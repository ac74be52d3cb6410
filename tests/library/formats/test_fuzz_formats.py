# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that chance or malice has changed: a model of finite numbers, or one FastGSError; nothing else, and no memory."""
from __future__ import annotations

import json
import os
import struct
import tracemalloc
import warnings
from pathlib import Path

import mutations
import numpy as np
import ply_files
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error", "ignore::fastgs_blender.LossWarning")
CAMERA = fg.Camera(20, 12, 8.0, 8.0, 10.0, 6.0, np.eye(4))
KINDS = {
    "rgb.ply": {}, "sh3.ply": {"appearance": "sh3"},
    "lite.ply": {"basis": "cubic", "rotation_basis": "line", "temporal": "radial"},
    "full.ply": {"basis": "paper", "rotation_basis": "line", "temporal": "radial", "appearance": "sigmoid"},
    "cosine.ply": {"basis": "cosine"},
    "keys.safetensors": {"basis": "keys", "rotation_basis": "smooth keys", "temporal": "window", "appearance": "clamp"},
    "paper.safetensors": {"basis": "paper", "rotation_basis": "line", "temporal": "radial", "appearance": "sh1"},
    "lite.splatv": {"basis": "cubic", "rotation_basis": "line", "temporal": "radial"},
}


@pytest.fixture(scope="module")
def valid(tmp_path_factory) -> dict[str, bytes]:
    """A small valid file of every kind, and `full.pt`."""
    rng, folder, files = np.random.default_rng(3), tmp_path_factory.mktemp("valid"), {}
    for name, kinds in KINDS.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fg.LossWarning)
            fg.save(random_model(rng, 4, **kinds), folder / name)
        files[name] = (folder / name).read_bytes()
    files["full.pt"] = (folder / "full.pt").read_bytes()
    files["lite.splatv"] = without_padding(files["lite.splatv"])
    table = ply_files.columns(rng, ply_files.INRIA, 4)
    for kind, order in ply_files.FORMATS.items():
        files[f"{kind}.ply"] = ply_files.ply(table, kind, before=[ply_files.faces(order)])
    shown = {name: values for name, values in table.items() if not name.startswith(("f_dc", "scale_1", "scale_2"))}
    shown |= {name: np.arange(4) for name in ("red", "green", "blue")}
    files["nerfstudio.ply"] = ply_files.ply(shown, types=dict.fromkeys(("red", "green", "blue"), "uchar"))
    files["mip.ply"] = ply_files.ply(ply_files.columns(rng, [*ply_files.INRIA, "filter_3D"], 4))
    files["cloudcompare.ply"] = ply_files.ply({name if name in "xyz" else f"scalar_{name}": values for name, values in table.items()})
    return files


def without_padding(data: bytes) -> bytes:
    """A .splatv of five records, so that changes hit something."""
    size = struct.unpack("<II", data[:8])[1]
    chunk = json.loads(data[8:8 + size])[0] | {"size": 320}
    text = json.dumps([chunk]).encode()
    return struct.pack("<II", 0x674B, len(text)) + text + data[8 + size:][:320]


def survives(path: Path) -> fg.GaussianModel:
    """Load a file; whatever comes of it must be usable at any time, and a refusal must name the file."""
    try:
        model = fg.load(path)
    except fg.FastGSError as error:
        if str(path) not in str(error):
            raise AssertionError(f"the file is not named: {error}") from error
        raise
    assert all(np.isfinite(a).all() and a.dtype == np.float32 for a in model.arrays.values())
    for t in (0.0, 0.4, 1.0):
        s = fg.slice_model(model, t, cull=False)
        assert all(np.isfinite(v).all() for v in (s.position, s.rotation, s.scale, s.opacity, s.features, s.velocity))
    image = fg.render(model, CAMERA, 0.4, ("rgb", "alpha"), backend="cpu")
    assert np.isfinite(image["rgb"]).all() and np.isfinite(image["alpha"]).all()
    return model


def loaded(path: Path, data: bytes, decoder: bytes = b"") -> fg.GaussianModel | None:
    """survives() of this content; None where it is refused."""
    path.write_bytes(data)
    path.with_suffix(".pt").write_bytes(decoder)
    try:
        return survives(path)
    except fg.FastGSError:
        return None


OTHERS = [*(f"{kind}.ply" for kind in ply_files.FORMATS), "nerfstudio.ply", "cloudcompare.ply", "mip.ply"]
NAMES = [*KINDS, *OTHERS]


@pytest.mark.parametrize("name", NAMES)
def test_the_valid_files_are_valid(valid, tmp_path, name):
    assert len(loaded(tmp_path / "m", valid[name], valid["full.pt"])) == 4


def read(folder: Path) -> None:
    """For campaigns: the model in the folder's file m."""
    survives(folder / "m")


CAMPAIGNS = {
    "native": ["keys.safetensors", "paper.safetensors"], "INRIA": ["rgb.ply", "sh3.ply", *OTHERS],
    "STG": ["lite.ply", "full.ply", "cosine.ply"], "splatv": ["lite.splatv"],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CAMPAIGNS)
def test_mutations(valid, tmp_path, kind):
    seeds = {name: {"m": valid[name]} | ({"m.pt": valid["full.pt"]} if name == "full.ply" else {}) for name in CAMPAIGNS[kind]}
    told = mutations.campaign(kind, read, seeds, tmp_path)
    assert min(told.values(), default=1) > 0, told


def test_mutated_decoders(valid, tmp_path):
    seeds = {"full": {"m": valid["full.ply"], "m.pt": valid["full.pt"]}}
    mutations.campaign("decoder", read, seeds, tmp_path, fixed=["m"])


@pytest.mark.parametrize("name", NAMES)
def test_all_numbers_nan(valid, tmp_path, name):
    content = valid[name]
    if name == "ascii.ply":
        head, body = content.split(b"end_header\n")
        content = head + b"end_header\n" + b"\n".join([*body.split(b"\n")[:2], *[b"nan " * 14] * 4])
    else:
        if name.endswith("ply"):
            size = 16 * content.count(b"\nproperty float ")
        else:
            size = 320 if name == "lite.splatv" else len(content) - 8 - int.from_bytes(content[:8], "little")
        content = content[:-size] + (b"\x7f\xff" if "big" in name else b"\xff\x7f") * (size // 2)
    assert loaded(tmp_path / "m", content, valid["full.pt"]) is None


def with_size(text: bytes) -> bytes:
    """A safetensors file that is nothing but its header."""
    return len(text).to_bytes(8, "little") + text


VERTEX = "".join(f"property float {name}\n" for name in ply_files.INRIA)
ROW = b"0 " * 14 + b"\n"
ATTACKS = {
    "rows of nothing": b"ply\nformat ascii 1.0\n" + b"".join(b"element e%d 5000000\n" % i for i in range(100))
    + f"element vertex 1\n{VERTEX}end_header\n".encode() + ROW,
    "elements": b"ply\nformat ascii 1.0\n" + b"".join(b"element %d 0\n" % i for i in range(66_000)) + b"end_header\n",
    "elements and a vertex": b"ply\nformat ascii 1.0\n" + b"".join(b"element %d 0\n" % i for i in range(40_000))
    + f"element vertex 1\n{VERTEX}end_header\n".encode() + ROW,
    "columns": b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"".join(b"property char c%d\n" % i for i in range(50_000)) + b"end_header\n",
    "rows of lists": b"ply\nformat binary_little_endian 1.0\n" + b"".join(
        b"element e%d 4000000\nproperty list char char a\n" % i for i in range(50)) + f"element vertex 1\n{VERTEX}end_header\n".encode()
    + bytes(4_000_000),
    "a long number": f"ply\nformat ascii 1.0\nelement vertex 1\n{VERTEX}end_header\n".encode() + b"9" * 4_000_000 + b" " + ROW,
    "deep JSON": b"ply\nformat ascii 1.0\ncomment fastgs clip " + b"[" * 100_000
    + f"\nelement vertex 1\n{VERTEX}end_header\n".encode() + ROW,
    "header entries that are lists": with_size(b'{"__metadata__":{"fast-gs":"{\\"version\\":1}"},"position":[1,2]}'),
    "header entries that are words": with_size(
        b'{"__metadata__":{"fast-gs":["a"]},"position":{"dtype":[],"shape":"3","data_offsets":{}}}'),
}


@pytest.mark.slow
def test_files_that_once_harmed_a_reader(tmp_path):
    told = mutations.attacks("models", read, {name: {"m": content} for name, content in ATTACKS.items()}, tmp_path)
    assert told == {"accepted": 1, "refused": len(ATTACKS) - 1}


@pytest.mark.parametrize("read", [fg.load, identify])
@pytest.mark.posix
def test_pipes_and_devices_are_refused_at_once(tmp_path, valid, read):
    os.mkfifo(tmp_path / "m.ply")
    for path in (tmp_path / "m.ply", Path("/dev/zero")):
        with pytest.raises(fg.FastGSError, match="pipe"):
            read(path)
    (tmp_path / "full.ply").write_bytes(valid["full.ply"])
    os.mkfifo(tmp_path / "full.pt")
    with pytest.raises(fg.FastGSError, match=r"full\.pt .*pipe"):
        fg.load(tmp_path / "full.ply")


def test_no_memory_on_the_word_of_a_file(valid, tmp_path):
    """Whatever digit of a header becomes a large number, loading costs little more than the file."""
    for name in NAMES:
        content = valid[name]
        stop = min(len(content), content.find(b"property") if b"property" in content else 900)
        digits = [i for i in range(stop) if 48 <= content[i] <= 57]
        tracemalloc.start()
        try:
            for at in digits[::2]:
                loaded(tmp_path / "m", content[:at] + b"999999999" + content[at + 1:], valid["full.pt"])
            assert tracemalloc.get_traced_memory()[1] < 16 << 20, name
        finally:
            tracemalloc.stop()
