# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG of PlayCanvas, versions 1 and 2: static Gaussians in lossless WebP pictures, a pixel a Gaussian, as a .sog (a zip) or a folder.

meta.json names the pictures and holds bounds and tables.  means_l and means_u: the low and high bytes of positions, 16 bits between the
bounds of sign(x) ln(|x| + 1).  quats: the three smaller components and, as 252 + which, the largest.  scales: ln, version 1 between
bounds, version 2 by a table of 256 values.  sh0: the coefficients of degree 0 likewise, and the opacity.  shN: a number of 16 bits
for a row of shN_centroids, which holds the other coefficients, 64 rows beside each other.
"""
import json
import warnings
import zipfile
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import GaussianModel, Raster
from ..util.curve import hilbert_order
from ..util.errors import FastGSError, LossWarning
from . import pixel_tables as tables
from .base import generator
from .codebooks import codebook, palette
from .description import read_table, whole_number
from .static import (
    SQRT_HALF,
    StaticFormat,
    largest_and_rest,
    logits,
    opacity_bytes,
    plausible_count,
    read_whole,
    with_largest,
)

COEFFICIENTS = {1: 3, 2: 8, 3: 15}
"""Above degree 0, by degree."""
BESIDE = 64
"""Entries of the palette in a row of its picture."""
LARGEST = 16383
"""Edge of a WebP picture, in pixels."""


class Sog(StaticFormat):
    name = "SOG"
    extensions = (".sog",)
    reads = (".sog", tables.META)
    antialiased = True

    def sniff(self, head: bytes, path: Path) -> bool:
        meta = tables.meta_of(head, path)
        return all(isinstance(meta.get(key), dict) and "files" in meta[key] for key in ("means", "quats", "sh0"))

    def load(self, path: Path) -> GaussianModel:
        if (path.absolute().parent.parent / "lod-meta.json").is_file():
            warnings.warn(LossWarning(f"{path}: it is one chunk of a streamed scene; lod-meta.json in the folder above is the whole."),
                          stacklevel=3)
        with tables.opened(path) as files:
            return decoded(files.meta(), files)

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        model, lost = super().fit(model)
        if _size(len(model))[0] > LARGEST:
            raise FastGSError(f"{len(model)} Gaussians are more than the pictures of SOG hold; save it as .spz or .ply.")
        lost.append("positions are rounded to 16 bits, rotations and opacities to 8, scales and colours to 256 values each"
                    + (", spherical harmonics to a palette" if model.appearance.degree else ""))
        return model, lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        model = model.take(hilbert_order(model.position))
        meta, pictures = _encoded(model)
        with zipfile.ZipFile(targets[-1], "w", zipfile.ZIP_STORED) as archive:
            for name, content in [*pictures.items(), ("meta.json", json.dumps(meta, allow_nan=False).encode("ascii"))]:
                archive.writestr(zipfile.ZipInfo(name), content)  # with the date that ZipInfo has by itself: same model, same bytes


def pictures(path: Path) -> list[Path]:
    """The pictures that a meta.json names.  Raises FastGSError."""
    parts = read_table(read_whole(path, tables.MAX_META)).values()
    named = [part["files"] for part in parts if isinstance(part, dict) and isinstance(part.get("files"), list)]
    return [path.parent / tables.plain(name) for names in named for name in names]


def decoded(meta: dict, files: tables.Folder) -> GaussianModel:
    """The model that a meta.json describes."""
    said = str(meta.get("version", 1))[:20]
    version = {"1": 1, "2": 2}.get(said.removesuffix(".0"))
    if version is None:
        raise FastGSError(f"it is of SOG version {said}; versions 1 and 2 are read.")
    if version == 2:
        count = whole_number(meta.get("count"), "the number of Gaussians")
    else:
        shape = tables.part(meta, "means").get("shape")
        count = whole_number(shape[0] if isinstance(shape, list) and shape else meta.get("count"), "the number of Gaussians")
    names = {key: tables.names(meta, key, n) for key, n in (("means", 2), ("quats", 1), ("scales", 1), ("sh0", 1))}
    if meta.get("shN"):
        names["shN"] = tables.names(meta, "shN", 2)
    plausible_count(count, sum(files.size(name) for group in names.values() for name in group))
    quats, scales, colour = (tables.pixels(files, names[key][0], count) for key in ("quats", "scales", "sh0"))
    position = logarithmic(meta, "means", files, count)
    features, opacity = _colours(tables.part(meta, "sh0"), colour, version)
    rotation = with_largest(quats[:, 3].clip(252) - 252, (quats[:, :3] / 255 * 2 - 1) * SQRT_HALF)
    rotation[quats[:, 3] < 252] = [1, 0, 0, 0]
    degree, rest = _harmonics(meta, names, files, count, version) if "shN" in names else (0, np.zeros((count, 0)))
    return GaussianModel(
        position=position, rotation=rotation, scale=_scales(tables.part(meta, "scales"), scales, version), opacity=opacity,
        features=np.concatenate([features, rest], 1), appearance=SH(degree),
        raster=Raster(antialiased=meta.get("model") == "antialiased" or meta.get("antialias") is True))


def logarithmic(meta: dict, key: str, files: tables.Folder, count: int) -> np.ndarray:
    """Numbers [count, 3] of a part, kept as shares of 16 bits between bounds of sign(x) ln(|x| + 1)."""
    low, high = tables.bounds(tables.part(meta, key), 3)
    share = tables.sixteen_bits(files, tables.names(meta, key, 2), count)[:, :3]
    logarithm = low + share * np.where(high == low, 1, high - low)
    return np.sign(logarithm) * np.expm1(np.abs(logarithm))


def _scales(part: dict, pixels: np.ndarray, version: int) -> np.ndarray:
    if version == 2:
        return tables.table(part)[pixels[:, :3]]
    low, high = tables.bounds(part, 3)
    return low + (high - low) * (pixels[:, :3] / 255)


def _colours(part: dict, pixels: np.ndarray, version: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of degree 0 [N, 3] and logits of opacity [N]."""
    if version == 2:
        return tables.table(part)[pixels[:, :3]], logits()[pixels[:, 3]]
    low, high = tables.bounds(part, 4)
    values = low + (high - low) * (pixels / 255)
    return values[:, :3], values[:, 3]


def _harmonics(meta: dict, names: dict, files: tables.Folder, count: int, version: int) -> tuple[int, np.ndarray]:
    """The degree, and the coefficients above degree 0 [N, 3 (B - 1)], r g b each."""
    part = tables.part(meta, "shN")
    picture = tables.picture(files, names["shN"][0], BESIDE * 65536)
    degree = next((d for d, n in COEFFICIENTS.items() if picture.shape[1] == BESIDE * n), None)
    if degree is None or (version == 2 and part.get("bands", degree) != degree):
        raise FastGSError("its palette of spherical harmonics has an unknown width; the file is damaged.")
    width = COEFFICIENTS[degree]
    entries = picture[:, :, :3].reshape(len(picture) * BESIDE, width, 3)  # rows of 64 entries of `width` pixels
    if version == 2:
        values = tables.table(part)[entries]
    else:
        low, high = (tables.numbers([part.get(key)], 1)[0] for key in ("mins", "maxs"))
        values = low + (high - low) * (entries / 255)
    labels = tables.pixels(files, names["shN"][1], count)
    label = labels[:, 0] + 256 * labels[:, 1]
    known = label < (min(whole_number(part.get("count", len(values)), "the palette's length"), len(values)))
    rest = values[np.where(known, label, 0)] * known[:, None, None]
    return degree, rest.reshape(count, 3 * width)


def _size(count: int) -> tuple[int, int]:
    """Width and height of the pictures, multiples of 4."""
    width = 4 * int(np.ceil(np.sqrt(count) / 4))
    return width, 4 * int(np.ceil(count / width / 4))


def _encoded(model: GaussianModel) -> tuple[dict, dict[str, bytes]]:
    """meta.json and the pictures of version 2."""
    n, (width, height) = len(model), _size(len(model))

    def picture(*columns: np.ndarray) -> bytes:
        pixels = np.zeros((width * height, 4), np.uint8)
        pixels[:n] = np.concatenate([np.reshape(c, (n, -1)) for c in columns], 1)
        return tables.webp(pixels.reshape(height, width, 4))

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
        pictures["shN_centroids.webp"] = tables.webp(pixels.reshape(rows, -1, 4))
        pictures["shN_labels.webp"] = picture(labels & 255, labels >> 8, np.zeros(n), full)
        meta["shN"] = {"count": len(entries), "bands": degree, "codebook": table, "files": ["shN_centroids.webp", "shN_labels.webp"]}
    return meta, pictures
