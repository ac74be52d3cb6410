# SPDX-License-Identifier: GPL-3.0-or-later
"""`.ksplat` of GaussianSplats3D, levels 0 to 2, in files that are written here as its own code writes them."""
from __future__ import annotations

import struct

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error")
EDGE, BUCKET = 5.0, 4
C0 = 0.28209479177387814


def gaussians(rng, n: int, degree: int) -> dict[str, np.ndarray]:
    """Random Gaussians as the viewer holds them: linear scales, colours as bytes, harmonics [n, channel, coefficient]."""
    q = rng.normal(size=(n, 4))
    return {"position": rng.uniform(-8, 8, (n, 3)), "scale": rng.uniform(0.01, 2, (n, 3)), "degree": degree,
            "rotation": q / np.linalg.norm(q, axis=1, keepdims=True), "colour": rng.integers(0, 256, (n, 4)).astype(np.uint8),
            "harmonics": rng.uniform(-1.2, 1.2, (n, 3, (degree + 1) ** 2 - 1))}


def buckets_of(position) -> list[tuple[list[int], np.ndarray]]:
    """Buckets of BUCKET Gaussians in cubes of EDGE: full ones first, then the others, each with its centre."""
    least, open_, full = position.min(0), {}, []
    for i, p in enumerate(position):
        cube = np.floor((p - least) / EDGE)
        members = open_.setdefault(tuple(cube), ([], cube * EDGE + least + EDGE / 2))[0]
        members.append(i)
        if len(members) == BUCKET:
            full.append(open_.pop(tuple(cube)))
    return [*full, *open_.values()]


def file(sections, level: int, low=-1.5, high=1.5) -> tuple[bytes, list[np.ndarray]]:
    """A file of these sections, and the order in which each one's Gaussians stand in it."""
    bodies, headers, orders = [], [], []
    for g in sections:
        n = len(g["position"])
        buckets = buckets_of(g["position"]) if level else [(list(range(n)), np.zeros(3))]
        full = [b for b in buckets if len(b[0]) == BUCKET] if level else []
        partial = buckets[len(full):] if level else []
        order = np.array([i for members, _ in buckets for i in members])
        body = b"".join(struct.pack("<I", len(members)) for members, _ in partial)
        body += b"".join(struct.pack("<3f", *centre) for _, centre in buckets) if level else b""
        for members, centre in buckets:
            for i in members:
                flat = [*g["harmonics"][i, :, :3].ravel(), *g["harmonics"][i, :, 3:].ravel()]
                if level == 0:
                    body += struct.pack("<10f", *g["position"][i], *g["scale"][i], *g["rotation"][i])
                    body += bytes(g["colour"][i]) + struct.pack(f"<{len(flat)}f", *flat)
                else:
                    offset = np.rint((g["position"][i] - np.float32(centre)) / (EDGE / 2) * 32767) + 32767
                    body += struct.pack("<3H7e", *np.clip(offset, 0, 65535).astype(int), *g["scale"][i], *g["rotation"][i])
                    body += bytes(g["colour"][i])
                    body += struct.pack(f"<{len(flat)}e", *flat) if level == 1 else bytes(
                        int(np.clip((v - low) / (high - low) * 255, 0, 255)) for v in flat)
        head = struct.pack("<IIIIfHHIIIIH", n, n, *((BUCKET, len(buckets), EDGE, 12, 0, 32767) if level else (0, 0, 0.0, 0, 0, 0)),
                           len(body), len(full), len(partial), g["degree"])
        headers.append(head.ljust(1024, b"\0"))
        bodies.append(body)
        orders.append(order)
    total = sum(len(g["position"]) for g in sections)
    main = struct.pack("<BBHIIIIHH3fff", 0, 1, 0, len(sections), len(sections), total, total, level, 0, 0, 0, 0, low, high)
    return main.ljust(4096, b"\0") + b"".join(headers) + b"".join(bodies), orders


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degrees", [(0,), (1,), (2,), (2, 0, 1)])
def test_every_level_within_its_precision(rng, tmp_path, level, degrees):
    sections = [gaussians(rng, n, degree) for n, degree in zip((57, 5, 20), degrees, strict=False)]
    data, orders = file(sections, level)
    path = tmp_path / "m.bin"
    path.write_bytes(data)
    assert identify(path).name == ".ksplat"
    model = fg.load(path)
    s = fg.slice_model(model, 0, cull=False)
    begin = 0
    for g, order in zip(sections, orders, strict=True):
        part = slice(begin, begin + len(order))
        begin += len(order)
        np.testing.assert_allclose(s.position[part], g["position"][order], atol=EDGE / 2 / 32767 / 2 + 1e-6 if level else 1e-6)
        np.testing.assert_allclose(s.scale[part], g["scale"][order], rtol=6e-4 if level else 1e-6)
        np.testing.assert_allclose(np.abs((s.rotation[part] * g["rotation"][order]).sum(1)), 1, atol=1e-6)
        np.testing.assert_allclose(s.opacity[part], g["colour"][order, 3] / 255, atol=1e-6)
        np.testing.assert_allclose(s.features[part, :3], (g["colour"][order, :3] / 255 - 0.5) / C0, atol=1e-6)
        rest = s.features[part, 3:].reshape(len(order), -1, 3).transpose(0, 2, 1)
        known = (g["degree"] + 1) ** 2 - 1
        np.testing.assert_allclose(rest[..., :known], g["harmonics"][order], atol=(1e-6, 6e-4, 3 / 255 + 1e-6)[level])
        assert not rest[..., known:].any()
    assert model.appearance == fg.SH(max(degrees))
    assert (begin, model.axes) == (len(model), "RDF")


def test_the_centre_of_a_step_is_exact(tmp_path):
    """32767 is the bucket's centre, bytes of harmonics are shares of the header's bounds."""
    g = {"position": np.array([[1.0, 2, 3]]), "scale": np.ones((1, 3)), "degree": 1, "rotation": np.array([[0.5, 0.5, -0.5, 0.5]]),
         "colour": np.array([[255, 0, 51, 102]], np.uint8), "harmonics": np.arange(9.0).reshape(1, 3, 3)}
    (tmp_path / "m.ksplat").write_bytes(file([g], 2, low=-1.0, high=8.0)[0])
    model = fg.load(tmp_path / "m.ksplat")
    np.testing.assert_allclose(model.position, [[1, 2, 3]], atol=1e-4)
    np.testing.assert_array_equal(model.rotation, [[0.5, 0.5, -0.5, 0.5]])
    steps = np.floor((np.arange(9) + 1) / 9 * 255)
    np.testing.assert_allclose(model.features[0, 3:].reshape(3, 3).T.ravel(), steps / 255 * 9 - 1, atol=1e-6)


def test_empty_sections_are_passed_over(rng, tmp_path):
    empty = {**gaussians(rng, 1, 0), **{k: v[:0] for k, v in gaussians(rng, 1, 0).items() if k != "degree"}}
    data, _ = file([gaussians(rng, 5, 0), empty], 0)
    (tmp_path / "m.ksplat").write_bytes(data)
    assert len(fg.load(tmp_path / "m.ksplat")) == 5


def test_broken_files(rng, tmp_path):
    def refused(data, match):
        (tmp_path / "m.ksplat").write_bytes(data)
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(tmp_path / "m.ksplat")

    crowd = gaussians(rng, 30, 1)
    good, _ = file([crowd | {"position": crowd["position"] / 10}], 1)
    refused(good[:-1], "section.* 30")
    refused(good[:4] + b"\xff" + good[5:], "header.* 255 sections")
    refused(good[:20] + b"\3" + good[21:], "level 3")
    refused(good[:4096 + 40] + b"\7" + good[4096 + 41:], "no sense")
    refused(good[:4096 + 8] + b"\1" + good[4096 + 9:], "buckets.*fewer")
    with pytest.raises(fg.FastGSError, match="'.ksplat'"):
        fg.save(fg.GaussianModel(np.zeros((1, 3)), np.ones((1, 4)), np.zeros((1, 3)), np.zeros(1), np.zeros((1, 3))), tmp_path / "o.ksplat")
