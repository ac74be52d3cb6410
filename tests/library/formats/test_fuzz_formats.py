# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that chance or malice has changed: a model of finite numbers, or one FastGSError; nothing else, and no memory."""
from __future__ import annotations

import json
import struct
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import ply_files
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_model

import fastgs_blender as fg

pytestmark = pytest.mark.filterwarnings("error", "ignore::fastgs_blender.LossWarning")
EXAMPLES = settings(max_examples=60)
SPICE = [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\x80\x7f", b"\0\0\xc0\x7f", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\0\x7c\0\x7e",
         b"nan", b"1e400", b"-1", b"99999999999", b"\n", b" ", b"end_header\n", b"property list uchar int x\n", b"{", b"[" * 2000, b'"',
         b"comment fastgs basis "]
"""Bytes that mean something: integers and floats at their ends, and words of the formats."""
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
    return files


def without_padding(data: bytes) -> bytes:
    """A .splatv of five records, so that changes hit something."""
    size = struct.unpack("<II", data[:8])[1]
    chunk = json.loads(data[8:8 + size])[0] | {"size": 320}
    text = json.dumps([chunk]).encode()
    return struct.pack("<II", 0x674B, len(text)) + text + data[8 + size:][:320]


def survives(path: Path, data: bytes, decoder: bytes) -> fg.GaussianModel | None:
    """Load a file of this content; whatever comes of it must be usable at any time."""
    path.write_bytes(data)
    path.with_suffix(".pt").write_bytes(decoder)
    model = sentence = None
    try:
        model = fg.load(path)
    except fg.FastGSError as error:
        sentence = str(error)
    if model is None:
        assert str(path) in sentence
        assert "\n" not in sentence
        return None
    assert all(np.isfinite(a).all() and a.dtype == np.float32 for a in model.arrays.values())
    for t in (0.0, 0.4, 1.0):
        s = fg.slice_model(model, t, cull=False)
        assert all(np.isfinite(v).all() for v in (s.position, s.rotation, s.scale, s.opacity, s.features, s.velocity))
    return model


@st.composite
def changes(draw):
    """A list of edits; places are fractions of the length, more of them near the beginning."""
    place = st.floats(0, 1, exclude_max=True).map(lambda x: x * x) | st.floats(0, 1, exclude_max=True)
    what = st.sampled_from(["set", "set", "flip", "insert", "spice", "spice", "cut", "repeat", "end"])
    edit = st.tuples(place, what, st.integers(0, 255), st.sampled_from(SPICE), st.integers(1, 40))
    return draw(st.lists(edit, min_size=1, max_size=6))


def changed(data: bytes, edits) -> bytes:
    """The data after the edits of changes()."""
    out = bytearray(data)
    for place, what, value, spice, length in edits:
        at = int(place * len(out))
        if not out or what == "end":
            del out[at:]
        elif what == "set":
            out[at] = value
        elif what == "flip":
            out[at] ^= 1 << value % 8
        elif what == "insert":
            out[at:at] = bytes([value]) * length
        elif what == "spice":
            out[at:at + len(spice) * (value % 2)] = spice  # over what was there, or before it
        elif what == "cut":
            del out[at:at + length]
        else:
            out[at:at] = out[at:at + length]
    return bytes(out)


NAMES = [*KINDS, *(f"{kind}.ply" for kind in ply_files.FORMATS)]


@pytest.mark.parametrize("name", NAMES)
def test_the_valid_files_are_valid(valid, tmp_path, name):
    assert len(survives(tmp_path / "m", valid[name], valid["full.pt"])) == 4


@pytest.mark.parametrize("name", NAMES)
@EXAMPLES
@given(edits=changes())
def test_changed_bytes(valid, tmp_path, name, edits):
    survives(tmp_path / "m", changed(valid[name], edits), valid["full.pt"])


@EXAMPLES
@given(edits=changes())
def test_changed_decoders(valid, tmp_path, edits):
    survives(tmp_path / "m", valid["full.ply"], changed(valid["full.pt"], edits))


@pytest.mark.parametrize("name", NAMES)
@EXAMPLES
@given(data=st.data())
def test_changed_numbers(valid, tmp_path, name, data):
    """Any float in the place of any other, so that the file stays a file and its numbers go mad."""
    content = bytearray(valid[name])
    if name == "ascii.ply":
        words = bytes(content).split(b" ")
        for _ in range(3):
            words[data.draw(st.integers(len(words) // 2, len(words) - 2))] = repr(data.draw(st.floats())).encode()
        content = b" ".join(words)
    else:
        for _ in range(data.draw(st.integers(1, 8))):
            at = 4 * data.draw(st.integers(1, 20))
            code = ">f" if "big" in name else data.draw(st.sampled_from(["<f", "<2e"])) if name.endswith("splatv") else "<f"
            values = [data.draw(st.floats(width=16 if code == "<2e" else 32)) for _ in range(len(code) - 1)]
            content[len(content) - at:len(content) - at + 4] = struct.pack(code, *values)
    survives(tmp_path / "m", bytes(content), valid["full.pt"])


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
    assert survives(tmp_path / "m", content, valid["full.pt"]) is None


NUMBERS = st.integers(-3, 7) | st.sampled_from([10**9, -10**9, 10**30, 2**63, 1e308, -0.0]) | st.floats()
WORDS = st.sampled_from(["fourier", "cosine", "keyframes", "polynomial", "static", "sh", "rgb", "features", "always", "linear"])
KEYS = st.sampled_from(["name", "order", "degree", "times", "scale", "offset", "linear", "interpolation", "fps", "blur"])
json_values = st.recursive(st.none() | st.booleans() | NUMBERS | WORDS | st.text(max_size=4),
                           lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=8)


@st.composite
def damage(draw, table):
    """The table with one value somewhere in it replaced or taken out."""
    table = json.loads(json.dumps(table))
    node = table
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = draw(st.sampled_from(keys))
        if isinstance(node[key], (dict, list)) and node[key] and draw(st.booleans()):
            node = node[key]
            continue
        if draw(st.integers(0, 5)):
            node[key] = draw(json_values)
        else:
            del node[key]
        return table


@pytest.mark.parametrize("name", [n for n in KINDS if n.endswith("safetensors")])
@settings(max_examples=150)
@given(data=st.data())
def test_damaged_descriptions(valid, tmp_path, name, data):
    content = valid[name]
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8:8 + size])
    if data.draw(st.integers(0, 3)):
        about = data.draw(damage(json.loads(header["__metadata__"]["fast-gs"])))
        header["__metadata__"]["fast-gs"] = json.dumps(about)
    else:
        header = data.draw(damage(header))
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    survives(tmp_path / "m", len(text).to_bytes(8, "little") + text + content[8 + size:], b"")


@settings(max_examples=120)
@given(data=st.data())
def test_damaged_splatv_headers(valid, tmp_path, data):
    content = valid["lite.splatv"]
    size = struct.unpack("<II", content[:8])[1]
    text = json.dumps(data.draw(damage(json.loads(content[8:8 + size])))).encode()
    survives(tmp_path / "m", struct.pack("<II", 0x674B, len(text)) + text + content[8 + size:], b"")


@settings(max_examples=120)
@given(data=st.data())
def test_damaged_comments(valid, tmp_path, data):
    name = data.draw(st.sampled_from(["lite.ply", "full.ply", "cosine.ply", "rgb.ply"]))
    lines = valid[name].split(b"\n")
    ours = [i for i, line in enumerate(lines[:20]) if line.startswith(b"comment fastgs ")]
    at = data.draw(st.sampled_from(ours))
    key, text = lines[at].split(b" ", 3)[2:]
    lines[at] = b"comment fastgs " + key + b" " + json.dumps(data.draw(damage([json.loads(text)]))[:1] or [0])[1:-1].encode()
    survives(tmp_path / "m", b"\n".join(lines), valid["full.pt"])


@settings(max_examples=120)
@given(head=st.sampled_from([b"", b"ply\n", b"ply\nformat ascii 1.0\nelement vertex 2\n", b"\x4b\x67\0\0", b"\x20\0\0\0\0\0\0\0{"]),
       rest=st.binary(max_size=300))
def test_noise(tmp_path, head, rest):
    survives(tmp_path / "m", head + rest, rest)


def test_no_memory_on_the_word_of_a_file(valid, tmp_path):
    """Whatever digit of a header becomes a large number, loading costs little more than the file."""
    for name in NAMES:
        content = valid[name]
        stop = min(len(content), content.find(b"property") if b"property" in content else 900)
        digits = [i for i in range(stop) if 48 <= content[i] <= 57]
        tracemalloc.start()
        try:
            for at in digits[::2]:
                survives(tmp_path / "m", content[:at] + b"999999999" + content[at + 1:], valid["full.pt"])
            assert tracemalloc.get_traced_memory()[1] < 16 << 20, name
        finally:
            tracemalloc.stop()
