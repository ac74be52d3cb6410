# SPDX-License-Identifier: GPL-3.0-or-later
"""`.gsd`, a sequence of static models in one file (DazaiStudio/4dgs-converter; its players are for Unreal Engine).

"GSD1", the length of a JSON header (u32) and the header; then for each frame the length (u32) of an LZ4 block and the block.  Unpacked,
a frame is its textures one after another, each byte-shuffled: all first bytes of its pixels, then all second bytes, and so on.  A texture
has four channels a pixel, float32 (precision 0) or float16 (1), and at least one pixel for each Gaussian:

    position      z, x, -y
    rotation      z, x, -y, w
    scale         z, x, y, and opacity, both activated
    colour        the coefficients r g b, r g b, ... of the spherical harmonics, four a texture
"""
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.sequence import Source
from ..util.errors import FastGSError
from ..util.reading import damaged_if, exactly, open_file
from .base import Loader
from .description import frame_rate, read_table, whole_number
from .packing import unlz4
from .sequences import SequenceFormat, within
from .straight import logit

MAGIC = b"GSD1"
TEXTURES = {0: 1, 1: 3, 2: 7, 3: 12}
"""Of colour, by the degree of the spherical harmonics."""
PRECISIONS = ("positionPrecision", "rotationPrecision", "scaleOpacityPrecision", "shPrecision")
DTYPES = ("<f4", "<f2")


@dataclass(frozen=True)
class _Frame:
    """Where a frame's block lies, its Gaussians, and the pixels of its textures."""

    begin: int
    length: int
    count: int
    pixels: int


class Gsd(SequenceFormat):
    name = "GSD sequence"
    magic = MAGIC
    reads = (".gsd",)

    def open(self, path: Path, load: Loader) -> Source:
        header, frames = _layout(path)
        degree = whole_number(header.get("shDegree", 0), "its degree of spherical harmonics")
        kinds = [whole_number(header.get(key, 0), f"its {key}") for key in PRECISIONS]
        if degree not in TEXTURES or not all(kind < len(DTYPES) for kind in kinds):
            raise FastGSError(f"its degree of spherical harmonics ({degree}) or its precisions ({kinds}) are unknown.")
        types = [np.dtype(DTYPES[kind]) for kind in kinds[:3] + kinds[3:] * TEXTURES[degree]]
        clip = Clip(len(frames), frame_rate(header.get("targetFPS"), 24.0))
        return within(path, clip, np.arange(len(frames)), lambda i: _model(path, frames[i], types, degree))


def _layout(path: Path) -> tuple[dict, list[_Frame]]:
    """The header and the frames' places, checked against the file's length."""
    with open_file(path) as stream:
        length = stream.seek(0, 2)
        stream.seek(len(MAGIC))
        size = int.from_bytes(stream.read(4), "little")
        header = read_table(exactly(stream, size))
        frames, at = [], 8 + size
        for number, entry in enumerate(header.get("frames", ())):
            stream.seek(at)
            block = int.from_bytes(stream.read(4), "little")
            count, width, height = (whole_number(entry.get(key), f"the {key} of its frame {number}")
                                    for key in ("gaussianCount", "textureWidth", "textureHeight"))
            damaged_if(at + 4 + block > length or count > width * height, f"its frame {number} is cut short")
            frames.append(_Frame(at + 4, block, count, width * height))
            at += 4 + block
    damaged_if(not frames, "its header does not say which frames it has")
    return header, frames


def _model(path: Path, frame: _Frame, types: list[np.dtype], degree: int) -> GaussianModel:
    with open_file(path) as stream:
        stream.seek(frame.begin)
        data = unlz4(exactly(stream, frame.length), sum(4 * kind.itemsize * frame.pixels for kind in types))
    at, textures = 0, []
    for kind in types:
        length = 4 * kind.itemsize * frame.pixels
        pixels = data[at:at + length].reshape(4 * kind.itemsize, frame.pixels)[:, :frame.count].T
        textures.append(np.ascontiguousarray(pixels).view(kind).astype(np.float32))
        at += length
    place, turn, size, *colour = textures
    return GaussianModel(
        position=place[:, [1, 2, 0]] * np.array([1, -1, 1], np.float32),
        rotation=turn[:, [3, 1, 2, 0]] * np.array([1, 1, -1, 1], np.float32),
        scale=np.log(size[:, [1, 2, 0]]), opacity=logit(size[:, 3]),
        features=np.concatenate(colour, 1)[:, :3 * (degree + 1) ** 2], appearance=SH(degree))
