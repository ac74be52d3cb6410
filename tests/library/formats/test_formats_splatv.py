# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splatv`: Spacetime Gaussians lite in a texture.

Transcribed from antimatter15/splaTV@8b313fe, hybrid.js: the texture, lines 196-240, and the shader, 290-326.
"""
from __future__ import annotations

import json
import struct
import tracemalloc
import warnings

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error")


def record(position=(1, 2, 3), rotation=(1, 0, 0, 0), scale=(0.1, 0.2, 0.3), colour=(255, 128, 0, 200), motion=range(9), omega=(0, 0, 0, 0),
           centre=0.5, width=0.25) -> bytes:
    """One Gaussian by the format's description."""
    return struct.pack("<3f", *position) + struct.pack("<8e", *rotation, *scale, 0) + bytes(colour) + struct.pack("<10e", *motion, 0) \
        + struct.pack("<4e", *omega) + struct.pack("<2e", centre, width)


def file(data: bytes, before=b"", chunk=None, **extra) -> bytes:
    """A file of these records; before: the bytes of a chunk of another type."""
    chunks = [{"type": "other", "size": len(before)}] if before else []
    chunks += [chunk or {"type": "splat", "size": len(data), "texwidth": 4096, "texheight": 1, "cameras": [], **extra}]
    text = json.dumps(chunks).encode()
    return struct.pack("<II", 0x674B, len(text)) + text + before + data


@pytest.fixture
def load_bytes(tmp_path):
    """load() of a file with this content."""
    def load(data: bytes):
        (tmp_path / "m.bin").write_bytes(data)
        return fg.load(tmp_path / "m.bin")
    return load


def test_one_record_field_by_field(load_bytes):
    model = load_bytes(file(bytes(64) + record(rotation=(0.5, -1, 2, 0.25), omega=(1, 2, 3, 4)) + bytes(640), before=b"12345678"))
    assert len(model) == 1
    dt = 0.7 - 0.5
    s = fg.slice_model(model, 0.7)
    np.testing.assert_allclose(s.position[0], [1 + 0 * dt + 3 * dt**2 + 6 * dt**3, 2 + dt + 4 * dt**2 + 7 * dt**3,
                                               3 + 2 * dt + 5 * dt**2 + 8 * dt**3], rtol=1e-6)
    q = np.array([0.5 + dt, -1 + 2 * dt, 2 + 3 * dt, 0.25 + 4 * dt])
    np.testing.assert_allclose(s.rotation[0], q / np.linalg.norm(q), rtol=1e-5)
    np.testing.assert_allclose(s.scale[0], [0.1, 0.2, 0.3], rtol=1e-3)
    np.testing.assert_allclose(s.opacity[0], 200 / 255 * np.exp(-((dt / 0.25) ** 2)), rtol=1e-6)
    np.testing.assert_allclose(s.features[0], [1, 128 / 255, 0], rtol=1e-6)
    assert (model.raster, model.appearance, model.clip.frame_count) == (fg.Raster(), fg.RGB(), 50)


def test_extremes_stay_finite(load_bytes):
    data = record(colour=(0, 0, 0, 0), width=0) + record(colour=(9, 9, 9, 255), width=np.inf) + record(scale=(0, 1, 65504), width=-0.25)
    model = load_bytes(file(data))
    assert len(model) == 3
    for t in (0.0, 0.5, 1.0):
        s = fg.slice_model(model, t, cull=False)
        assert np.isfinite(s.opacity).all()
        assert s.opacity[0] < 1e-5
        assert s.opacity[1] > 0.999
    np.testing.assert_allclose(fg.slice_model(model, 0.75, cull=False).opacity[2], 200 / 255 * np.exp(-1), rtol=1e-5)


@pytest.mark.parametrize("bad", [{"position": (np.nan, 0, 0)}, {"scale": (-1, 1, 1)}, {"motion": [np.inf] * 9}, {"rotation": [np.nan] * 4}])
def test_unusable_gaussians_are_left_out_and_said(load_bytes, bad):
    with pytest.warns(fg.LossWarning, match="1 of 3"):
        assert len(load_bytes(file(record() + record(**bad) + record()))) == 2
    with pytest.raises(fg.FastGSError, match="none.* 2"):
        load_bytes(file(record(**bad) * 2))


def drawn(model) -> np.ndarray:
    ahead = np.eye(4)
    ahead[2, 3] = 4
    return fg.render(model, fg.Camera(48, 32, 60, 60, 24, 16, ahead), 0.7, backend="cpu")["rgb"]


def test_quaternions_of_zeros_do_not_turn(load_bytes):
    """As their trainer draws them, which makes them so (oppo-us-research/SpacetimeGaussians@427abfc, scene/ourslite.py, 1235, of Gaussians
    that guided sampling adds): torch.nn.functional.normalize leaves zeros, of which computeCov3D of its rasteriser makes the identity.
    splaTV's shader divides by their length, and its viewer shows none of them."""
    still = dict(position=(0, 0, 0), scale=(0.5, 0.2, 0.1), motion=[0.0] * 9)
    zero, whole = load_bytes(file(record(rotation=(0, 0, 0, 0), **still))), load_bytes(file(record(rotation=(1, 0, 0, 0), **still)))
    assert len(zero) == 1
    for t in (0.0, 0.5, 0.9):
        np.testing.assert_array_equal(fg.slice_model(zero, t, cull=False).rotation, [[1, 0, 0, 0]])
    np.testing.assert_array_equal(drawn(zero), drawn(whole))
    assert drawn(zero).max() > 0.1
    turning = load_bytes(file(record(rotation=(0, 0, 0, 0), omega=(0, 0, 3, 4), **still)))
    np.testing.assert_allclose(fg.slice_model(turning, 0.7, cull=False).rotation, [[0, 0, 0.6, 0.8]], atol=1e-6)


def test_round_trip(rng, make_model, tmp_path):
    model = make_model(rng, 1500, basis="cubic", rotation_basis="line", temporal="radial", axes="RFU", clip=fg.Clip(81, 24.0, 3),
                       raster=fg.Raster(0.1, 0.999, 1 / 300, 0.01, True), provenance={"a": "b"})
    with pytest.warns(fg.LossWarning, match="half precision") as said:
        fg.save(model, tmp_path / "m.splatv")
    assert len(said) == 1
    back = fg.load(tmp_path / "m.splatv")
    assert identify(tmp_path / "m.splatv").name == "splaTV"
    for name in ("basis", "rotation_basis", "temporal_kind", "appearance", "axes", "clip", "raster", "provenance"):
        assert getattr(back, name) == getattr(model, name)
    importance = np.exp(model.scale.sum(1)) / (1 + np.exp(-model.opacity))
    model = model.take(np.argsort(-importance, kind="stable"))
    np.testing.assert_array_equal(back.position, model.position)
    for name in ("rotation", "motion", "rotation_motion", "mu_tau"):
        np.testing.assert_allclose(back.arrays[name], model.arrays[name], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(back.scale, model.scale, atol=1e-3)
    np.testing.assert_allclose(back.temporal, model.temporal, atol=3e-3)
    np.testing.assert_allclose(back.features, model.features, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-back.opacity)), 1 / (1 + np.exp(-model.opacity)), atol=0.5 / 255 + 1e-5)


def test_what_was_rounded_once_is_not_lost_again(rng, make_model, tmp_path):
    with pytest.warns(fg.LossWarning):
        fg.save(make_model(rng, basis="line", temporal="radial"), tmp_path / "a.splatv")
    fg.save(fg.load(tmp_path / "a.splatv"), tmp_path / "b.splatv")
    first, second = (np.frombuffer((tmp_path / name).read_bytes()[-65536:], "V64") for name in ("a.splatv", "b.splatv"))
    assert sorted(first.tolist()) == sorted(second.tolist())  # the order may differ: rounding opacities makes ties


def test_the_texture_is_whole_rows_and_the_first_gaussian_the_most_important(rng, make_model, tmp_path):
    with pytest.warns(fg.LossWarning):
        fg.save(make_model(rng, 1025), tmp_path / "m.splatv")
    data = (tmp_path / "m.splatv").read_bytes()
    size = struct.unpack("<II", data[:8])[1]
    chunk = json.loads(data[8:8 + size])[0]
    assert (chunk["type"], chunk["texwidth"], chunk["texheight"], chunk["size"]) == ("splat", 4096, 2, 2 * 4096 * 16)
    assert len(data) == 8 + size + chunk["size"]
    assert not any(data[8 + size + 1025 * 64:])
    camera = chunk["cameras"][0]
    assert np.shape(camera["rotation"]) == (3, 3)
    assert camera["position"][2] < -1


@pytest.mark.parametrize(("fields", "text"), [
    ({"basis": "paper"}, "cubic.*RMS error"), ({"rotation_basis": "keys"}, "linear in time.*degrees"), ({"temporal": "window"}, "bell"),
    ({"temporal": "radial-window"}, "bell"),
    ({"appearance": "sh2"}, "SH degree 2"), ({"appearance": "clamp"}, "features.*decoder"),
    ({"motion": 1e6, "basis": "cubic"}, "65504")])
def test_losses_are_said_in_one_warning(rng, make_model, tmp_path, fields, text):
    with pytest.warns(fg.LossWarning, match=text) as said:
        fg.save(make_model(rng, **fields), tmp_path / "m.splatv")
    assert len(said) == 1
    assert len(fg.load(tmp_path / "m.splatv")) == 40


def test_features_become_the_colour_at_their_moment_without_a_view(rng, make_model, tmp_path):
    model = make_model(rng, appearance="sigmoid", basis="cubic")
    model.appearance.w1[:, 6:] = 0  # a decoder that does not look at the ray
    with pytest.warns(fg.LossWarning):
        fg.save(model, tmp_path / "m.splatv")
    back = fg.load(tmp_path / "m.splatv")
    at = [int(np.argmin(np.linalg.norm(model.position - p, axis=1))) for p in back.position]
    from fastgs_blender.model.appearance import decode
    f = model.features[at].astype(np.float64)
    f[:, 6:] = 0
    np.testing.assert_allclose(back.features, decode(f, np.zeros(3), np.zeros((40, 3)), model.appearance), atol=0.5 / 255 + 1e-6)


def unpadded(count: int, missing: int, **about) -> bytes:
    """As splaTV's own converter writes: the size of whole rows of the texture, and `missing` records fewer."""
    chunk = {"type": "splat", "size": 64 * (count + missing), "texwidth": 4096, "texheight": (count + missing) // 1024, **about}
    return file(b"".join(record() for _ in range(count)), chunk=chunk)


def test_files_without_the_padding_of_the_last_row_are_whole(load_bytes):
    assert len(load_bytes(unpadded(1100, 948))) == 1100
    for wrong in (unpadded(1100, 948)[:-1], unpadded(1000, 1048), unpadded(1100, 948, fastgs={"axes": "RDF"})):
        with pytest.raises(fg.FastGSError, match="cut short"):
            load_bytes(wrong)


def test_files_with_padding_that_the_header_leaves_out_are_whole(load_bytes):
    """A header may state the records alone, and the body fill the texture's last row with zeros."""
    whole = file(b"".join(record() for _ in range(1100)))
    assert len(load_bytes(whole + bytes(64 * 948))) == 1100
    for wrong in (bytes(64 * 1024), bytes(64 * 10) + b"x"):
        with pytest.raises(fg.FastGSError, match="more.*header"):
            load_bytes(whole + wrong)


def test_files_of_splatvs_own_converter(shared_data):
    files = sorted((shared_data / "splatv").glob("*.splatv"))
    if not files:
        pytest.skip("no files of splaTV's converter are here")
    for path in files:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            model = fg.load(path)
        zeros = ~model.rotation.any(1)
        assert zeros.mean() == pytest.approx({"coffeeshort2": 0.926, "spinach_4": 0, "yellow_clip2": 0.205}[path.stem], abs=1e-3)
        assert not model.rotation_motion[zeros].any()
        assert len(model) > 1000 and np.isfinite(fg.slice_model(model, 0.5).position).all()
        assert all("position are" in str(w.message) for w in said), "some of its Gaussians lie nowhere; nothing else is lost"


BAD = {
    "cut short": file(record() * 4)[:-1],
    "too long": file(record() * 4) + b"x",
    "no texels": file(b"", chunk={"type": "splat", "size": 64 * 10**12}),
    "half a record": file(bytes(32)),
    "no size": file(b"", chunk={"type": "splat"}),
    "negative size": file(b"", chunk={"type": "splat", "size": -64}),
    "a size of nan": file(b"", chunk={"type": "splat", "size": float("nan")}),
    "an infinite size": file(b"", chunk={"type": "splat", "size": float("inf")}),
    "a size in words": file(b"", chunk={"type": "splat", "size": "64"}),
    "no chunk": file(b"", chunk={"type": "sound", "size": 0}),
    "another chunk that never ends": file(record(), chunk={"type": "sound", "size": 10**15}),
    "our key broken": file(record(), fastgs={"clip": {"fps": "fast"}}),
    "our key a list": file(record(), fastgs=[1]),
    "the magic alone": struct.pack("<I", 0x674B),
    "no json": struct.pack("<II", 0x674B, 0),
    "a header of 4 GB": struct.pack("<II", 0x674B, 0xFFFFFFFF) + b"[]",
    "deep json": struct.pack("<II", 0x674B, 100_000) + b"[" * 100_000,
    "json that is a number": struct.pack("<II", 0x674B, 2) + b"17",
    "json that is no text": struct.pack("<II", 0x674B, 4) + b"\xff\xfe\xfd\xfc",
    "chunks that are numbers": struct.pack("<II", 0x674B, 7) + b"[1,2,3]",
}


@pytest.mark.parametrize("case", BAD)
def test_broken_files(load_bytes, case):
    tracemalloc.start()
    try:
        with pytest.raises(fg.FastGSError):
            load_bytes(BAD[case])
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()
