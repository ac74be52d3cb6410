# SPDX-License-Identifier: GPL-3.0-or-later
"""SPZ of Niantic, versions 1 to 4: quantised static Gaussians, packed with gzip (1 to 3; bare ones are read too) or zstd (4).

A header, then one array after the other: positions (half floats in version 1, then 24-bit fixed point), opacities u8, colours
3 x u8, scales 3 x u8, rotations (x y z as u8 up to version 2, then the three smaller components, 9 bits and a sign each), spherical
harmonics u8 (coefficient by coefficient, r g b each).  The axes are RUB, unless Adobe's extension names others.
Version 3 is written: all maintained readers know it.

Where y points up in the file and down in the PLY, Niantic's coordinateConverter() (splat-types.h, flipSh[23]) also changes the sign of the
last coefficient of degree 4, whose function of the direction is even in y.  Its files hold that sign, so we read and write it.
"""
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import GaussianModel, Raster
from ..util.errors import FastGSError
from ..util.reading import damaged_if
from . import packing
from .static import SQRT_HALF, StaticFormat, largest_and_rest, logits, opacity_bytes, plausible_count, read_whole, to_byte, with_largest
from .turning import into_rdf, turned

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
HEADER = struct.Struct("<4sIIBBBB")
"""Magic, version, Gaussians, degree, bits of positions' fractions, flags, and (version 4) the number of streams."""
HEADER_4 = 32
ANTIALIASED, EXTENDED = 1, 2
COLOUR = 0.15
"""Colours are kept as 0.5 + COLOUR x the coefficient of degree 0."""
ADOBE_AXES = 0xADBE0003
AXES = ("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU")
"""By the number that Adobe's extension has."""
MAX_EXTENSIONS = 1 << 16
"""Bytes."""
VERSION = 3
MAX_FRACTION = 16
SH_STEPS = (8, 16)
"""Degree 1 and the others are rounded to multiples of these, of 128: 5 and 4 bits, as Niantic's own writer does."""


class Spz(StaticFormat):
    name = "SPZ"
    says_axes = True
    extensions = reads = (".spz",)
    degree = 4
    antialiased = True

    def sniff(self, head: bytes, path: Path) -> bool:
        return (zlib.decompressobj(31).decompress(read_whole(path, 1 << 16), 4) if head.startswith(GZIP) else head[:4]) == MAGIC

    def load(self, path: Path) -> GaussianModel:
        return decoded(read_whole(path))

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        model, lost = super().fit(model)
        bits = _fraction(model)
        if np.abs(model.position).max() > (2**23 - 1) / 2**bits:
            lost.append(f"positions beyond {(2**23 - 1) / 2**bits:.0f} are cut")
        if model.scale.min() < -10.03125 or model.scale.max() > 5.96875:
            lost.append("standard deviations below 4.5e-05 or above 379 are cut")
        colour = model.features[:, :3]
        if np.abs(colour).max() > 0.5 / COLOUR:
            lost.append("colours far from 0..1 are cut")
        if model.appearance.degree and (model.features[:, 3:].max() > 1 or model.features[:, 3:].min() < -1):
            lost.append("spherical harmonics beyond -1..1 are cut")
        lost.append(f"positions are rounded to 1/{2**bits}, rotations to 10 bits, opacities, colours and the logarithms of scales to 8"
                    + (", spherical harmonics to 5 and 4" if model.appearance.degree else ""))
        return model, lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        targets[-1].write_bytes(_packed(model))


def decoded(data: bytes, raw: bool = False) -> GaussianModel:
    """The model in an SPZ file's bytes; raw: as the file holds it, in whatever axes.  Raises FastGSError."""
    header, arrays, extensions = _plain(data) if data.startswith(MAGIC) else _gunzip(data)
    _, version, count, degree, fraction, flags, _ = header
    model = _decode(version, count, degree, fraction, arrays)
    model.raster = replace(Raster(), antialiased=bool(flags & ANTIALIASED))
    axes = _axes(extensions if flags & EXTENDED else b"")
    return model if raw else turned(_with_their_sign(model, axes), into_rdf(axes))


def _with_their_sign(model: GaussianModel, axes: str) -> GaussianModel:
    """The model in a file's axes, the sign of its last coefficient of degree 4 changed as Niantic's library does; its own inverse."""
    if model.appearance.degree < 4 or "U" not in axes:
        return model
    return replace(model, features=np.concatenate([model.features[:, :-3], -model.features[:, -3:]], 1))


def _sizes(version: int, count: int, degree: int) -> list[int]:
    """Bytes of each array."""
    return [count * (6 if version == 1 else 9), count, 3 * count, 3 * count, count * (4 if version >= 3 else 3),
            3 * count * ((degree + 1) ** 2 - 1)]


def _header(data: bytes, length: int) -> tuple:
    """The checked header; `length` is that of the whole file."""
    header = HEADER.unpack_from(data)
    magic, version, count, degree, fraction, _, _ = header
    damaged_if(magic != MAGIC or not version, "its header is damaged")
    if version > 4:
        raise FastGSError(f"it is of SPZ version {version}; versions 1 to 4 are read, so export it as one of these.")
    if degree > 4 or fraction > 30:
        raise FastGSError(f"its header makes no sense (spherical harmonics of degree {degree}, {fraction} bits of fractions); "
                          "the file is damaged.")
    plausible_count(count, length)
    return header


def _gunzip(data: bytes) -> tuple[tuple, list[bytes], bytes]:
    """Header, arrays and extensions of versions 1 to 3."""
    header = _header(zlib.decompressobj(31).decompress(data[:1 << 16], HEADER.size), len(data))
    damaged_if(header[1] == 4, "it says that it is of version 4, which is not packed with gzip")
    sizes = _sizes(*header[1:4])
    content = zlib.decompressobj(31).decompress(data, HEADER.size + sum(sizes) + MAX_EXTENSIONS)[HEADER.size:]
    return header, *_arrays(content, header, sizes)


def _arrays(content: bytes, header: tuple, sizes: list[int]) -> tuple[list[bytes], bytes]:
    """The arrays, one after the other, and what follows them."""
    damaged_if(len(content) < sum(sizes), f"the file is cut short: its header promises {header[2]} Gaussians")
    ends = np.cumsum(sizes).tolist()
    return [content[end - size:end] for size, end in zip(sizes, ends, strict=True)], content[ends[-1]:]


def _plain(data: bytes) -> tuple[tuple, list[bytes], bytes]:
    """Header, arrays and extensions of version 4, and of older ones from which gzip has been taken off."""
    header = _header(data, len(data))
    if header[1] < 4:
        return header, *_arrays(data[HEADER.size:], header, _sizes(*header[1:4]))
    streams, table = header[6], int.from_bytes(data[16:20], "little")
    sizes = _sizes(*header[1:4])
    begin = table + 16 * streams
    if not HEADER_4 <= table <= len(data) or begin > len(data) or streams != sum(size > 0 for size in sizes):
        raise FastGSError("its table of contents is damaged or cut short; copy or export the file again.")
    entries = struct.iter_unpack("<QQ", data[table:begin])
    arrays = []
    for size in sizes:
        packed, unpacked = next(entries) if size else (0, 0)
        damaged_if(unpacked != size or packed > len(data) - begin, "the file is cut short, or its table of contents is damaged")
        arrays.append(packing.unzstd(data[begin:begin + packed], size) if size else b"")
        begin += packed
    return header, arrays, data[HEADER_4:table]


def _axes(extensions: bytes) -> str:
    """The axes that Adobe's extension names, among records of type, length and content."""
    at = 0
    while at + 8 <= len(extensions):
        kind, length = struct.unpack_from("<II", extensions, at)
        if kind == ADOBE_AXES and 4 <= length <= len(extensions) - at - 8:
            number = int.from_bytes(extensions[at + 8:at + 12], "little")
            if number >= len(AXES):
                raise FastGSError(f"it names axes by the unknown number {number}; export it in another coordinate system.")
            return AXES[number] or "RUB"
        at += 8 + length
    return "RUB"


def _decode(version: int, count: int, degree: int, fraction: int, arrays: list[bytes]) -> GaussianModel:
    position, opacity, colour, scale, rotation, rest = (np.frombuffer(a, np.uint8) for a in arrays)
    if version == 1:
        place = position.view("<f2").reshape(count, 3).astype(np.float32)
    else:
        parts = position.reshape(count, 3, 3).astype(np.int32)
        whole = parts[..., 0] | parts[..., 1] << 8 | (parts[..., 2] ^ 0x80) << 16
        place = (whole - (1 << 23)) / np.float64(1 << fraction)
    harmonics = (rest.reshape(count, 3 * ((degree + 1) ** 2 - 1)) - 128.0) / 128
    features = np.concatenate([(colour.reshape(count, 3) / 255 - 0.5) / COLOUR, harmonics], 1)
    return GaussianModel(
        position=place, rotation=_quaternions(rotation, count, version), scale=scale.reshape(count, 3) / 16 - 10,
        opacity=logits()[opacity], features=features, appearance=SH(degree))


def _quaternions(data: np.ndarray, count: int, version: int) -> np.ndarray:
    """Quaternions [N, 4], w first, of what is stored of x, y, z, w."""
    if version < 3:
        xyz = data.reshape(count, 3) / 127.5 - 1
        w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(1)))
        return np.concatenate([w[:, None], xyz], 1)
    code = data.view("<u4")
    parts = np.stack([code >> 20, code >> 10, code], 1)
    rest = (parts & 511) * (SQRT_HALF / 511) * np.where(parts & 512, -1, 1)
    return with_largest((code >> 30).astype(np.intp), rest)[:, [3, 0, 1, 2]]


def _fraction(model: GaussianModel) -> int:
    """The most bits of positions' fractions, MAX_FRACTION at most, with which the furthest position fits."""
    furthest = float(np.abs(model.position).max())
    return int(np.clip(np.floor(np.log2((2**23 - 1) / max(furthest, 1e-9))), 0, MAX_FRACTION))


def _packed(model: GaussianModel) -> bytes:
    """A file of version 3."""
    fraction = _fraction(model)
    model = _with_their_sign(turned(model, into_rdf("RUB").T), "RUB")
    whole = np.rint(np.clip(model.position.astype(np.float64) * 2**fraction, -(2**23), 2**23 - 1)).astype("<i4")
    features = model.features.astype(np.float64)
    header = HEADER.pack(MAGIC, VERSION, len(model), model.appearance.degree, fraction, ANTIALIASED * model.raster.antialiased, 0)
    content = [
        header, whole.view(np.uint8).reshape(-1, 4)[:, :3].tobytes(), opacity_bytes(model).tobytes(),
        to_byte((features[:, :3] * COLOUR + 0.5) * 255).tobytes(), to_byte((model.scale.astype(np.float64) + 10) * 16).tobytes(),
        _rotation_codes(model.rotation).tobytes(), _harmonics(features[:, 3:]).tobytes()]
    pack = zlib.compressobj(6, wbits=31)
    return b"".join([*(pack.compress(part) for part in content), pack.flush()])


def _rotation_codes(rotation: np.ndarray) -> np.ndarray:
    largest, rest = largest_and_rest(rotation[:, [1, 2, 3, 0]])
    parts = np.rint(np.abs(rest) * (511 / SQRT_HALF)).astype(np.uint32) | (rest < 0).astype(np.uint32) << 9
    return (largest.astype(np.uint32) << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]).astype("<u4")


def _harmonics(rest: np.ndarray) -> np.ndarray:
    """Coefficients [N, 3 (B - 1)] as bytes, rounded to few of them so that they pack well; 0 stays 0."""
    step = np.where(np.arange(rest.shape[1]) < 9, *SH_STEPS)
    return to_byte(np.minimum(np.rint(rest * 128 / step) * step + 128, 255))
