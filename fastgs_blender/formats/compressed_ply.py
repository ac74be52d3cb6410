# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed PLY of PlayCanvas and SuperSplat: static Gaussians in 16 bytes, and a byte for each harmonic coefficient.

Element chunk, a row for 256 Gaussians: least and greatest position, ln of scale and (newer files) colour.  Element vertex: u32
packed_position and packed_scale (11, 10, 11 bits between those bounds), packed_rotation (2 bits: which component is largest, and
3 x 10 bits for the others), packed_color (4 x 8 bits; the last is the opacity).  Element sh, if any: f_rest_* as bytes over -4..4.
"""
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..model.appearance import SH, SH_C0
from ..model.gaussians import GaussianModel, Raster
from ..util.curve import hilbert_order
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import ply
from .base import generator
from .foreign import is_2dgs
from .inria import says_antialiased
from .static import (
    SQRT_HALF,
    StaticFormat,
    by_channel,
    from_channels,
    largest_and_rest,
    logits,
    opacity_bytes,
    read_whole,
    with_largest,
)

CHUNK = 256
POSITION = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
SCALE = [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
COLOUR = [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
DEGREES = {0: 0, 9: 1, 24: 2, 45: 3}
TRIPLE = ((21, 2047), (11, 1023), (0, 2047))
"""Shift and greatest value of the three parts of a position or a scale."""
SCALES = 20.0
"""Logarithms of scales beyond +-SCALES are cut, as PlayCanvas does."""


class CompressedPly(StaticFormat):
    name = "compressed PLY"
    extensions = (".compressed.ply",)
    reads = (".ply",)
    antialiased = empty = True

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and "packed_position" in ply.read_header(path).names

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        if is_2dgs(header):
            raise FastGSError("it holds flat 2DGS surfels, not 3D Gaussians; train it with a 3D method.")
        tables = _tables(path, header)
        chunk, vertex = tables["chunk"], tables["vertex"]
        rest = tables.get("sh")
        names = [] if rest is None else rest.dtype.names
        if len(names) not in DEGREES or set(names) != {f"f_rest_{i}" for i in range(len(names))}:
            raise FastGSError("the columns of its element sh fit no degree of spherical harmonics (0 to 3); export it again.")
        code = {name: vertex[name].astype(np.uint32) for name in PACKED}
        row = np.arange(len(vertex)) // CHUNK
        position = _between(chunk, POSITION, row, _triple(code["packed_position"]))
        scale = _between(chunk, SCALE, row, _triple(code["packed_scale"]))
        colour = np.stack([code["packed_color"] >> shift & 255 for shift in (24, 16, 8)], 1) / 255
        if "min_r" in chunk.dtype.names:
            colour = _between(chunk, COLOUR, row, colour)
        features = [(colour - 0.5) / SH_C0]
        if rest is not None and names:
            levels = _levels()
            harmonics = np.stack([levels[rest[f"f_rest_{i}"].astype(np.uint8)] for i in range(len(names))], 1)
            features = [from_channels(features[0], harmonics.reshape(len(vertex), 3, len(names) // 3))]
        return GaussianModel(
            position=position, rotation=_rotation(code["packed_rotation"]), scale=scale, opacity=logits()[code["packed_color"] & 255],
            features=features[0], appearance=SH(DEGREES[len(names)]), raster=Raster(antialiased=says_antialiased(header)))

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        model, lost = super().fit(model)
        if len(model) and np.abs(model.scale).max() > SCALES:
            lost.append("standard deviations below 2e-09 or above 5e+08 are cut")
        if model.appearance.degree and len(model) and np.abs(model.features[:, 3:]).max() > 4:
            lost.append("spherical harmonics beyond -4..4 are cut")
        lost.append("positions and scales are rounded to 11, 10 and 11 bits and colours to 8 between the bounds of 256 neighbours, "
                    "rotations to 10 bits, opacities to 8" + (", spherical harmonics to 1/32" if model.appearance.degree else ""))
        return model, lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        model = model.take(hilbert_order(model.position))
        n, count = len(model), -(-len(model) // CHUNK)
        bounds, vertex = np.zeros((count, 18), "<f4"), np.zeros((n, 4), "<u4")
        parts = []
        for first, values in ((0, model.position), (6, np.clip(model.scale, -SCALES, SCALES)), (12, 0.5 + SH_C0 * model.features[:, :3])):
            low, high = _bounds(values, count)
            bounds[:, first:first + 3], bounds[:, first + 3:first + 6] = low, high
            parts.append(_shares(values, low, high))
        vertex[:, 0], vertex[:, 2] = _packed(parts[0], TRIPLE), _packed(parts[1], TRIPLE)
        vertex[:, 1] = _rotation_codes(model.rotation)
        vertex[:, 3] = _packed(parts[2], ((24, 255), (16, 255), (8, 255))) | opacity_bytes(model)
        rest = by_channel(model.features).reshape(n, model.appearance.width - 3)
        names = [f"f_rest_{i}" for i in range(rest.shape[1])]
        comments = [f"Written by {generator()}", *(["SplatRenderMode: mip"] if model.raster.antialiased else [])]
        lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments), f"element chunk {count}",
                 *(f"property float {name}" for name in POSITION + SCALE + COLOUR), f"element vertex {n}",
                 *(f"property uint {name}" for name in PACKED), *([f"element sh {n}"] if names else []),
                 *(f"property uchar {name}" for name in names), "end_header", ""]
        levels = np.clip(np.floor((rest.astype(np.float64) / 8 + 0.5) * 256), 0, 255).astype(np.uint8)
        with open(targets[-1], "wb") as stream:
            stream.write("\n".join(lines).encode("ascii") + bounds.tobytes() + vertex.tobytes() + levels.tobytes())


def _tables(path: Path, header: ply.Header) -> dict[str, np.ndarray]:
    """The elements as structured arrays by name, checked against the file's length and each other."""
    if not header.order:
        raise FastGSError("it is a compressed PLY in text, which no program writes; export it as binary.")
    elements = {element.name: element for element in header.elements}
    if any(element.has_lists for element in header.elements):
        raise FastGSError("it has list properties, which compressed PLY files never have; export it again.")
    for name, needed in (("chunk", POSITION + SCALE), ("vertex", PACKED)):
        missing = set(needed) - set(elements[name].names if name in elements else ())
        if missing:
            raise FastGSError(f"its element {name} lacks the columns {', '.join(sorted(missing))}; export it again.")
    count = elements["vertex"].count
    if elements["chunk"].count != -(-count // CHUNK) or ("sh" in elements and elements["sh"].count != count):
        raise FastGSError(f"its {count} Gaussians do not go with {elements['chunk'].count} chunks of {CHUNK}; export it again.")
    data, at, tables = read_whole(path), header.size, {}
    for element in header.elements:
        row = element.row(header.order)
        damaged_if(at + element.count * row.itemsize > len(data), f"the file is cut short: its header promises {count} Gaussians")
        tables[element.name] = np.frombuffer(data, row, element.count, at)
        at += element.count * row.itemsize
    colours = set(COLOUR) & set(elements["chunk"].names)
    if colours and len(colours) < len(COLOUR):
        raise FastGSError("its element chunk has some but not all bounds of colours; export it again.")
    return tables


def _levels() -> np.ndarray:
    """Harmonic coefficients [256] of the bytes: the middle of each step, and both ends."""
    levels = (np.arange(256) + 0.5) / 256
    levels[[0, 255]] = 0, 1
    return (levels - 0.5) * 8


def _triple(code: np.ndarray) -> np.ndarray:
    """Shares [N, 3] in 0..1 of 11, 10 and 11 bits."""
    return np.stack([(code >> shift & most) / most for shift, most in TRIPLE], 1)


def _between(chunk: np.ndarray, names: list[str], row: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Values [N, 3] that lie at `share` between the bounds of each Gaussian's chunk."""
    bounds = np.stack([chunk[name].astype(np.float64) for name in names], 1)[row]
    return bounds[:, :3] * (1 - share) + bounds[:, 3:] * share


def _rotation(code: np.ndarray) -> np.ndarray:
    rest = np.stack([(code >> shift & 1023) / 1023 for shift in (20, 10, 0)], 1)
    return with_largest((code >> 30).astype(np.intp), (rest - 0.5) / SQRT_HALF)


def _rotation_codes(rotation: np.ndarray) -> np.ndarray:
    largest, rest = largest_and_rest(rotation)
    return largest.astype(np.uint32) << 30 | _packed(rest * SQRT_HALF + 0.5, ((20, 1023), (10, 1023), (0, 1023)))


def _bounds(values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest values [count, 3] of each chunk, float32."""
    starts = np.arange(count) * CHUNK
    values = values.astype(np.float32)
    return (np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)) if count else (np.zeros((0, 3)),) * 2


def _shares(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where values [N, 3] lie between the bounds of their chunks, 0..1."""
    row = np.arange(len(values)) // CHUNK
    low, high = low.astype(np.float64)[row], high.astype(np.float64)[row]
    return np.clip((values - low) / np.where(high > low, high - low, 1), 0, 1)


def _packed(share: np.ndarray, places: Sequence[tuple[int, int]]) -> np.ndarray:
    """Codes [N] u32 of shares [N, 3]; places: shift and greatest value of each."""
    code = np.zeros(len(share), np.uint32)
    for i, (shift, most) in enumerate(places):
        code |= np.rint(np.clip(share[:, i], 0, 1) * most).astype(np.uint32) << np.uint32(shift)
    return code
