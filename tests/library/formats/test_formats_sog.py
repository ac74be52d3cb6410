# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG of PlayCanvas, versions 1 and 2, as a folder and as a .sog, against its formulas transcribed in float64."""
from __future__ import annotations

import io
import json
import tracemalloc
import zipfile

import numpy as np
import pytest
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.formats import identify
from fastgs_blender.formats.codebooks import codebook, palette

pytestmark = pytest.mark.filterwarnings("error")


def webp(pixels, width: int) -> bytes:
    """A lossless picture of rows of `width` pixels [n, 4]; the rest of the last row is padding."""
    rows = -(-len(pixels) // width)
    full = np.zeros((rows * width, 4), np.uint8)
    full[:len(pixels)] = pixels
    stream = io.BytesIO()
    Image.fromarray(full.reshape(rows, width, 4), "RGBA").save(stream, "WEBP", lossless=True, exact=True)
    return stream.getvalue()


def contents(rng, n: int, degree: int, version: int) -> tuple[dict[str, bytes], dict]:
    """The files of a folder with random codes, and what they stand for, one Gaussian at a time."""
    def code(*bounds):
        return np.stack([rng.integers(0, b, n) for b in bounds], 1)

    low, high, quats = code(256, 256, 256, 256), code(256, 256, 256, 256), code(140, 140, 140, 4) + [60, 60, 60, 252]
    scales, colours, labels = code(256, 256, 256, 1), code(256, 256, 256, 256), code(70, 1, 1, 1)
    mins, maxs = rng.normal(-2, 0.3, 3), rng.normal(2, 0.3, 3)
    width = (degree + 1) ** 2 - 1
    table = {name: np.sort(rng.normal(size=256)) for name in ("scales", "sh0", "shN")}
    bounds = {name: np.sort(rng.normal(size=(2, 4)), 0) for name in table}
    centroids = rng.integers(0, 256, (128, width, 4))

    want = {"position": np.zeros((n, 3)), "rotation": np.zeros((n, 4)), "scale": np.zeros((n, 3)), "opacity": np.zeros(n),
            "dc": np.zeros((n, 3)), "rest": np.zeros((n, width, 3))}

    def value(name, byte, channel):
        if version == 2:
            return table[name][byte]
        first, last = bounds[name][:, 0 if name == "shN" else channel]
        return first + (last - first) * byte / 255

    for i in range(n):
        for axis in range(3):
            v = mins[axis] + (maxs[axis] - mins[axis]) * ((int(high[i, axis]) << 8) + low[i, axis]) / 65535
            want["position"][i, axis] = np.sign(v) * (np.exp(abs(v)) - 1)
            want["scale"][i, axis] = np.exp(value("scales", scales[i, axis], axis))
            want["dc"][i, axis] = value("sh0", colours[i, axis], axis)
        rest = [(b / 255 * 2 - 1) / np.sqrt(2) for b in quats[i, :3]]
        rest.insert(quats[i, 3] - 252, np.sqrt(max(0.0, 1 - sum(v * v for v in rest))))
        want["rotation"][i] = rest
        want["opacity"][i] = colours[i, 3] / 255 if version == 2 else 1 / (1 + np.exp(-value("sh0", colours[i, 3], 3)))
        for j in range(width):
            want["rest"][i, j] = [value("shN", centroids[labels[i, 0], j, c], c) for c in range(3)]

    def part(name, channels, **more):
        if version == 2:
            return {"codebook": table[name].tolist(), **more}
        if name == "shN":
            return {"mins": bounds[name][0, 0], "maxs": bounds[name][1, 0], "quantization": 8, **more}
        return {"shape": [n, channels], "mins": bounds[name][0, :channels].tolist(), "maxs": bounds[name][1, :channels].tolist(), **more}

    meta = {"means": {"shape": [n, 3], "mins": mins.tolist(), "maxs": maxs.tolist(), "files": ["means_l.webp", "means_u.webp"]},
            "scales": part("scales", 3, files=["scales.webp"]), "quats": {"shape": [n, 4], "files": ["quats.webp"]},
            "sh0": part("sh0", 4, files=["sh0.webp"])}
    if version == 2:
        meta |= {"version": 2, "count": n, "asset": {"generator": "test"}, "antialias": True}
    files = {"means_l.webp": webp(low, 8), "means_u.webp": webp(high, 8), "quats.webp": webp(quats, 8), "scales.webp": webp(scales, 8),
             "sh0.webp": webp(colours, 8)}
    if degree:
        more = {"count": 128, "bands": degree} if version == 2 else {}
        meta["shN"] = part("shN", 3, files=["shN_centroids.webp", "shN_labels.webp"], **more)
        files |= {"shN_centroids.webp": webp(centroids.reshape(-1, 4), 64 * width), "shN_labels.webp": webp(labels, 8)}
    return {"meta.json": json.dumps(meta).encode(), **files}, want


def zipped(files: dict[str, bytes], folder="", method=zipfile.ZIP_STORED) -> bytes:
    """A .sog of these files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(folder + name, content)
    return stream.getvalue()


def assert_model(model, want):
    s = fg.slice_model(model, 0, cull=False)
    for name in ("position", "scale"):
        np.testing.assert_allclose(getattr(s, name), want[name], rtol=2e-6, atol=1e-6)
    np.testing.assert_allclose(s.opacity, want["opacity"], atol=1e-6)
    np.testing.assert_allclose(np.abs((s.rotation * want["rotation"] / np.linalg.norm(want["rotation"], axis=1, keepdims=True)).sum(1)), 1,
                               atol=1e-6)
    np.testing.assert_allclose(s.features[:, :3], want["dc"], atol=1e-6)
    np.testing.assert_allclose(s.features[:, 3:].reshape(want["rest"].shape), want["rest"], atol=1e-6)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("form", ["folder", "stored", "deflated in a folder"])
def test_both_versions_as_their_formulas_say(rng, tmp_path, version, degree, form):
    files, want = contents(rng, 53, degree, version)
    if form == "folder":
        path = tmp_path / "meta.json"
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
    else:
        path = tmp_path / "m.bin"
        path.write_bytes(zipped(files) if form == "stored" else zipped(files, "scene/", zipfile.ZIP_DEFLATED))
    assert identify(path).name == "SOG"
    model = fg.load(path)
    assert_model(model, want)
    assert model.raster.antialiased == (version == 2)


def test_versions_as_texts_and_marks_before_the_json(rng, tmp_path):
    for said, version in (("2", 2), (2.0, 2), ("1", 1)):
        files, want = contents(rng, 12, 1, version)
        files["meta.json"] = json.dumps(json.loads(files["meta.json"]) | {"version": said}).encode("utf-8-sig")
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        assert_model(fg.load(tmp_path / "meta.json"), want)
        (tmp_path / "m.sog").write_bytes(zipped(files))
        assert_model(fg.load(tmp_path / "m.sog"), want)


def test_pictures_of_other_kinds_that_hold_the_same_numbers(rng, tmp_path):
    """PNG, and WebP without an alpha channel where that is not used; names that begin with ./; version 1 with a count, no shape."""
    files, want = contents(rng, 20, 1, 1)
    meta = json.loads(files.pop("meta.json"))
    for part in meta.values():
        part.pop("shape", None)
        part["files"] = [f"./{name}" for name in part["files"]]
    again = {}
    for number, (name, content) in enumerate(files.items()):
        stream = io.BytesIO()
        with Image.open(io.BytesIO(content)) as picture:
            if name.startswith("means"):
                picture.convert("RGB").save(stream, "WEBP", lossless=True)
            else:
                picture.save(stream, "PNG" if number % 2 else "WEBP", lossless=True, exact=True)
        again[name] = stream.getvalue()
    again["meta.json"] = json.dumps(meta | {"count": 20}).encode()
    (tmp_path / "m.sog").write_bytes(zipped(again))
    assert_model(fg.load(tmp_path / "m.sog"), want)
    palette = io.BytesIO()
    Image.new("P", (8, 8)).save(palette, "PNG")
    (tmp_path / "m.sog").write_bytes(zipped(again | {"sh0.webp": palette.getvalue()}))
    with pytest.raises(fg.FastGSError, match="another kind"):
        fg.load(tmp_path / "m.sog")


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("n", [1, 300])
def test_round_trip(rng, make_model, tmp_path, n, degree):
    model = make_model(rng, n, appearance=f"sh{degree}", extent=9.0, raster=fg.Raster(antialiased=True))
    path = tmp_path / "m.sog"
    with pytest.warns(fg.LossWarning, match="16 bits") as said:
        fg.save(model, path)
    assert len(said) == 1
    back = fg.load(path)
    assert (len(back), back.appearance, back.raster) == (n, model.appearance, model.raster)
    a, b = fg.slice_model(model, 0, cull=False), fg.slice_model(back, 0, cull=False)
    twin = np.linalg.norm(a.position[:, None] - b.position[None], axis=2).argmin(0)
    assert len(set(twin.tolist())) == n
    step = np.ptp(np.sign(a.position) * np.log1p(np.abs(a.position)), axis=0) / 65535 / 2
    assert (np.abs(a.position[twin] - b.position) <= step * (1 + np.abs(a.position[twin])) + 2e-6).all()
    for true, rounded in ((model.scale, back.scale), (model.features[:, :3], back.features[:, :3])):
        error = true[twin] - rounded  # no worse than 256 values in equal steps
        assert np.sqrt(np.mean(error**2)) <= np.ptp(true) / 256 / np.sqrt(12) + 1e-6
        assert np.abs(error).max() <= np.ptp(true) / 32 + 1e-6
    np.testing.assert_allclose(b.opacity, a.opacity[twin], atol=0.5 / 255 + 1e-6)
    assert np.abs((a.rotation[twin] * b.rotation).sum(1)).min() > 1 - 5e-5
    if degree:  # fewer Gaussians than the palette has room for: only the table of 256 values rounds
        error = a.features[twin, 3:] - b.features[:, 3:]
        assert np.sqrt(np.mean(error**2)) <= np.ptp(a.features[:, 3:]) / 256 / np.sqrt(12) + 1e-6


def test_the_same_model_gives_the_same_bytes(rng, make_model, tmp_path):
    model = make_model(rng, 40, appearance="sh1")
    for name in ("a.sog", "b.sog"):
        with pytest.warns(fg.LossWarning):
            fg.save(model, tmp_path / name)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        assert {"meta.json", "means_l.webp", "shN_labels.webp"} <= set(archive.namelist())


def test_broken_files(rng, tmp_path):
    good, _ = contents(rng, 40, 1, 2)
    meta = json.loads(good["meta.json"])

    def refused(match, files=None, **changed):
        files = files or {**good, "meta.json": json.dumps(meta | changed).encode()}
        (tmp_path / "m.sog").write_bytes(zipped(files))
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(tmp_path / "m.sog")

    refused("version 3", version=3)
    refused("promises 4000000", count=4_000_000)
    refused("40 pixels for 2000|has 40 pixels", count=2000)
    refused("beside.*below", quats={"files": ["../../etc/passwd"]})
    refused("quats.webp.*missing", {k: v for k, v in good.items() if k != "quats.webp"})
    refused("meta.json.*scales", scales=None)
    refused("meta.json.*numbers", sh0={"codebook": ["a"], "files": ["sh0.webp"]})
    refused("unknown width", shN={**meta["shN"], "bands": 2})
    refused("WebP.*PNG", {**good, "sh0.webp": good["sh0.webp"][:40]})
    refused("cannot be", count=-1)


def test_a_picture_of_a_gigabyte_takes_no_memory(rng, tmp_path):
    """A header of 16383 x 16383 pixels before nothing."""
    good, _ = contents(rng, 40, 0, 2)
    huge = bytearray(good["means_l.webp"])
    huge[21:25] = (16382 | 16382 << 14 | 1 << 28).to_bytes(4, "little")
    (tmp_path / "m.sog").write_bytes(zipped({**good, "means_l.webp": bytes(huge)}))
    tracemalloc.start()
    try:
        with pytest.raises(fg.FastGSError, match="more pixels.*Gaussians"):
            fg.load(tmp_path / "m.sog")
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()


def test_tables_of_256_values(rng):
    few = rng.choice(rng.normal(size=200), (50, 3)).astype(np.float32)
    table, codes = codebook(few)
    np.testing.assert_array_equal(np.float32(table)[codes], few)
    many = rng.normal(size=(20_000, 3))
    table, codes = codebook(many)
    assert len(table) == 256
    assert table == sorted(table)
    error = np.abs(np.array(table)[codes] - many)
    np.testing.assert_array_equal(error, np.abs(many[..., None] - table).min(-1))  # the nearest entry
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.ptp(many) / 256 / np.sqrt(12) * 2


def test_palettes_stand_for_their_groups(rng):
    vectors = rng.normal(size=(3000, 9)).astype(np.float32)
    entries, label = palette(vectors, 64)
    assert entries.shape == (64, 9)
    for number in range(64):
        np.testing.assert_allclose(entries[number], vectors[label == number].mean(0), atol=1e-5)
    assert ((vectors - entries[label]) ** 2).sum() < 0.75 * ((vectors - vectors.mean(0)) ** 2).sum()
    entries, label = palette(np.repeat(vectors[:5], 20, 0))
    assert len(entries) == 5
    np.testing.assert_allclose(entries[label], np.repeat(vectors[:5], 20, 0), atol=1e-6)
