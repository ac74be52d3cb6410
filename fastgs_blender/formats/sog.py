# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG of PlayCanvas, versions 1 and 2: static Gaussians in lossless WebP pictures, a pixel a Gaussian, as a .sog (a zip) or a folder.

meta.json names the pictures and holds bounds and tables.  means_l and means_u: the low and high bytes of positions, 16 bits between the
bounds of sign(x) ln(|x| + 1).  quats: the three smaller components and, as 252 + which, the largest.  scales: ln, version 1 between
bounds, version 2 by a table of 256 values.  sh0: the coefficients of degree 0 likewise, and the opacity.  shN: a number of 16 bits
for a row of shN_centroids, which holds the other coefficients, 64 rows beside each other.
"""
from __future__ import annotations

import io
import json
import zipfile

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import GaussianModel, Raster
from ..util.errors import FastGSError
from .base import generator
from .codebooks import codebook, palette
from .description import read_json, whole_number
from .static import (
    SQRT_HALF,
    StaticFormat,
    largest_and_rest,
    logits,
    morton_order,
    opacity_bytes,
    plausible_count,
    read_whole,
    with_largest,
)

MAX_META = 1 << 22
"""Bytes of meta.json."""
ZIP = b"PK\x03\x04"
COEFFICIENTS = {1: 3, 2: 8, 3: 15}
"""Above degree 0, by degree."""
BESIDE = 64
"""Entries of the palette in a row of its picture."""
LARGEST = 16383
"""Edge of a WebP picture, in pixels."""


class Sog(StaticFormat):
    """See the module."""

    name = "SOG"
    extensions = (".sog",)
    reads = (".sog", "meta.json")
    antialiased = True

    def sniff(self, head, path):
        if head.startswith(ZIP):
            try:
                with _Archive(path) as files:
                    return files.has("meta.json") and _is_meta(files.read("meta.json", MAX_META))
            except FastGSError:
                return path.suffix.lower() == ".sog"  # broken, which load() says
        return head.lstrip()[:1] == b"{" and path.stat().st_size <= MAX_META and _is_meta(read_whole(path))

    def load(self, path):
        zipped = read_whole(path, 4) == ZIP
        with (_Archive(path) if zipped else _Folder(path.parent)) as files:
            meta = read_json(files.read("meta.json", MAX_META) if zipped else read_whole(path))
            return _decoded(meta, files)

    def fit(self, model):
        if not len(model):
            raise FastGSError("the model has no Gaussians, and SOG has no pictures of none.")
        model, lost = super().fit(model)
        if _size(len(model))[0] > LARGEST:
            raise FastGSError(f"{len(model)} Gaussians are more than the pictures of SOG hold; save it as .spz or .ply.")
        lost.append("positions are rounded to 16 bits, rotations and opacities to 8, scales and colours to 256 values each"
                    + (", spherical harmonics to a palette" if model.appearance.degree else ""))
        return model, lost

    def write(self, model, targets):
        model = model.take(morton_order(model.position))
        meta, pictures = _encoded(model)
        with zipfile.ZipFile(targets[-1], "w", zipfile.ZIP_STORED) as archive:
            for name, content in [*pictures.items(), ("meta.json", json.dumps(meta, allow_nan=False).encode("ascii"))]:
                archive.writestr(zipfile.ZipInfo(name), content)  # with the date that ZipInfo has by itself: same model, same bytes


class _Folder:
    """The files beside a meta.json."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        pass

    def size(self, name: str) -> int:
        path = self.folder / _plain(name)
        if not path.is_file():
            raise FastGSError(f"its picture {name} is missing; put it beside meta.json.")
        return path.stat().st_size

    def read(self, name: str, limit: int) -> bytes:
        if self.size(name) > limit:
            raise FastGSError(f"{name} is larger than it can be; the file is damaged.")
        return read_whole(self.folder / _plain(name))


class _Archive:
    """The files of a zip, wherever in it meta.json lies."""

    def __init__(self, path):
        try:
            self.zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise FastGSError(f"it is a broken zip archive ({error}); copy it again.") from error
        self.length = path.stat().st_size
        self.members = {info.filename: info for info in self.zip.infolist() if not info.is_dir()}
        self.base = next((name[:-len("meta.json")] for name in sorted(self.members, key=len)
                          if name == "meta.json" or name.endswith("/meta.json")), "")

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        self.zip.close()

    def has(self, name: str) -> bool:
        return self.base + name in self.members

    def size(self, name: str) -> int:
        if not self.has(_plain(name)):
            raise FastGSError(f"its picture {name} is missing; export it again.")
        return self.members[self.base + name].file_size

    def read(self, name: str, limit: int) -> bytes:
        size = self.size(name)
        if size > limit or size > 4 * self.length:
            raise FastGSError(f"{name} is larger than it can be; the file is damaged.")
        try:
            with self.zip.open(self.members[self.base + name]) as stream:
                return stream.read(size)
        except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, OSError) as error:
            raise FastGSError(f"{name} cannot be unpacked ({error}); copy the file again.") from error


def _plain(name) -> str:
    """The name of a file in the same folder, and nothing else."""
    if not isinstance(name, str) or not name or name in (".", "..") or any(c in name for c in "/\\:\0"):
        raise FastGSError("meta.json names a picture that is not beside it; the file is damaged.")
    return name


def _is_meta(text: bytes) -> bool:
    try:
        meta = read_json(text)
    except FastGSError:
        return False
    return isinstance(meta, dict) and all(isinstance(meta.get(key), dict) and "files" in meta[key] for key in ("means", "quats", "sh0"))


def _decoded(meta: dict, files) -> GaussianModel:
    version = meta.get("version", 1)
    if version not in (1, 2):
        raise FastGSError(f"it is of SOG version {str(version)[:20]}; versions 1 and 2 are read.")
    if version == 2:
        count = whole_number(meta.get("count"), "the number of Gaussians")
    else:
        shape = _part(meta, "means").get("shape")
        count = whole_number(shape[0] if isinstance(shape, list) and shape else None, "the number of Gaussians")
    names = {key: _names(meta, key, n) for key, n in (("means", 2), ("quats", 1), ("scales", 1), ("sh0", 1))}
    if meta.get("shN"):
        names["shN"] = _names(meta, "shN", 2)
    plausible_count(count, sum(files.size(name) for group in names.values() for name in group))
    low, high, quats, scales, colour = (_pixels(files, name, count) for key in ("means", "quats", "scales", "sh0") for name in names[key])
    bounds = _bounds(_part(meta, "means"), 3)
    share = (low[:, :3] + 256.0 * high[:, :3]) / 65535
    logarithm = bounds[0] + share * np.where(bounds[1] == bounds[0], 1, bounds[1] - bounds[0])
    features, opacity = _colours(_part(meta, "sh0"), colour, version)
    rotation = with_largest(quats[:, 3].clip(252) - 252, (quats[:, :3] / 255 * 2 - 1) * SQRT_HALF)
    rotation[quats[:, 3] < 252] = [1, 0, 0, 0]
    degree, rest = _harmonics(meta, names, files, count, version) if "shN" in names else (0, np.zeros((count, 0)))
    return GaussianModel(
        position=np.sign(logarithm) * np.expm1(np.abs(logarithm)), rotation=rotation, scale=_scales(_part(meta, "scales"), scales, version),
        opacity=opacity, features=np.concatenate([features, rest], 1), appearance=SH(degree),
        raster=Raster(antialiased=meta.get("model") == "antialiased" or meta.get("antialias") is True))


def _scales(part: dict, pixels: np.ndarray, version: int) -> np.ndarray:
    if version == 2:
        return _table(part)[pixels[:, :3]]
    low, high = _bounds(part, 3)
    return low + (high - low) * (pixels[:, :3] / 255)


def _colours(part: dict, pixels: np.ndarray, version: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of degree 0 [N, 3] and logits of opacity [N]."""
    if version == 2:
        return _table(part)[pixels[:, :3]], logits()[pixels[:, 3]]
    low, high = _bounds(part, 4)
    values = low + (high - low) * (pixels / 255)
    return values[:, :3], values[:, 3]


def _harmonics(meta: dict, names: dict, files, count: int, version: int) -> tuple[int, np.ndarray]:
    """The degree, and the coefficients above degree 0 [N, 3 (B - 1)], r g b each."""
    part = _part(meta, "shN")
    picture = _picture(files, names["shN"][0], BESIDE * 65536)
    degree = next((d for d, n in COEFFICIENTS.items() if picture.shape[1] == BESIDE * n), None)
    if degree is None or (version == 2 and part.get("bands", degree) != degree):
        raise FastGSError("its palette of spherical harmonics has an unknown width; the file is damaged.")
    width = COEFFICIENTS[degree]
    entries = picture[:, :, :3].reshape(len(picture) * BESIDE, width, 3)  # rows of 64 entries of `width` pixels
    if version == 2:
        values = _table(part)[entries]
    else:
        low, high = (_numbers([part.get(key)], 1)[0] for key in ("mins", "maxs"))
        values = low + (high - low) * (entries / 255)
    labels = _pixels(files, names["shN"][1], count)
    label = labels[:, 0] + 256 * labels[:, 1]
    known = label < (min(whole_number(part.get("count", len(values)), "the palette's length"), len(values)))
    rest = values[np.where(known, label, 0)] * known[:, None, None]
    return degree, rest.reshape(count, 3 * width)


def _part(meta: dict, key: str) -> dict:
    if not isinstance(meta.get(key), dict):
        raise FastGSError(f"meta.json says nothing of {key}; the file is damaged.")
    return meta[key]


def _names(meta: dict, key: str, count: int) -> list[str]:
    names = _part(meta, key).get("files")
    if not isinstance(names, list) or len(names) < count:
        raise FastGSError(f"meta.json does not name the pictures of {key}; the file is damaged.")
    return [_plain(name) for name in names[:count]]


def _numbers(values, count: int) -> np.ndarray:
    good = isinstance(values, list) and len(values) >= count and all(type(v) in (int, float) and abs(v) < 1e30 for v in values)
    if not good:
        raise FastGSError("meta.json has something else where numbers should be; the file is damaged.")
    return np.array(values, np.float64)


def _bounds(part: dict, count: int) -> tuple[np.ndarray, np.ndarray]:
    return _numbers(part.get("mins"), count)[:count], _numbers(part.get("maxs"), count)[:count]


def _table(part: dict) -> np.ndarray:
    """A table of 256 values; what it has too few of is 0."""
    values = part.get("codebook")
    values = _numbers(values, 1)[:256]
    return np.concatenate([values, np.zeros(256 - len(values))])


def _pixels(files, name: str, count: int) -> np.ndarray:
    """The first `count` pixels of a picture, [count, 4] u8 as integers."""
    picture = _picture(files, name, 2 * count + (1 << 16))
    pixels = picture.reshape(-1, 4)
    if len(pixels) < count:
        raise FastGSError(f"its picture {name} has {len(pixels)} pixels for {count} Gaussians; the file is cut short or damaged.")
    return pixels[:count].astype(np.intp)


def _picture(files, name: str, most: int) -> np.ndarray:
    """A picture [h, w, 4] u8 of at most `most` pixels, which its header tells before anything is unpacked."""
    from PIL import Image

    data = files.read(name, 1 << 31)
    width, height = _webp_size(data)
    if width * height > most:
        raise FastGSError(f"its picture {name} has more pixels than there are Gaussians for; the file is damaged.")
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as image:
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FastGSError(f"its picture {name} is no WebP, or damaged ({error}); copy or export it again.") from error


def _webp_size(data: bytes) -> tuple[int, int]:
    """Width and height in a WebP picture's header, before any library makes room for it; 0 where there are none."""
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return 0, 0
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    bits = int.from_bytes(data[21:25] if kind == b"VP8L" else data[26:30], "little")
    return (1 + (bits & 16383), 1 + (bits >> 14 & 16383)) if kind == b"VP8L" else (bits & 16383, bits >> 16 & 16383)


def _size(count: int) -> tuple[int, int]:
    """Width and height of the pictures, multiples of 4."""
    width = 4 * int(np.ceil(np.sqrt(count) / 4))
    return width, 4 * int(np.ceil(count / width / 4))


def _webp(pixels: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(stream, "WEBP", lossless=True, exact=True, quality=75, method=4)
    return stream.getvalue()


def _encoded(model: GaussianModel) -> tuple[dict, dict[str, bytes]]:
    """meta.json and the pictures of version 2."""
    n, (width, height) = len(model), _size(len(model))

    def picture(*columns) -> bytes:
        pixels = np.zeros((width * height, 4), np.uint8)
        pixels[:n] = np.concatenate([np.reshape(c, (n, -1)) for c in columns], 1)
        return _webp(pixels.reshape(height, width, 4))

    full = np.full(n, 255)
    position = model.position.astype(np.float64)
    logarithm = np.sign(position) * np.log1p(np.abs(position))
    low, high = logarithm.min(0), logarithm.max(0)
    code = np.rint((logarithm - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    largest, rest = largest_and_rest(model.rotation)
    scales, scale_codes = codebook(model.scale)
    colours, colour_codes = codebook(model.features[:, :3])
    pictures = {
        "means_l.webp": picture(code & 255, full), "means_u.webp": picture(code >> 8, full),
        "quats.webp": picture(np.rint((rest / SQRT_HALF + 1) / 2 * 255), 252 + largest), "scales.webp": picture(scale_codes, full),
        "sh0.webp": picture(colour_codes, opacity_bytes(model))}
    meta = {
        "version": 2, "asset": {"generator": generator()}, "count": n,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scales, "files": ["scales.webp"]}, "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colours, "files": ["sh0.webp"]}}
    if model.raster.antialiased:
        meta |= {"model": "antialiased", "antialias": True}
    degree = model.appearance.degree
    if degree:
        entries, labels = palette(model.features[:, 3:])
        table, codes = codebook(entries)
        rows = -(-len(entries) // BESIDE)
        pixels = np.full((rows * BESIDE, COEFFICIENTS[degree], 4), 255, np.uint8)
        pixels[:len(entries), :, :3] = codes.reshape(len(entries), -1, 3)
        pictures["shN_centroids.webp"] = _webp(pixels.reshape(rows, -1, 4))
        pictures["shN_labels.webp"] = picture(labels & 255, labels >> 8, np.zeros(n), full)
        meta["shN"] = {"count": len(entries), "bands": degree, "codebook": table, "files": ["shN_centroids.webp", "shN_labels.webp"]}
    return meta, pictures
