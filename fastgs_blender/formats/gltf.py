# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF with KHR_gaussian_splatting (.glb, .gltf): static Gaussians as attributes of points, in the axes left, up, forward.

All primitives with the extension are read, where the nodes of the scene put them; also those packed by
KHR_gaussian_splatting_compression_spz_2, or as its drafts had it.  Names of several nodes become parts.  A .glb is written, with a node
for each part and floats: nothing is rounded.

What is assumed, with a LossWarning: another kernel is drawn as an ellipse, as the specification's note asks; where a primitive has a
negative scale, all its scales are natural logarithms, as splat-transform wrote them until June 2026 (version 2.6); of primitives in several
colour spaces, linear ones become sRGB.
"""
import base64
import json
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..model.appearance import SH, SH_C0
from ..model.gaussians import GaussianModel, Raster
from ..model.parts import pieces, told_apart
from ..model.slicing import sigmoid
from ..util import rotations
from ..util.errors import FastGSError, LossWarning, printable
from ..util.reading import damaged_if
from ..util.stated_paths import below
from .base import OPAQUE, generator
from .description import is_json_table, read_table, whole_number
from .scenes import placed, together
from .spz import decoded
from .static import StaticFormat, read_whole
from .turning import into_rdf, turned

EXTENSION = "KHR_gaussian_splatting"
PACKED = "KHR_gaussian_splatting_compression_spz_2"
DRAFTS = ("KHR_spz_gaussian_splats_compression", "KHR_spz_compression")
"""Of it, extensions of primitives by themselves, which 3D Tiles of 2025 have."""
AXES = "LUF"
MAGIC, JSON, BINARY = b"glTF", 0x4E4F534A, 0x004E4942
MAX_JSON = 1 << 26
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
TYPES = {width: name for name, width in WIDTHS.items()}
COLOURS = {"srgb_rec709_display": "srgb", "lin_rec709_display": "linear"}
MAX_NODES = 100_000
OVER = 4
"""How many times over all nodes together may show the bytes of a file: a mesh that a thousand nodes show would be a thousand meshes."""


class Gltf(StaticFormat):
    name = "glTF KHR_gaussian_splatting"
    says_axes = keeps_parts = True
    extensions = (".glb",)
    reads = (".glb", ".gltf")
    linear = True

    def sniff(self, head: bytes, path: Path) -> bool:
        if not head.startswith(MAGIC) and not is_json_table(head):
            return False
        return bool(_primitives(_parts(path)[0]))

    def load(self, path: Path) -> GaussianModel:
        tree, binary = _parts(path)
        found = _primitives(tree)
        if not found:
            raise FastGSError("there are no Gaussians in this glTF file (KHR_gaussian_splatting); in Blender use File > Import > glTF.")
        buffers, assumed = _Buffers(tree, binary, path.parent), dict[str, None]()
        models = []
        for place, _, primitive in found:
            models.append(placed(_primitive(tree, primitive, buffers, assumed), place))
        if len({model.colour_space for model in models}) > 1:
            assumed["its meshes are in several colour spaces, of which linear ones become sRGB"] = None
        if assumed:
            warnings.warn(LossWarning(f"{path}: {'; '.join(assumed)}."), stacklevel=3)
        parts = told_apart([(name, len(model)) for (_, name, _), model in zip(found, models, strict=True)])
        return replace(turned(together(models), into_rdf(AXES)), parts=parts)

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        targets[-1].write_bytes(_glb(model))


def _parts(path: Path) -> tuple[dict, bytes]:
    """The JSON, and the binary chunk (empty in a .gltf).  Raises FastGSError."""
    if read_whole(path, 4) != MAGIC:
        if path.stat().st_size > MAX_JSON:
            raise FastGSError("it is too large for a .gltf file of Gaussians; save it as .glb.")
        return read_table(read_whole(path)), b""
    data, chunks, at = read_whole(path), dict[int, bytes](), 12
    if int.from_bytes(data[4:8], "little") != 2:
        raise FastGSError("it is a damaged .glb file, or of another version than 2; export it again.")
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        damaged_if(size > len(data) - at - 8, "the file is cut short")
        chunks.setdefault(kind, data[at + 8:at + 8 + size])
        at += 8 + size + -size % 4
    return read_table(chunks.get(JSON, b"")), chunks.get(BINARY, b"")


def _splats(mesh: dict) -> list[dict]:
    """The primitives of a mesh that are Gaussians."""
    return [p for p in mesh.get("primitives", []) if not {EXTENSION, *DRAFTS}.isdisjoint(p.get("extensions", {}))]


def _primitives(tree: dict) -> list[tuple[np.ndarray, str, dict]]:
    """Primitives of Gaussians with the matrix [4, 4] and the name of their node; without a scene, all of them as they are."""
    nodes, meshes = tree.get("nodes", []), tree.get("meshes", [])
    if not any(map(_splats, meshes)):
        return []
    scene = tree.get("scenes", [])[tree.get("scene", 0):][:1]
    if not scene or "nodes" not in scene[0]:
        return [(np.eye(4), "", p) for mesh in meshes for p in _splats(mesh)]
    found, seen, stack = [], set[int](), [(index, np.eye(4)) for index in reversed(scene[0]["nodes"])]
    while stack:
        index, above = stack.pop()
        if index in seen or len(seen) > MAX_NODES:
            raise FastGSError("its tree of nodes is damaged; export it again.")
        seen.add(index)
        place = above @ _matrix(nodes[index])
        if "mesh" in nodes[index]:
            name = nodes[index].get("name", "")
            found += [(place, name if isinstance(name, str) else "", p) for p in _splats(meshes[nodes[index]["mesh"]])]
        stack += [(child, place) for child in reversed(nodes[index].get("children", []))]
    return found


def _matrix(node: dict) -> np.ndarray:
    def vector(key: str, *default: float) -> np.ndarray:
        return np.array(node.get(key, default), np.float64).reshape(len(default))

    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    turn = rotations.to_matrices(rotations.unit(vector("rotation", 0, 0, 0, 1)[[3, 0, 1, 2]]))
    return rotations.transform(turn * vector("scale", 1, 1, 1), vector("translation", 0, 0, 0))


class _Buffers:
    """The bytes of buffers, read once."""

    def __init__(self, tree: dict, binary: bytes, folder: Path) -> None:
        self.tree, self.binary, self.folder, self.known, self.spent = tree, binary, folder, dict[int, bytes](), 0

    def spend(self, size: int) -> None:
        """Count bytes that become Gaussians; raises FastGSError where these are far more than there are."""
        self.spent += size
        if self.spent > OVER * sum(map(len, self.known.values())):
            raise FastGSError("its nodes show the same Gaussians many times over; export them joined into one mesh.")

    def view(self, index: int) -> bytes:
        view = self.tree["bufferViews"][index]
        number = view["buffer"]
        if number not in self.known:
            self.known[number] = self._buffer(self.tree["buffers"][number], number)
        begin, size = whole_number(view.get("byteOffset", 0), "a view's offset"), whole_number(view.get("byteLength"), "a view's length")
        damaged_if(begin + size > len(self.known[number]), "the file is cut short, or a view lies outside its buffer")
        return self.known[number][begin:begin + size]

    def _buffer(self, buffer: dict, number: int) -> bytes:
        uri: Any = buffer.get("uri")
        if uri is None and number == 0:
            return self.binary
        if uri.startswith("data:"):
            return base64.b64decode("".join(uri.partition(",")[2].split()), validate=True)
        file = below(self.folder, unquote(uri))
        if file is None:
            raise FastGSError(f"its buffer {uri[:60]!r} is not a file beside or below it; put it there, or save it as .glb.")
        if not file.is_file():
            raise FastGSError(f"its buffer {uri[:60]!r} is missing; put it beside the file.")
        return read_whole(file)


def _accessor(tree: dict, index: int, width: int, buffers: _Buffers) -> np.ndarray:
    """Numbers [N, width] of an accessor, normalised ones as their shares."""
    accessor = tree["accessors"][index]
    kind = COMPONENTS.get(accessor["componentType"])
    if kind is None or WIDTHS.get(accessor["type"]) != width:
        raise FastGSError("an attribute of its Gaussians has another type than it should; export it again.")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise FastGSError("an attribute of its Gaussians is sparse, or packed in a way that is not known; export it without compression.")
    count = whole_number(accessor.get("count"), "the number of Gaussians")
    data = buffers.view(accessor["bufferView"])
    begin, item = whole_number(accessor.get("byteOffset", 0), "an attribute's offset"), np.dtype(kind).itemsize * width
    step = whole_number(tree["bufferViews"][accessor["bufferView"]].get("byteStride", item), "an attribute's stride")
    if step < item or (count and begin + step * (count - 1) + item > len(data)):
        raise FastGSError("the file is cut short: an attribute is longer than its buffer; copy or export it again.")
    buffers.spend(count * item)
    values = np.ndarray((count, width), kind, data, begin, (step, np.dtype(kind).itemsize)) if count else np.zeros((0, width))
    values = values.astype(np.float64)
    if accessor.get("normalized") is True and kind != "<f4":
        values = np.maximum(values / np.iinfo(kind).max, -1)
    return values


def _primitive(tree: dict, primitive: dict, buffers: _Buffers, assumed: dict[str, None]) -> GaussianModel:
    """The model of one primitive, in glTF's axes; `assumed` gets a clause for what the file does not say plainly."""
    extensions, attributes = primitive["extensions"], primitive.get("attributes", {})
    about = extensions.get(EXTENSION, {})
    packed = next((extensions[name] for name in DRAFTS if name in extensions), about.get("extensions", {}).get(PACKED))
    colours, kernel = about.get("colorSpace", "srgb_rec709_display"), about.get("kernel", "ellipse")
    if colours not in COLOURS:
        raise FastGSError("its Gaussians have a colour space that is not known; export it in sRGB.")
    if kernel != "ellipse":
        assumed[f"its kernel {printable(repr(kernel)[:40])} is not known and is drawn as an ellipse, so pictures may differ"] = None
    if packed is not None:
        draft = "kernel" not in about and "colorSpace" not in about
        data = buffers.view(packed["bufferView"])
        buffers.spend(len(data))
        model = decoded(data, raw=draft)  # drafts hold glTF's own axes, as Cesium reads them
        return replace(model if draft else turned(model, into_rdf(AXES).T), colour_space=COLOURS[colours])

    def read(name: str, width: int) -> np.ndarray:
        name = name if name == "POSITION" else f"{EXTENSION}:{name}"
        if name not in attributes:
            raise FastGSError(f"its Gaussians have no attribute {name}; export it again.")
        return _accessor(tree, attributes[name], width, buffers)

    degree = next((d for d in (3, 2, 1) if f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in attributes), 0)
    features = [read(f"SH_DEGREE_{d}_COEF_{k}", 3) for d in range(degree + 1) for k in range(2 * d + 1)]
    opacity = read("OPACITY", 1)[:, 0]
    logit = np.clip(np.log(opacity) - np.log1p(-opacity), -OPAQUE, OPAQUE)
    scale = read("SCALE", 3)
    if (scale < 0).any():
        assumed["its scales are taken for natural logarithms, since some are negative (splat-transform before 2.7 wrote such files)"] = None
    arrays = {"position": read("POSITION", 3), "rotation": read("ROTATION", 4)[:, [3, 0, 1, 2]],
              "scale": scale if (scale < 0).any() else np.log(scale),
              "opacity": logit, "features": np.concatenate(features, 1)}
    damaged_if(len({len(array) for array in arrays.values()}) > 1, "its attributes differ in length")
    return GaussianModel(**arrays, appearance=SH(degree), raster=Raster(), colour_space=COLOURS[colours])


def _glb(model: GaussianModel) -> bytes:
    """A .glb with a node and a mesh of one primitive for each piece of the model."""
    model = turned(model, into_rdf(AXES).T)
    space = next(key for key, value in COLOURS.items() if value == model.colour_space)
    about = {"kernel": "ellipse", "colorSpace": space, "sortingMethod": "cameraDistance", "projection": "perspective"}
    views, accessors, nodes, meshes = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
    data, at = list[bytes](), 0
    for name, index in pieces(model.parts, len(model)):
        attributes = {}
        for attribute, values in _attributes(model.take(index)):
            code = 5121 if values.dtype == np.uint8 else 5126
            data.append(np.ascontiguousarray(values, COMPONENTS[code]).tobytes())
            views.append({"buffer": 0, "byteOffset": at, "byteLength": len(data[-1]), "target": 34962})
            attributes[attribute] = len(accessors)
            accessors.append({"bufferView": len(accessors), "componentType": code, "count": len(index), "type": TYPES[values.shape[1]],
                              **({"normalized": True} if code == 5121 else {})})
            if attribute == "POSITION":
                accessors[-1] |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
            at += len(data[-1])
        named = {"name": name} if name else {}
        nodes.append({"mesh": len(meshes), **named})
        meshes.append({"primitives": [{"attributes": attributes, "mode": 0, "extensions": {EXTENSION: about}}], **named})
    tree = {"asset": {"version": "2.0", "generator": generator()}, "extensionsUsed": [EXTENSION], "scene": 0,
            "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes,
            "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(tree, allow_nan=False).encode("ascii")
    text += b" " * (-len(text) % 4)
    return b"".join([MAGIC, struct.pack("<IIII", 2, 28 + len(text) + at, len(text), JSON), text, struct.pack("<II", at, BINARY), *data])


def _attributes(model: GaussianModel) -> list[tuple[str, np.ndarray]]:
    """The attributes of a primitive, of a model in glTF's axes."""
    n, degree = len(model), model.appearance.degree
    alpha = sigmoid(model.opacity)
    shown = np.clip(0.5 + SH_C0 * model.features[:, :3].astype(np.float64), 0, 1)
    if model.colour_space == "srgb":  # COLOR_0, for programs that only know points, is linear
        shown = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    coefficients = model.features.reshape(n, (degree + 1) ** 2, 3)
    return [("POSITION", model.position), ("COLOR_0", np.rint(np.concatenate([shown, alpha[:, None]], 1) * 255).astype(np.uint8)),
            (f"{EXTENSION}:ROTATION", rotations.unit(model.rotation.astype(np.float64))[:, [1, 2, 3, 0]]),
            (f"{EXTENSION}:SCALE", np.exp(model.scale.astype(np.float64))), (f"{EXTENSION}:OPACITY", alpha[:, None]),
            *((f"{EXTENSION}:SH_DEGREE_{d}_COEF_{k}", coefficients[:, d * d + k]) for d in range(degree + 1) for k in range(2 * d + 1))]
