# SPDX-License-Identifier: GPL-3.0-or-later
"""`.gsd`, and the blocks of LZ4 that it is made of.

DazaiStudio/4dgs-converter@0230c3a, app/pipeline/ply_to_raw.py, lines 98-137: quaternions are normalised, scales and opacities activated.
"""
from __future__ import annotations

import json
import struct

import mutations
import numpy as np
import pytest
from test_formats_sequences import COUNT, all_frames, frame

import fastgs_blender as fg
from fastgs_blender.formats.packing import unlz4


def lz4(data: bytes) -> bytes:
    """An LZ4 block: of literals, but for one repetition that overlaps itself."""
    def length(n):
        return (n << 4, b"") if n < 15 else (0xF0, bytes([255] * ((n - 15) // 255) + [(n - 15) % 255]))

    head, rest = data[:20], data[20:]
    again = next((k for k in range(len(rest), 3, -1) if rest[:k] == (head[-4:] * (k // 4 + 1))[:k]), 0)
    token, more = length(20)
    block = bytes([token | min(again - 4, 15) if again else token]) + more + head
    if again:
        block += b"\4\0" + (bytes([255] * ((again - 19) // 255) + [(again - 19) % 255]) if again >= 19 else b"")
        rest = rest[again:]
    else:
        block, rest = b"", data
    token, more = length(len(rest))
    return block + bytes([token]) + more + rest


def gsd(models: list[fg.GaussianModel], kinds=(0, 1, 1, 1)) -> bytes:
    """A .gsd file as the module's docstring has it."""
    blocks, infos = [], []
    for model in models:
        s = fg.slice_model(model, 0, cull=False)
        side = int(np.ceil(np.sqrt(len(model))))
        x, y, z = s.position.T
        w, i, j, k = s.rotation.T
        tables = [np.stack([z, x, -y, 0 * x], -1), np.stack([k, i, -j, w], -1), np.c_[s.scale[:, [2, 0, 1]], s.opacity]]
        colour = np.zeros((len(model), -(-s.features.shape[1] // 4) * 4))
        colour[:, :s.features.shape[1]] = s.features
        tables += list(colour.reshape(len(model), -1, 4).transpose(1, 0, 2))
        data = b""
        for table, kind in zip(tables, [*kinds[:3], *[kinds[3]] * (len(tables) - 3)]):
            pixels = np.zeros((side * side, 4))
            pixels[:len(table)] = table
            raw = pixels.astype("<f2" if kind else "<f4").view("u1")
            data += raw.reshape(side * side, -1).T.tobytes()
        blocks.append(lz4(data))
        infos.append({"compressedSize": len(blocks[-1]), "gaussianCount": len(model), "textureWidth": side, "textureHeight": side})
    names = ("positionPrecision", "rotationPrecision", "scaleOpacityPrecision", "shPrecision")
    degree = models[0].appearance.degree
    header = json.dumps({"version": 1, "frameCount": len(models), "targetFPS": 25.0, "shDegree": degree, "frames": infos,
                         **dict(zip(names, kinds))}).encode()
    return b"GSD1" + struct.pack("<I", len(header)) + header + b"".join(struct.pack("<I", len(b)) + b for b in blocks)


def test_gsd(tmp_path):
    models = [frame(i).take(np.arange(COUNT - 3 * i)) for i in range(3)]
    for kinds, tolerance in (((0, 0, 0, 0), 1e-5), ((0, 1, 1, 1), 4e-3)):
        (tmp_path / "m.gsd").write_bytes(gsd(models, kinds))
        source = fg.open_source(tmp_path / "m.gsd")
        assert source.clip == fg.Clip(3, 25.0)
        for i, model in enumerate(models):
            a, b = fg.slice_model(source.moment(i / 3)[0], 0, cull=False), fg.slice_model(model, 0, cull=False)
            np.testing.assert_array_equal(a.position.astype(np.float32), b.position.astype(np.float32))
            np.testing.assert_allclose(np.abs(np.sum(a.rotation * b.rotation, 1)), 1, atol=tolerance)
            for name in ("scale", "opacity", "features"):
                np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=tolerance, atol=tolerance)


def test_lz4_blocks():
    for data in (b"", b"abc", bytes(range(256)) * 5, b"0123456789abcdefwxyz" + b"wxyz" * 300 + b"tail"):
        block = lz4(data) if len(data) > 20 else bytes([len(data) << 4]) + data
        assert unlz4(block, len(data)).tobytes() == data
    packed = lz4(b"0123456789abcdefwxyz" + b"wxyz" * 300 + b"tail")
    assert len(packed) < 50
    for wrong, size in ((packed, 1223), (packed[:-1], 1224), (packed, 10**12), (b"\x10a\0\0", 100), (b"\x10a\5\0", 100), (b"\xf0", 20)):
        with pytest.raises(fg.FastGSError, match="damaged"):
            unlz4(wrong, size)


def test_mutated_gsd(tmp_path):
    unlz4(b"\0", 0)  # compiled before the limits of the campaign
    models = [frame(i).take(np.arange(5)) for i in range(2)]
    told = mutations.campaign("gsd", lambda folder: all_frames(folder / "m.gsd"), {"two frames": {"m.gsd": gsd(models)}}, tmp_path)
    assert min(told.values(), default=1) > 0
