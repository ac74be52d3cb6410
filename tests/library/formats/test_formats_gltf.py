# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF with KHR_gaussian_splatting, in files that are assembled here by its specification."""
from __future__ import annotations

import base64
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from test_formats_spz import covariances, expected, packed
from test_formats_spz import file as spz_file

import fastgs_blender as fg
from fastgs_blender.formats import identify
from fastgs_blender.model.appearance import sh_basis

pytestmark = pytest.mark.filterwarnings("error")
EXT = "KHR_gaussian_splatting"
LUF = np.diag([-1.0, -1, 1])
"""From glTF's axes to RDF, and back."""


def glb(tree: dict, binary: bytes) -> bytes:
    """A .glb of this JSON and these bytes."""
    text = json.dumps(tree).encode()
    text, binary = text + b" " * (-len(text) % 4), binary + bytes(-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def tree_of(attributes: dict[str, np.ndarray], node=None, **about) -> tuple[dict, bytes]:
    """JSON and bytes of one primitive; integers are normalised."""
    codes = {"float32": 5126, "uint8": 5121, "uint16": 5123, "int8": 5120, "int16": 5122}
    views, accessors, binary = [], [], b""
    for values in attributes.values():
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": codes[values.dtype.name], "count": len(values),
                          "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]], "normalized": values.dtype.kind in "iu"})
        binary += values.tobytes() + bytes(-values.nbytes % 4)
    primitive = {"attributes": {name: i for i, name in enumerate(attributes)}, "mode": 0,
                 "extensions": {EXT: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", **about}}}
    return {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, **(node or {})}],
            "meshes": [{"primitives": [primitive]}], "buffers": [{"byteLength": len(binary)}], "bufferViews": views,
            "accessors": accessors, "extensionsUsed": [EXT]}, binary


def random_attributes(rng, n=11, degree=2, short=False) -> dict[str, np.ndarray]:
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    out = {"POSITION": rng.normal(size=(n, 3)), f"{EXT}:ROTATION": q, f"{EXT}:SCALE": rng.uniform(0.01, 1, (n, 3)),
           f"{EXT}:OPACITY": rng.uniform(0.01, 0.99, (n, 1))}
    out |= {f"{EXT}:SH_DEGREE_{d}_COEF_{k}": rng.normal(size=(n, 3)) for d in range(degree + 1) for k in range(2 * d + 1)}
    out = {name: values.astype(np.float32) for name, values in out.items()}
    if short:
        out[f"{EXT}:ROTATION"] = np.rint(q * 32767).astype(np.int16)
        out[f"{EXT}:SCALE"] = np.rint(out[f"{EXT}:SCALE"] * 65535).astype(np.uint16)
        out[f"{EXT}:OPACITY"] = np.rint(out[f"{EXT}:OPACITY"] * 255).astype(np.uint8)
    return out


def random_file(packed=False, short=False) -> tuple[bytes, dict]:
    """A .glb, and its attributes."""
    rng = np.random.default_rng(8)
    if packed:
        return packed_file(rng)
    attributes = random_attributes(rng, short=short)
    return glb(*tree_of(attributes, {"translation": [1, 2, 3], "scale": [2, 2, 2]})), attributes


def assumed_file() -> bytes:
    """A .glb with another kernel, scales as logarithms and a second mesh with linear colours."""
    attributes = random_attributes(np.random.default_rng(9), degree=1)
    attributes[f"{EXT}:SCALE"] = np.log(attributes[f"{EXT}:SCALE"])
    tree, binary = tree_of(attributes, kernel="cube")
    second = {**tree["meshes"][0]["primitives"][0], "extensions": {EXT: {"kernel": "ellipse", "colorSpace": "lin_rec709_display"}}}
    tree["meshes"].append({"primitives": [second]})
    tree["nodes"].append({"mesh": 1})
    tree["scenes"][0]["nodes"] = [0, 1]
    return glb(tree, binary)


def packed_file(rng, version=2, draft=False, name=None):
    arrays = packed(rng, version, 13, 1)
    data = spz_file(version, 13, 1, arrays)
    tree, _ = tree_of({})
    about = {} if draft else {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    about["extensions"] = {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}
    tree["meshes"][0]["primitives"][0]["extensions"] = {name: {"bufferView": 0}} if name else {EXT: about}
    tree |= {"bufferViews": [{"buffer": 0, "byteLength": len(data)}], "buffers": [{"byteLength": len(data)}]}
    return glb(tree, data), arrays


def colours(model, directions) -> np.ndarray:
    return np.einsum("db,nbc->ndc", sh_basis(directions, model.appearance.degree), model.features.reshape(len(model), -1, 3).astype(float))


def assert_model(model, attributes, matrix=None):
    """The specification's formulas, in float64, with a node's matrix [4, 4]."""
    matrix = np.eye(4) if matrix is None else np.array(matrix, float)
    a = {name.removeprefix(f"{EXT}:"): v / (np.float64(np.iinfo(v.dtype).max) if v.dtype.kind in "iu" else 1.0)
         for name, v in attributes.items()}
    x, y, z, w = (a["ROTATION"] / np.linalg.norm(a["ROTATION"], axis=1, keepdims=True)).T
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)
    c = LUF @ matrix[:3, :3] @ (turn * a["SCALE"][:, None])
    np.testing.assert_allclose(model.position, (a["POSITION"] @ matrix[:3, :3].T + matrix[:3, 3]) @ LUF, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(covariances(model), c @ c.transpose(0, 2, 1), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-model.opacity.astype(float))), a["OPACITY"][:, 0], atol=1e-6)
    directions = np.random.default_rng(2).normal(size=(15, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    degree = max(int(name.split("_")[2]) for name in a if name.startswith("SH"))
    basis, features = sh_basis(directions, degree), [a[f"SH_DEGREE_{d}_COEF_{k}"] for d in range(degree + 1) for k in range(2 * d + 1)]
    left, _, right = np.linalg.svd(matrix[:3, :3])
    seen = directions @ (LUF @ left @ right).T
    np.testing.assert_allclose(colours(model, seen), np.einsum("db,bnc->ndc", basis, np.array(features)), atol=2e-5)


@pytest.mark.parametrize("short", [False, True])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_attributes_as_the_specification_says(rng, tmp_path, short, degree):
    attributes = random_attributes(rng, 30, degree, short)
    path = tmp_path / "m.bin"
    path.write_bytes(glb(*tree_of(attributes)))
    assert identify(path).name == "glTF KHR_gaussian_splatting"
    model = fg.load(path)
    assert_model(model, attributes)
    assert (model.axes, model.colour_space, model.appearance) == ("RDF", "srgb", fg.SH(degree))


TURN = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize(("node", "matrix"), [
    ({"translation": [1, 2, 3]}, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]),
    ({"rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]}, [[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]),
    ({"scale": [1, 2, 0.5]}, np.diag([1, 2, 0.5, 1])),
    ({"matrix": [0, 3, 0, 0, -3, 0, 0, 0, 0, 0, 3, 0, 5, 6, 7, 1]}, [[0, -3, 0, 5], [3, 0, 0, 6], [0, 0, 3, 7], [0, 0, 0, 1]]),
])
def test_nodes_place_their_gaussians(rng, tmp_path, node, matrix):
    attributes = random_attributes(rng, 20, 1)
    (tmp_path / "m.glb").write_bytes(glb(*tree_of(attributes, node)))
    assert_model(fg.load(tmp_path / "m.glb"), attributes, matrix)


def test_a_tree_of_nodes_and_two_primitives(rng, tmp_path):
    one, two = random_attributes(rng, 5, 1), random_attributes(rng, 7, 0)
    tree, binary = tree_of({**one, **{f"b{k}": v for k, v in two.items()}})
    first = tree["meshes"][0]["primitives"][0]
    second = {**first, "attributes": {k[1:]: i for k, i in first["attributes"].items() if k.startswith("b")}}
    first["attributes"] = {k: i for k, i in first["attributes"].items() if not k.startswith("b")}
    tree["meshes"] = [{"primitives": [first]}, {"primitives": [second, {"attributes": {}, "mode": 4}]}]
    tree["nodes"] = [{"children": [1, 2], "translation": [10, 0, 0]}, {"mesh": 0}, {"mesh": 1, "scale": [2, 2, 2]}, {"mesh": 0}]
    (tmp_path / "m.glb").write_bytes(glb(tree, binary))
    model = fg.load(tmp_path / "m.glb")
    assert_model(model.take(slice(0, 5)), one, [[1, 0, 0, 10], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    moved = [[2, 0, 0, 10], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(model.position[5:], (two["POSITION"] * 2 + [10, 0, 0]) @ LUF, rtol=1e-5, atol=1e-5)
    assert (len(model), model.features[5:, 3:].any(), len(moved)) == (12, False, 4)


def test_a_mesh_that_a_thousand_nodes_show_is_refused(rng, tmp_path):
    tree, binary = tree_of(random_attributes(rng, 50, 1))
    for count, good in ((3, True), (1000, False)):
        tree["nodes"] = [{"children": list(range(1, count + 1))}, *([{"mesh": 0}] * count)]
        (tmp_path / "m.glb").write_bytes(glb(tree, binary))
        if good:
            assert len(fg.load(tmp_path / "m.glb")) == 50 * count
        else:
            with pytest.raises(fg.FastGSError, match="many times"):
                fg.load(tmp_path / "m.glb")


def test_buffers_in_folders_and_names_with_spaces(rng, tmp_path):
    """URIs, as exporters write them."""
    attributes = random_attributes(rng)
    tree, binary = tree_of(attributes)
    (tmp_path / "the buffers").mkdir()
    (tmp_path / "the buffers" / "m 1.bin").write_bytes(binary)
    for uri in ("the%20buffers/m%201.bin", "./the buffers/m 1.bin"):
        tree["buffers"][0]["uri"] = uri
        (tmp_path / "m.gltf").write_text(json.dumps(tree))
        assert_model(fg.load(tmp_path / "m.gltf"), attributes)


@pytest.mark.parametrize("uri", ["file", "data", "data in lines"])
def test_json_with_its_buffer_apart(rng, tmp_path, uri):
    """The mark of UTF-8 before it, which Windows' programs write, makes no difference."""
    attributes = random_attributes(rng)
    tree, binary = tree_of(attributes, colorSpace="lin_rec709_display")
    (tmp_path / "m.data").write_bytes(binary)
    packed = (base64.encodebytes if uri.endswith("lines") else base64.b64encode)(binary).decode()
    name = "m.data" if uri == "file" else "data:application/octet-stream;base64," + packed
    tree["buffers"][0]["uri"] = name
    (tmp_path / "m.gltf").write_text(json.dumps(tree), "utf-8-sig")
    model = fg.load(tmp_path / "m.gltf")
    assert_model(model, attributes)
    assert model.colour_space == "linear"


@pytest.mark.parametrize("version", [2, 3, 4])
def test_spz_within(rng, tmp_path, version):
    """SPZ's own axes are known, so they lead to the same RDF; drafts without a kernel hold glTF's axes as they are."""
    data, arrays = packed_file(rng, version)
    (tmp_path / "m.glb").write_bytes(data)
    model, want = fg.load(tmp_path / "m.glb"), expected(version, 13, 1, arrays)
    np.testing.assert_allclose(model.position, want["position"], rtol=1e-6)
    np.testing.assert_allclose(model.features[:, 3:].reshape(13, 3, 3), want["sh"], atol=1e-6)
    for name in (None, "KHR_spz_gaussian_splats_compression", "KHR_spz_compression"):
        data, arrays = packed_file(rng, version, draft=True, name=name)
        (tmp_path / "m.glb").write_bytes(data)
        stored = expected(version, 13, 1, arrays)["position"] * [1, -1, -1]
        np.testing.assert_allclose(fg.load(tmp_path / "m.glb").position, stored @ LUF, rtol=1e-6)


@pytest.mark.parametrize("degree", [0, 2, 3])
@pytest.mark.parametrize("colour_space", ["srgb", "linear"])
def test_round_trip_without_losses(rng, make_model, tmp_path, degree, colour_space):
    model = make_model(rng, 60, appearance=f"sh{degree}", colour_space=colour_space)
    fg.save(model, tmp_path / "m.glb")
    back = fg.load(tmp_path / "m.glb")
    np.testing.assert_array_equal(back.position, model.position)
    np.testing.assert_array_equal(back.features, model.features)
    np.testing.assert_allclose(back.scale, model.scale, atol=1e-6)
    a, b = fg.slice_model(model, 0, cull=False), fg.slice_model(back, 0, cull=False)
    np.testing.assert_allclose(b.opacity, a.opacity, atol=1e-6)
    np.testing.assert_allclose(np.abs((a.rotation * b.rotation).sum(1)), 1, atol=1e-6)
    assert back.colour_space == colour_space


def test_parts_are_nodes(rng, make_model, tmp_path):
    """One for each, and one without a name for what belongs to none; a Gaussian of two parts is in the first."""
    model = make_model(rng, 30, appearance="sh1")
    bits = {"Ball": np.arange(30) % 3 == 0, "Hat": np.arange(30) % 2 == 0}
    fg.save(replace(model, parts=fg.Parts.of(bits)), tmp_path / "m.glb")
    data = (tmp_path / "m.glb").read_bytes()
    tree = json.loads(data[20:20 + int.from_bytes(data[12:16], "little")])
    assert [node.get("name") for node in tree["nodes"]] == ["Ball", "Hat", None] and tree["scenes"] == [{"nodes": [0, 1, 2]}]
    back = fg.load(tmp_path / "m.glb")
    np.testing.assert_array_equal(back.position[back.parts["Ball"]], model.position[bits["Ball"]])
    np.testing.assert_array_equal(back.features[back.parts["Hat"]], model.features[bits["Hat"] & ~bits["Ball"]])
    assert len(back) == 30
    fg.save(model, tmp_path / "one.glb")
    assert fg.load(tmp_path / "one.glb").parts.names == ()


def test_an_unknown_kernel_is_drawn_as_an_ellipse(rng, tmp_path):
    """The specification's note on other kernels: renderers that do not know one should fall back to the ellipse."""
    attributes = random_attributes(rng, 20, 1)
    (tmp_path / "m.glb").write_bytes(glb(*tree_of(attributes, kernel="customShape")))
    with pytest.warns(fg.LossWarning, match="customShape.*ellipse"):
        assert_model(fg.load(tmp_path / "m.glb"), attributes)


def test_scales_as_logarithms(rng, tmp_path):
    """splat-transform before a07f5aa (2026-06-22) wrote scale_0..2 of the PLY as they are; some of them are always negative."""
    attributes = random_attributes(rng, 20, 1)
    logs = attributes | {f"{EXT}:SCALE": np.log(attributes[f"{EXT}:SCALE"])}
    assert (logs[f"{EXT}:SCALE"] < 0).any()
    (tmp_path / "m.glb").write_bytes(glb(*tree_of(logs)))
    with pytest.warns(fg.LossWarning, match="logarithms.*negative"):
        assert_model(fg.load(tmp_path / "m.glb"), attributes)


@pytest.mark.parametrize("degree", [0, 2])
def test_meshes_in_two_colour_spaces(rng, tmp_path, degree):
    """Linear ones are converted by the sRGB curve of IEC 61966-2-1, in all directions as nearly as their harmonics can."""
    one, two = random_attributes(rng, 6, degree), random_attributes(rng, 9, degree)
    for name in two:  # colours within 0.2..0.9
        if "SH_DEGREE" in name:
            two[name] = np.float32(0.03 * two[name] if "DEGREE_0" not in name else rng.uniform(-0.7, 1, two[name].shape))
    tree, binary = tree_of({**one, **{f"b{k}": v for k, v in two.items()}})
    first = tree["meshes"][0]["primitives"][0]
    second = {**first, "attributes": {k[1:]: i for k, i in first["attributes"].items() if k.startswith("b")},
              "extensions": {EXT: {"kernel": "ellipse", "colorSpace": "lin_rec709_display"}}}
    first["attributes"] = {k: i for k, i in first["attributes"].items() if not k.startswith("b")}
    tree["meshes"].append({"primitives": [second]})
    tree["nodes"].append({"mesh": 1})
    tree["scenes"][0]["nodes"] = [0, 1]
    (tmp_path / "m.glb").write_bytes(glb(tree, binary))
    with pytest.warns(fg.LossWarning, match="colour spaces.*sRGB"):
        model = fg.load(tmp_path / "m.glb")
    assert model.colour_space == "srgb" and len(model) == 15
    assert_model(model.take(slice(0, 6)), one)
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    features = np.stack([two[f"{EXT}:SH_DEGREE_{d}_COEF_{k}"] for d in range(degree + 1) for k in range(2 * d + 1)], 1).astype(float)
    linear = 0.5 + np.einsum("db,nbc->ndc", sh_basis(directions, degree), features)
    wanted = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(0.5 + colours(model.take(slice(6, 15)), directions @ LUF.T), wanted, atol=2e-2 if degree else 1e-5)


def test_broken_files(rng, tmp_path):
    def refused(match, change=lambda tree: None, cut=0):
        tree, binary = tree_of(random_attributes(rng))
        change(tree)
        (tmp_path / "m.glb").write_bytes(glb(tree, binary[:len(binary) - cut]))
        with pytest.raises(fg.FastGSError, match=match):
            fg.load(tmp_path / "m.glb")

    about = lambda tree: tree["meshes"][0]["primitives"][0]["extensions"][EXT]  # noqa: E731
    refused("cut short", cut=8)
    refused("longer.*buffer", lambda t: t["accessors"][0].update(count=10**9))
    refused("colour space", lambda t: about(t).update(colorSpace="acescg"))
    for uri in ("../m.bin", "a/../../m.bin", "%2e%2e/m.bin", "/etc/passwd", "a//b", "c:\\m.bin", "http://a/b", "m%00.bin", "", "."):
        refused("beside.*below", lambda t, uri=uri: t["buffers"][0].update(uri=uri))
    refused("is missing", lambda t: t["buffers"][0].update(uri="m.bin"))
    refused("tree of nodes", lambda t: t["nodes"][0].update(children=[0]))
    refused("attribute KHR_gaussian_splatting:SCALE", lambda t: t["meshes"][0]["primitives"][0]["attributes"].pop(f"{EXT}:SCALE"))
    refused("sparse", lambda t: t["accessors"][0].update(sparse={}))
    refused("flattens", lambda t: t["nodes"][0].update(scale=[1, 0, 1]))
    refused("Import > glTF", lambda t: t["meshes"][0]["primitives"][0].pop("extensions"))
