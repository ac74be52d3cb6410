# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed PLY of PlayCanvas, against its formulas transcribed in float64."""
from __future__ import annotations

import numpy as np
import ply_files
import pytest

import fastgs_blender as fg
from fastgs_blender.formats import identify
from fastgs_blender.util.curve import hilbert_order

pytestmark = pytest.mark.filterwarnings("error")
C0 = 0.28209479177387814


def chunk_table(rng, count: int, colours: bool) -> dict[str, np.ndarray]:
    """Random bounds, the least below the greatest."""
    table = {}
    for prefix, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))[:3 if colours else 2]:
        low, size = rng.normal(-2, 1, (3, count)), rng.uniform(0.1, 3, (3, count))
        table |= {f"min_{prefix}{a}": v.astype(np.float32) for a, v in zip(axes, low, strict=True)}
        table |= {f"max_{prefix}{a}": v.astype(np.float32) for a, v in zip(axes, low + size, strict=True)}
    return table


def vertex_table(rng, n: int) -> dict[str, np.ndarray]:
    """Random codes; of the rotation, components that a unit quaternion can have beside a larger one."""
    table = {f"packed_{name}": rng.integers(0, 2**32, n, dtype=np.uint32) for name in ("position", "rotation", "scale", "color")}
    q = rng.normal(size=(n, 4))
    q = np.sort(np.abs(q / np.linalg.norm(q, axis=1, keepdims=True)), 1)[:, :3] * rng.choice([-1, 1], (n, 3))
    parts = np.rint((q * np.sqrt(0.5) + 0.5) * 1023).astype(np.uint32)
    table["packed_rotation"] = rng.integers(0, 4, n, dtype=np.uint32) << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]
    return table


def file(chunk, vertex, rest=None, kind="binary_little_endian", comments=()) -> bytes:
    """A PLY of these tables, in the order that PlayCanvas writes."""
    order = ply_files.FORMATS[kind]
    before = [ply_files.element("chunk", chunk, order, {})]
    after = [ply_files.element("sh", rest, order, dict.fromkeys(rest, "uchar"))] if rest else []
    return ply_files.ply(vertex, kind, comments, dict.fromkeys(vertex, "uint"), before, after)


def expected(chunk, vertex, rest) -> dict[str, np.ndarray]:
    """The engine's decoder, one Gaussian at a time."""
    n = len(vertex["packed_position"])
    out = {"position": np.zeros((n, 3)), "scale": np.zeros((n, 3)), "rotation": np.zeros((n, 4)), "opacity": np.zeros(n),
           "dc": np.zeros((n, 3)), "rest": np.zeros((n, len(rest or {})))}
    for i in range(n):
        c = i // 256
        p, r, s, k = (int(vertex[f"packed_{name}"][i]) for name in ("position", "rotation", "scale", "color"))

        def lerp(low, high, t, c=c):
            return float(chunk[low][c]) * (1 - t) + float(chunk[high][c]) * t

        for axis, name in enumerate("xyz"):
            shift, bits = ((21, 11), (11, 10), (0, 11))[axis]
            out["position"][i, axis] = lerp(f"min_{name}", f"max_{name}", (p >> shift) % 2**bits / (2**bits - 1))
            out["scale"][i, axis] = np.exp(lerp(f"min_scale_{name}", f"max_scale_{name}", (s >> shift) % 2**bits / (2**bits - 1)))
        others = [((r >> shift) % 1024 / 1023 - 0.5) * np.sqrt(2) for shift in (20, 10, 0)]
        others.insert(r >> 30, np.sqrt(max(0, 1 - sum(v * v for v in others))))
        out["rotation"][i] = others
        for channel, name in enumerate("rgb"):
            level = (k >> (24, 16, 8)[channel]) % 256 / 255
            out["dc"][i, channel] = ((lerp(f"min_{name}", f"max_{name}", level) if "min_r" in chunk else level) - 0.5) / C0
        out["opacity"][i] = k % 256 / 255
        for j, name in enumerate(rest or {}):
            b = int(rest[name][i])
            out["rest"][i, j] = ((0 if b == 0 else 1 if b == 255 else (b + 0.5) / 256) - 0.5) * 8
    return out


@pytest.mark.parametrize("kind", ["binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_as_its_formulas_say(rng, tmp_path, kind, colours, degree):
    chunk, vertex = chunk_table(rng, 2, colours), vertex_table(rng, 300)
    columns = 3 * ((degree + 1) ** 2 - 1)
    rest = {f"f_rest_{i}": rng.integers(0, 256, 300).astype(np.uint8) for i in range(columns)}
    path = tmp_path / "m.bin"
    path.write_bytes(file(chunk, vertex, rest, kind, ["SplatRenderMode: mip"]))
    assert identify(path).name == "compressed PLY"
    model, want = fg.load(path), expected(chunk, vertex, rest)
    s = fg.slice_model(model, 0, cull=False)
    for name in ("position", "scale", "opacity"):
        np.testing.assert_allclose(getattr(s, name), want[name], rtol=1e-5, atol=2e-6)
    np.testing.assert_allclose(np.abs((s.rotation * want["rotation"]).sum(1)), 1, atol=2e-6)
    np.testing.assert_allclose(s.features[:, :3], want["dc"], atol=1e-5)
    per_channel = want["rest"].reshape(300, 3, columns // 3)  # f_rest_* goes channel by channel
    np.testing.assert_allclose(s.features[:, 3:].reshape(300, columns // 3, 3), per_channel.transpose(0, 2, 1), atol=1e-6)
    assert model.raster == fg.Raster(antialiased=True)


@pytest.mark.parametrize("n", [0, 1, 256, 700])
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_round_trip(rng, make_model, tmp_path, n, degree):
    model = make_model(rng, n, appearance=f"sh{degree}", raster=fg.Raster(antialiased=True))
    path = tmp_path / "m.compressed.ply"
    with pytest.warns(fg.LossWarning, match="11, 10 and 11 bits") as said:
        fg.save(model, path)
    assert len(said) == 1
    back = fg.load(path)
    assert (len(back), back.raster) == (n, model.raster)
    if not n:
        return
    a, b = fg.slice_model(model, 0, cull=False), fg.slice_model(back, 0, cull=False)
    twin = np.linalg.norm(a.position[:, None] - b.position[None], axis=2).argmin(0) if n < 300 else hilbert_order(model.position)
    extent = np.ptp(a.position, axis=0) / 1023 / 2 + 1e-6
    assert (np.abs(a.position[twin] - b.position) <= extent).all()
    spread = np.ptp(model.scale, axis=0) / 1023 / 2 + 1e-5
    assert (np.abs(np.log(a.scale[twin]) - np.log(b.scale)) <= spread).all()
    np.testing.assert_allclose(b.opacity, a.opacity[twin], atol=0.5 / 255 + 1e-6)
    colour = np.ptp(model.features[:, :3], axis=0) / 255 / 2 + 1e-5
    assert (np.abs(a.features[twin, :3] - b.features[:, :3]) <= colour).all()
    np.testing.assert_allclose(b.features[:, 3:], a.features[twin, 3:], atol=1 / 64 + 1e-6)
    assert np.abs((a.rotation[twin] * b.rotation).sum(1)).min() > 1 - 3e-6


def test_an_ordinary_ply_is_written_under_other_names(rng, make_model, tmp_path):
    fg.save(make_model(rng, 5, appearance="sh1"), tmp_path / "compressed.ply")
    assert identify(tmp_path / "compressed.ply").name == "INRIA PLY"


def test_broken_files(rng, tmp_path):
    def refused(data, match):
        (tmp_path / "m.ply").write_bytes(data)
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(tmp_path / "m.ply")

    chunk, vertex = chunk_table(rng, 2, True), vertex_table(rng, 300)
    rest = {f"f_rest_{i}": np.zeros(300, np.uint8) for i in range(9)}
    refused(file(chunk, vertex, rest)[:-1], "header.* 300")
    refused(file(chunk, vertex, dict(list(rest.items())[:8])), "degree")
    refused(file(chunk_table(rng, 3, True), vertex), "3 chunks")
    refused(file({k: v for k, v in chunk.items() if k != "max_z"}, vertex), "columns max_z")
    refused(file({k: v for k, v in chunk.items() if k != "max_r"}, vertex), "not all bounds")
    refused(file(chunk, vertex, kind="ascii"), "in text")
    refused(file(chunk, vertex, comments=["SplatRenderMode: 2dgs"]), "2DGS")
    refused(file(chunk, {k: v for k, v in vertex.items() if k != "packed_scale"}), "columns packed_scale")


def test_what_is_cut_is_said(rng, make_model, tmp_path):
    model = make_model(rng, 9, appearance="sh1", scale=np.full((9, 3), -25.0), features=np.full((9, 12), 5.0))
    with pytest.warns(fg.LossWarning, match="below 2e-09.*beyond -4..4"):
        fg.save(model, tmp_path / "m.compressed.ply")
    np.testing.assert_allclose(fg.load(tmp_path / "m.compressed.ply").scale, -20)
