# SPDX-License-Identifier: GPL-3.0-or-later
"""SPZ of Niantic, versions 1 to 4, against the format's formulas transcribed in float64."""
from __future__ import annotations

import gzip
import struct
import sys
import tracemalloc

import numpy as np
import pytest
import zstandard

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error")
FLIPS = {1: [-1, -1, 1], 2: [-1, 1, 1, -1, 1], 3: [-1, 1, -1, -1, 1, -1, 1], 4: [-1, 1, -1, 1, 1, -1, 1, -1, -1]}
"""Signs of the harmonics from RUB to RDF as Niantic's coordinateConverter() has them (splat-types.h, flipSh, with y = z = -1).

They change where a function of the direction is odd in exactly one of y and z; the last one of degree 4, which is even in both, changes
there too.
"""


def packed(rng, version: int, count: int, degree: int) -> dict[str, np.ndarray]:
    """Random contents of the arrays, as bytes."""
    position = rng.normal(size=3 * count).astype("<f2").view(np.uint8) if version == 1 else rng.integers(0, 256, 9 * count)
    names = {"alpha": 1, "colour": 3, "scale": 3, "rotation": 4 if version > 2 else 3, "sh": 3 * ((degree + 1) ** 2 - 1)}
    arrays = {"position": position, **{name: rng.integers(0, 256, width * count) for name, width in names.items()}}
    if version > 2:  # three components of a unit quaternion, each below the one that is left out
        q = np.sort(np.abs(rng.normal(size=(count, 4))), 1)
        rest = (q / np.linalg.norm(q, axis=1, keepdims=True))[:, :3] / np.sqrt(0.5) * 511
        code = rng.integers(0, 4, count) << 30
        for i in range(3):
            code |= (rest[:, i].astype(int) | rng.integers(0, 2, count) << 9) << 10 * i
        arrays["rotation"] = code.astype("<u4").view(np.uint8)
    return {name: np.asarray(array, np.uint8) for name, array in arrays.items()}


def file(version: int, count: int, degree: int, arrays, fraction=12, flags=0, extensions=b"") -> bytes:
    """A file by the format's description."""
    header = struct.pack("<4sIIBBB", b"NGSP", version, count, degree, fraction, flags)
    parts = [array.tobytes() for array in arrays.values()]
    if version < 4:
        return gzip.compress(header + b"\0" + b"".join(parts) + extensions)
    streams = [(zstandard.compress(part), len(part)) for part in parts if part]
    table = b"".join(struct.pack("<QQ", len(stream), size) for stream, size in streams)
    head = header + struct.pack("<BI", len(streams), 32 + len(extensions)) + bytes(12)
    return head + extensions + table + b"".join(stream for stream, _ in streams)


def expected(version: int, count: int, degree: int, arrays, fraction=12) -> dict[str, np.ndarray]:
    """The README's formulas, one Gaussian and one number at a time."""
    out = {"position": np.zeros((count, 3)), "rotation": np.zeros((count, 4)), "scale": np.zeros((count, 3)),
           "opacity": arrays["alpha"] / 255, "dc": (arrays["colour"].reshape(count, 3) / 255 - 0.5) / 0.15}
    for i in range(count):
        for axis in range(3):
            if version == 1:
                value = float(arrays["position"].view("<f2")[3 * i + axis])
            else:
                low, middle, high = (int(b) for b in arrays["position"][9 * i + 3 * axis:][:3])
                whole = low + 256 * middle + 65536 * high
                value = (whole - 2**24 if whole >= 2**23 else whole) / 2**fraction
            out["position"][i, axis] = value * (1, -1, -1)[axis]
            out["scale"][i, axis] = np.exp(arrays["scale"][3 * i + axis] / 16 - 10)
        q = np.zeros(4)  # x y z w
        if version < 3:
            q[:3] = [b / 127.5 - 1 for b in arrays["rotation"][3 * i:][:3]]
            q[3] = np.sqrt(max(0, 1 - (q[:3] ** 2).sum()))
        else:
            code = int.from_bytes(arrays["rotation"][4 * i:][:4].tobytes(), "little")
            largest = code >> 30
            for k in (3, 2, 1, 0):
                if k != largest:
                    q[k] = (code & 511) / 511 * np.sqrt(0.5) * (-1 if code & 512 else 1)
                    code >>= 10
            q[largest] = np.sqrt(1 - (q**2).sum())
        q = np.array([q[3], q[0], -q[1], -q[2]])
        out["rotation"][i] = q / np.linalg.norm(q)
    bands = [sign for band in range(1, degree + 1) for sign in FLIPS[band]]
    out["sh"] = (arrays["sh"].reshape(count, len(bands), 3) - 128.0) / 128 * np.reshape(bands, (-1, 1))
    return out


def assert_model(model, want):
    s = fg.slice_model(model, 0, cull=False)
    n = len(model)
    np.testing.assert_allclose(s.position, want["position"], rtol=1e-6)
    np.testing.assert_allclose(s.scale, want["scale"], rtol=1e-5)
    np.testing.assert_allclose(s.opacity, want["opacity"], atol=1e-6)
    np.testing.assert_allclose(s.features[:, :3], want["dc"], atol=1e-6)
    np.testing.assert_allclose(s.features[:, 3:].reshape(n, -1, 3), want["sh"].reshape(n, -1, 3), atol=1e-6)
    np.testing.assert_allclose(np.abs((s.rotation * want["rotation"]).sum(1)), 1, atol=1e-6)
    assert model.axes == "RDF"


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_every_version_as_its_formulas_say(rng, tmp_path, version, degree):
    arrays = packed(rng, version, 23, degree)
    path = tmp_path / "m.bin"
    path.write_bytes(file(version, 23, degree, arrays, flags=1))
    assert identify(path).name == "SPZ"
    model = fg.load(path)
    assert model.raster == fg.Raster(antialiased=True)
    assert_model(model, expected(version, 23, degree, arrays))


@pytest.mark.parametrize("version", [1, 2, 3])
def test_older_versions_that_gzip_was_taken_off(rng, tmp_path, version):
    arrays = packed(rng, version, 9, 2)
    bare = gzip.decompress(file(version, 9, 2, arrays))
    (tmp_path / "m.spz").write_bytes(bare)
    assert_model(fg.load(tmp_path / "m.spz"), expected(version, 9, 2, arrays))
    (tmp_path / "m.spz").write_bytes(bare[:-1])
    with pytest.raises(fg.FastGSError, match="cut short"):
        fg.load(tmp_path / "m.spz")


@pytest.mark.parametrize("fraction", [0, 8, 20])
def test_other_fractions(rng, tmp_path, fraction):
    arrays = packed(rng, 2, 9, 0)
    (tmp_path / "m.spz").write_bytes(file(2, 9, 0, arrays, fraction))
    assert_model(fg.load(tmp_path / "m.spz"), expected(2, 9, 0, arrays, fraction))


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(("number", "matrix"), [
    (0, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]), (6, np.eye(3)), (7, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
    (8, [[1, 0, 0], [0, -1, 0], [0, 0, 1]]), (12, [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), (16, [[1, 0, 0], [0, 0, -1], [0, -1, 0]]),
])
def test_axes_that_adobes_extension_names(rng, tmp_path, version, number, matrix):
    """Mirroring ones too: what is there is turned as a whole, colours by direction with it."""
    arrays = packed(rng, version, 12, 3)
    plain = file(version, 12, 3, arrays)
    extensions = struct.pack("<II3s", 0xADBE0002, 3, b"abc") + struct.pack("<III", 0xADBE0003, 4, number)
    for name, data in (("plain", plain), ("turned", file(version, 12, 3, arrays, flags=2, extensions=extensions))):
        (tmp_path / name).write_bytes(data)
    rub, model = fg.load(tmp_path / "plain"), fg.load(tmp_path / "turned")
    turn = np.array(matrix, float) @ np.diag([1.0, -1, -1])  # from the plain file's RDF back to what is stored, and on
    np.testing.assert_allclose(model.position, rub.position @ turn.T, rtol=1e-6)
    np.testing.assert_allclose(covariances(model), turn @ covariances(rub) @ turn.T, rtol=1e-4, atol=1e-9)
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(colours(model, directions @ turn.T), colours(rub, directions), atol=1e-5)


@pytest.mark.parametrize(("number", "signs"), [(6, [1] * 9), (5, [-1, 1, -1, 1, 1, -1, 1, -1, 1]), (7, [1, -1, 1, -1, 1, -1, 1, -1, -1])])
def test_signs_of_degree_4_in_other_axes(rng, tmp_path, number, signs):
    """flipSh of Niantic's library from RDF, LDF and LUF to RDF: the last coefficient changes with y alone."""
    arrays = packed(rng, 3, 12, 4)
    extension = struct.pack("<III", 0xADBE0003, 4, number)
    (tmp_path / "m.spz").write_bytes(file(3, 12, 4, arrays, flags=2, extensions=extension))
    stored = (arrays["sh"].reshape(12, 24, 3) - 128.0) / 128
    np.testing.assert_allclose(fg.load(tmp_path / "m.spz").features[:, 48:].reshape(12, 9, 3), stored[:, 15:] * np.reshape(signs, (-1, 1)))


def covariances(model) -> np.ndarray:
    s = fg.slice_model(model, 0, cull=False)
    w, x, y, z = s.rotation.T
    r = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                  [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                  [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)
    return r @ (s.scale[:, :, None] ** 2 * r.transpose(0, 2, 1))


def colours(model, directions) -> np.ndarray:
    from fastgs_blender.model.appearance import sh_basis

    basis = sh_basis(directions, model.appearance.degree)
    return np.einsum("db,nbc->ndc", basis, model.features.reshape(len(model), -1, 3).astype(float))


@pytest.mark.parametrize("degree", [0, 1, 3, 4])
def test_round_trip(rng, make_model, tmp_path, degree):
    model = make_model(rng, 400, appearance=f"sh{degree}", raster=fg.Raster(antialiased=True), extent=7.0, opacity=rng.normal(0, 2, 400))
    path = tmp_path / "m.spz"
    with pytest.warns(fg.LossWarning, match="positions.*1/65536") as said:
        fg.save(model, path)
    assert len(said) == 1
    assert gzip.decompress(path.read_bytes())[:8] == struct.pack("<4sI", b"NGSP", 3)
    back = fg.load(path)
    a, b = fg.slice_model(model, 0, cull=False), fg.slice_model(back, 0, cull=False)
    np.testing.assert_allclose(b.position, a.position, atol=0.51 / 65536)
    np.testing.assert_allclose(np.log(b.scale), np.log(a.scale), atol=1 / 32 + 1e-5)
    np.testing.assert_allclose(b.opacity, a.opacity, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(b.features[:, :3], np.clip(a.features[:, :3], -10 / 3, 10 / 3), atol=0.5 / 255 / 0.15 + 1e-6)
    rest = np.clip(a.features[:, 3:], -1, 127 / 128)
    np.testing.assert_allclose(b.features[:, 3:12], rest[:, :9], atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(b.features[:, 12:], rest[:, 9:], atol=1 / 16 + 1e-6)
    assert np.abs((a.rotation * b.rotation).sum(1)).min() > 1 - 5e-6
    assert back.raster == model.raster


def test_what_was_read_is_written_back_to_the_bit(rng, tmp_path):
    arrays = packed(rng, 3, 50, 1)
    arrays["sh"] = arrays["sh"] // 8 * 8
    arrays["position"][2::3] = arrays["position"][2::3] // 128 * 255  # so small that its 16 bits of fractions fit
    (tmp_path / "a.spz").write_bytes(file(3, 50, 1, arrays, 16))
    first = fg.load(tmp_path / "a.spz")
    with pytest.warns(fg.LossWarning):
        fg.save(first, tmp_path / "b.spz")
    second = fg.load(tmp_path / "b.spz")
    for name in ("position", "scale", "features"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    assert np.abs(np.abs((first.rotation * second.rotation).sum(1)) - 1).max() < 1e-6
    opaque = np.abs(first.opacity) < 20
    np.testing.assert_array_equal(second.opacity[opaque], first.opacity[opaque])


def test_what_is_cut_is_said(rng, make_model, tmp_path):
    model = make_model(rng, 10, appearance="sh1", extent=2e7, features=np.full((10, 12), 5.0), scale=np.full((10, 3), 7.0))
    with pytest.warns(fg.LossWarning) as said:
        fg.save(model, tmp_path / "m.spz")
    for clause in ("positions beyond 8388607 are cut", "above 379 are cut", "colours far from 0..1", "harmonics beyond"):
        assert clause in str(said[0].message)
    assert np.abs(fg.load(tmp_path / "m.spz").position).max() <= 2**23


def test_broken_files(rng, tmp_path):
    def refused(data, match):
        (tmp_path / "m.spz").write_bytes(data)
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(tmp_path / "m.spz")

    arrays = packed(rng, 4, 100, 2)
    good = file(4, 100, 2, arrays)
    refused(good[:-5], "cut short")
    refused(good[:20], "cut short")
    refused(good[:4] + b"\5" + good[5:], "version 5")
    refused(good[:8] + b"\xff\xff\xff\xff" + good[12:], "promises 4294967295")
    refused(good[:12] + b"\7" + good[13:], "degree 7")
    refused(good[:16] + b"\xff\xff" + good[18:], "table of contents")
    refused(file(3, 100, 2, {**arrays, "sh": arrays["sh"][:9]}), "header.* 100")
    refused(gzip.compress(b"NGSP\4\0\0\0" + bytes(8)), "packed.*gzip")
    refused(gzip.compress(b"something else"), "gzip.*not .spz")
    refused(file(3, 100, 2, arrays)[:200], "cut short|unpacked")


def test_a_bomb_takes_no_memory(tmp_path):
    """A header of many Gaussians before a gigabyte of zeros, packed to little."""
    for version in (3, 4):
        data = {"a": np.zeros(20_000_000, np.uint8)}
        header = struct.pack("<4sIIBBBB", b"NGSP", version, 400_000_000, 0, 12, 0, 5)
        content = gzip.compress(header + data["a"].tobytes()) if version == 3 else (
            header[:-1] + struct.pack("<BI", 5, 32) + bytes(12) + struct.pack("<QQ", 1000, 3_600_000_000) * 5 + bytes(5000))
        (tmp_path / "m.spz").write_bytes(content)
        tracemalloc.start()
        try:
            with pytest.raises(fg.FastGSError, match="promises 400000000"):
                fg.load(tmp_path / "m.spz")
            assert tracemalloc.get_traced_memory()[1] < 4 * len(content) + (1 << 20)
        finally:
            tracemalloc.stop()


def test_version_4_without_zstandard_says_what_to_do(rng, tmp_path, monkeypatch):
    (tmp_path / "m.spz").write_bytes(file(4, 5, 0, packed(rng, 4, 5, 0)))
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(fg.FastGSError, match="pip install zstandard"):
        fg.load(tmp_path / "m.spz")
