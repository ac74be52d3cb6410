# SPDX-License-Identifier: GPL-3.0-or-later
"""Our own format: exact, checked, and independent of the file once it is read."""
from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from random_models import APPEARANCES, BASES, TEMPORALS
from safetensors.numpy import load_file, save_file

import fastgs_blender as fg
from fastgs_blender.formats import identify

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.filterwarnings("error")


def about(path) -> dict:
    """The JSON in the header."""
    with open(path, "rb") as stream:
        header = json.loads(stream.read(int.from_bytes(stream.read(8), "little")))
    return json.loads(header["__metadata__"]["fast-gs"])


def rewrite(path, change=None, arrays=None, metadata=None):
    """The same file with its JSON changed by change(about), or with other arrays, or with other metadata."""
    values, tensors = about(path), load_file(path)
    if change:
        change(values)
    save_file({k: v for k, v in {**tensors, **(arrays or {})}.items() if v is not None}, path,
              metadata or {"fast-gs": json.dumps(values)})


def same(a: fg.GaussianModel, b: fg.GaussianModel) -> None:
    """The two models agree in everything."""
    for name, array in a.arrays.items():
        np.testing.assert_array_equal(b.arrays[name], array, err_msg=name)
    for name in ("basis", "rotation_basis", "temporal_kind", "raster", "clip", "axes", "colour_space", "provenance"):
        assert getattr(b, name) == getattr(a, name)
    assert type(b.appearance) is type(a.appearance)
    if isinstance(a.appearance, fg.Features):
        np.testing.assert_array_equal(b.appearance.w1, a.appearance.w1)
        np.testing.assert_array_equal(b.appearance.w2, a.appearance.w2)
        assert (b.appearance.activation, b.appearance.decode) == (a.appearance.activation, a.appearance.decode)
    else:
        assert b.appearance == a.appearance


@pytest.fixture
def rich(rng, make_model):
    """A model in which nothing is at its default."""
    return make_model(rng, basis="fourier", rotation_basis="smooth keys", temporal="window", appearance="clamp", axes="RUB",
                      raster=fg.Raster(0.1, 0.999, 1 / 300, 0.01, True), clip=fg.Clip(81, 23.976, -5), colour_space="linear",
                      provenance={"trainer": "ein \"Test\"\n", "ключ": "值"})


@pytest.mark.slow
@pytest.mark.parametrize("appearance", APPEARANCES)
@pytest.mark.parametrize("temporal", TEMPORALS)
@pytest.mark.parametrize("basis", BASES)
def test_every_kind_comes_back_exactly(rng, make_model, tmp_path, basis, temporal, appearance):
    model = make_model(rng, 7, basis=basis, rotation_basis=basis, temporal=temporal, appearance=appearance, provenance={"a": "b"})
    fg.save(model, tmp_path / "m.safetensors")
    same(model, fg.load(tmp_path / "m.safetensors"))


def test_all_fields_come_back_exactly(rich, tmp_path):
    fg.save(rich, tmp_path / "m.safetensors")
    same(rich, fg.load(tmp_path / "m.safetensors"))
    assert about(tmp_path / "m.safetensors")["generator"] == f"FAST-GS for Blender {fg.__version__}"
    assert identify(tmp_path / "m.safetensors").name == "FAST-GS safetensors"


def test_files_say_how_a_decoder_is_given_its_features_only_where_it_is_not_the_usual_way(rng, make_model, tmp_path):
    """So the usual ones have the bytes that earlier versions wrote, and those of earlier versions open as they were drawn."""
    for name, wanted in (("sigmoid", None), ("stg", "premultiplied")):
        fg.save(make_model(rng, appearance=name), tmp_path / "m.safetensors")
        assert about(tmp_path / "m.safetensors")["model"]["appearance"].get("decode") == wanted


@pytest.mark.slow
@pytest.mark.parametrize("compress", ["fine", "small"])
def test_compressed_files_say_it_too(rng, make_model, tmp_path, few_pictures, compress):
    with pytest.warns(fg.LossWarning):
        fg.save(make_model(rng, 30, appearance="stg"), tmp_path / "m.safetensors", compress)
    assert fg.load(tmp_path / "m.safetensors").appearance.decode == "premultiplied"


def test_the_name_does_not_matter_for_reading(rich, tmp_path):
    fg.save(rich, tmp_path / "m.SafeTensors")
    os.rename(tmp_path / "m.SafeTensors", tmp_path / "m.ply")
    same(rich, fg.load(tmp_path / "m.ply"))


def test_the_same_model_gives_the_same_bytes(rich, tmp_path):
    for name in "ab":
        fg.save(rich, tmp_path / f"{name}.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_no_gaussians(rng, make_model, tmp_path):
    model = make_model(rng, 0, basis="paper", appearance="sh1")
    fg.save(model, tmp_path / "m.safetensors")
    assert len(fg.load(tmp_path / "m.safetensors")) == 0
    assert fg.load(tmp_path / "m.safetensors").appearance == fg.SH(1)


def test_loading_takes_no_more_memory_than_the_arrays(tmp_path):
    n = 200_000
    model = fg.GaussianModel(np.zeros((n, 3)), np.ones((n, 4)), np.zeros((n, 3)), np.zeros(n), np.zeros((n, 48)), appearance=fg.SH(3))
    fg.save(model, tmp_path / "m.safetensors")
    tracemalloc.start()
    loaded = fg.load(tmp_path / "m.safetensors")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.1 * model.nbytes
    assert type(loaded.position) is np.ndarray


RENDER = """
import sys, numpy as np, fastgs_blender as fg
model = fg.load(sys.argv[1])
camera = fg.Camera(8, 8, 8, 8, 4, 4, np.eye(4))
before = fg.slice_model(model, 0.4).position.tobytes()
for harm in ("shorten", "overwrite", "remove"):
    print(harm, flush=True)
    sys.stdin.readline()
    assert fg.slice_model(model, 0.4).position.tobytes() == before
    assert np.isfinite(fg.render(model, camera, 0.4, backend="reference")["rgb"]).all()
"""


def test_a_loaded_model_outlives_its_file(rich, tmp_path):
    """Another program shortens the file, writes into it, removes it: a mapped file would end the process (SIGBUS) or change."""
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    child = subprocess.Popen([sys.executable, "-c", RENDER, path], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    harms = {"shorten": lambda: os.truncate(path, 100), "overwrite": lambda: path.write_bytes(b"\xff" * 100_000), "remove": path.unlink}
    with child:
        for name, harm in harms.items():
            assert child.stdout.readline() == f"{name}\n"
            harm()
            child.stdin.write("\n")
            child.stdin.flush()
    assert child.returncode == 0


def test_writing_into_a_loaded_model_leaves_the_file_alone(rich, tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    before, stamp = path.read_bytes(), path.stat().st_mtime_ns
    loaded = fg.load(path)
    loaded.position[:] = 7
    assert (loaded.position == 7).all()
    del loaded
    assert path.read_bytes() == before
    assert path.stat().st_mtime_ns == stamp


def test_a_model_can_replace_its_own_file(rich, tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    loaded = fg.load(path)
    shorter = loaded.take(slice(0, 5))
    fg.save(shorter, path)
    same(shorter, fg.load(path))
    same(rich, loaded)


@pytest.mark.parametrize("name", ["position", "features", "motion", "temporal"])
def test_unusable_gaussians_are_left_out_and_said(rich, tmp_path, name):
    rich.arrays[name].reshape(40, -1)[[3, 8, 9], -1] = np.nan
    fg.save(rich, tmp_path / "m.safetensors")
    with pytest.warns(fg.LossWarning, match=f"3 of 40 Gaussians.*{name} are"):
        loaded = fg.load(tmp_path / "m.safetensors")
    same(rich.take(np.delete(np.arange(40), [3, 8, 9])), loaded)


def test_steep_opacity_never_makes_nan(rng, make_model, tmp_path):
    for temporal, values in (("radial", (1e9, -1e9)), ("window", (0.3, 0.6, -1e9, 1e9))):
        model = make_model(rng, 2, temporal=temporal)
        model.temporal[:] = np.reshape(values, (2, 1)) if temporal == "radial" else values
        model.mu_tau[:] = 0.3
        fg.save(model, tmp_path / "m.safetensors")
        loaded = fg.load(tmp_path / "m.safetensors")
        for t in (0.0, 0.3, 0.5, 1e6):
            assert np.isfinite(fg.slice_model(loaded, t, cull=False).opacity).all()


def value(*keys):
    """A setter for one value of the description."""
    def make(new):
        def change(values):
            table = values
            for key in keys[:-1]:
                table = table[key]
            if new is None:
                del table[keys[-1]]
            else:
                table[keys[-1]] = new
        return change
    return make


BAD = {
    "a newer version": (value("version")(5), "newer FAST-GS.*update"),
    "a version from before the first release": (value("version")(2), "version 2"),
    "version 1.5": (value("version")(1.5), "version"),
    "no version": (value("version")(None), "version"),
    "version in words": (value("version")("one"), "version"),
    "no model": (value("model")(None), "nothing about"),
    "a model that is a list": (value("model")([]), "nothing about"),
    "no basis": (value("model", "basis")(None), "nothing about basis"),
    "unknown basis": (value("model", "basis")({"name": "wavelets"}), "basis of time 'wavelets' is unknown"),
    "basis of lists": (value("model", "basis")({"name": ["fourier"]}), "basis of time"),
    "order 1e9": (value("model", "basis", "order")(10**9), "order of a Fourier series"),
    "order 1e30": (value("model", "basis", "order")(10**30), "order cannot be"),
    "order 2.5": (value("model", "basis", "order")(2.5), "order cannot be"),
    "order -1": (value("model", "basis", "order")(-1), "order of a Fourier series"),
    "order in words": (value("model", "basis", "order")("5"), "order cannot be"),
    "another order": (value("model", "basis", "order")(3), "'motion' must be float32 of shape"),
    "linear 1": (value("model", "basis", "linear")(1), "linear cannot be"),
    "infinite phase": (value("model", "basis", "scale")(float("inf")), "scale cannot be"),
    "a phase of nan": (value("model", "basis", "offset")(float("nan")), "offset cannot be"),
    "unknown parameter": (value("model", "basis", "colour")(1), "do not fit"),
    "polynomial of degree 99": (value("model", "basis")({"name": "polynomial", "degree": 99}), "from 0 to 32, not 99"),
    "no times": (value("model", "rotation_basis", "times")([]), "keyframe times"),
    "times that fall": (value("model", "rotation_basis", "times")([0.0, 1.0, 0.5, 2.0]), "keyframe times"),
    "times of nan": (value("model", "rotation_basis", "times")([0.0, float("nan"), 0.5, 2.0]), "times cannot be"),
    "times too close": (value("model", "rotation_basis", "times")([0.0, 1e-300, 0.5, 2.0]), "increase by at least"),
    "times that are no list": (value("model", "rotation_basis", "times")(1e9), "times cannot be"),
    "too many times": (value("model", "rotation_basis", "times")(list(range(200_000))), "times cannot be"),
    "unknown temporal": (value("model", "temporal")("sometimes"), "temporal opacity 'sometimes' is unknown"),
    "temporal of numbers": (value("model", "temporal")(3), "temporal opacity cannot be 3"),
    "unknown appearance": (value("model", "appearance", "name")("glow"), "appearance 'glow' is unknown"),
    "unknown activation": (value("model", "appearance", "activation")("relu"), "activation"),
    "sh of degree 9": (value("model", "appearance")({"name": "sh", "degree": 9}), "degree 0 to 4"),
    "sh of degree true": (value("model", "appearance")({"name": "sh", "degree": True}), "appearance sh's degree"),
    "another appearance": (value("model", "appearance")({"name": "sh", "degree": 4}), "'features'.*float32.*shape"),
    "negative blur": (value("model", "raster", "blur")(-1), "out of range"),
    "blur of nan": (value("model", "raster", "blur")(float("nan")), "blur cannot be"),
    "antialiased 7": (value("model", "raster", "antialiased")(7), "antialiased cannot be"),
    "no frames": (value("model", "clip", "frame_count")(0), "at least one frame"),
    "half a frame": (value("model", "clip", "frame_count")(0.5), "frame_count cannot be"),
    "fps 0": (value("model", "clip", "fps")(0), "frame rate"),
    "unknown axes": (value("model", "axes")("XYZ"), "axes"),
    "unknown colour space": (value("model", "colour_space")(["srgb"]), "colour space"),
    "provenance of numbers": (value("model", "provenance")({"a": 1}), "provenance"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_descriptions(rich, tmp_path, case):
    change, text = BAD[case]
    fg.save(rich, tmp_path / "m.safetensors")
    rewrite(tmp_path / "m.safetensors", change)
    with pytest.raises(fg.FastGSError, match=text) as error:
        fg.load(tmp_path / "m.safetensors")
    assert "m.safetensors" in str(error.value)
    assert len(str(error.value)) < 400 + len(str(tmp_path))


@pytest.mark.parametrize("text", ["", "[]", "7", "nonsense", "[" * 100_000, '{"version": ' + "9" * 5000 + "}", '{"version": 1e999}'])
def test_bad_json(rich, tmp_path, text):
    fg.save(rich, tmp_path / "m.safetensors")
    rewrite(tmp_path / "m.safetensors", metadata={"fast-gs": text})
    with pytest.raises(fg.FastGSError):
        fg.load(tmp_path / "m.safetensors")


@pytest.mark.parametrize(("arrays", "text"), [
    ({"position": None}, "'position'.*missing"),
    ({"position": np.zeros((40, 3))}, "'position'.*float32.*F64"),
    ({"position": np.zeros((), np.float32)}, "'position'"),
    ({"position": np.zeros((39, 3), np.float32)}, "'rotation'"),
    ({"opacity": np.zeros((40, 1), np.float32)}, "'opacity'"),
    ({"motion": np.zeros((40, 3, 5), np.float32)}, "'motion'"),
    ({"mu_tau": None}, "'mu_tau'.*missing"),
    ({"decoder.w1": None}, "'decoder.w1'.*missing"),
    ({"decoder.w2": np.full((3, 6), np.nan, np.float32)}, "decoder.*w2.*finite"),
])
def test_bad_arrays(rich, tmp_path, arrays, text):
    fg.save(rich, tmp_path / "m.safetensors")
    rewrite(tmp_path / "m.safetensors", arrays=arrays)
    with pytest.raises(fg.FastGSError, match=text):
        fg.load(tmp_path / "m.safetensors")


@pytest.mark.parametrize("twice", ['"position":{"dtype":"F32","shape":[40,3],"data_offsets":[1000000,1000480]}', '"__metadata__":null',
                                   '"position":{"dtype":"F32","shape":[40,3],"data_offsets":[-480,0]}', '"position":null', '"x":[]'])
def test_headers_that_say_a_thing_twice_or_nothing(rich, tmp_path, twice):
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    for text in (data[8:8 + size].rstrip()[:-1] + b"," + twice.encode() + b"}", b"{" + twice.encode() + b"," + data[9:8 + size]):
        path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + size:])
        try:
            same(rich, fg.load(path))
        except fg.FastGSError:
            continue


def test_no_metadata_at_all(tmp_path):
    text = b'{"__metadata__":null}   '
    (tmp_path / "m.safetensors").write_bytes(len(text).to_bytes(8, "little") + text)
    with pytest.raises(fg.FastGSError, match="FAST-GS model"):
        fg.load(tmp_path / "m.safetensors")


def test_other_safetensors(tmp_path):
    save_file({"weight": np.zeros(3, np.float32)}, tmp_path / "m.safetensors", {"format": "pt"})
    with pytest.raises(fg.FastGSError, match="FAST-GS model"):
        fg.load(tmp_path / "m.safetensors")


def test_cut_short_anywhere_and_too_long(rich, tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    data = path.read_bytes()
    for length in [*range(0, 2000, 97), *range(2000, len(data), 1009), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(fg.FastGSError, match="cut short" if length else "empty"):
            fg.load(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(fg.FastGSError, match="damaged"):
        fg.load(path)


def test_claims_larger_than_the_file_allocate_nothing(rich, tmp_path):
    path = tmp_path / "m.safetensors"
    fg.save(rich, path)
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8:8 + size])
    header["position"] = {"dtype": "F32", "shape": [10**15, 3], "data_offsets": [0, 12 * 10**15]}
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + size:])
    tracemalloc.start()
    with pytest.raises(fg.FastGSError):
        fg.load(path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
