# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads version 2 of the compressed variant of our own file; compressed.py writes version 3, which is smaller.

`segment.<i>` holds the packed columns of as many Gaussians as in version 3, each a zstd frame of its whole numbers (zigzag: 0, -1, 1,
-2, ...), first all lowest bytes, then all second ones, and so on.  Every number times a power of two is a value of the model;
docs/file-format.md has the exponents, which follow from three whole numbers of each Gaussian:

    grain    log2 of the step of its position
    weight   log2 of its share of pictures relative to a typical Gaussian's
    life     -log2 of the length of its lifetime
"""
from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from ..util.tensor_files import TensorFile
from ..util.threads import thread_count
from .compressed import listed_segments

LIVES = 10
"""Values of `life`."""
NEIGHBOURS = 64
"""Gaussians whose positions are counted from one anchor."""
BOUNDS = {"scale": (-6, -1), "rotation": (-9, -1), "opacity": (-9, -4), "features": (-9, -1), "temporal": (-5, 1), "mu_tau": (-7, 0)}
"""log2 of the least and greatest step."""


@dataclass(frozen=True)
class Steps:
    """The exponents of the step sizes (powers of two) that a file stores beside the whole numbers.

    base      {array: exponent at weight 0}
    motion    [LIVES, K] of the motion's coefficients relative to the grain
    turn      [LIVES, R] of the rotation's relative to the rotation's own step
    features  [F] added to the exponent of each column
    """

    base: dict[str, int]
    motion: np.ndarray
    turn: np.ndarray
    features: np.ndarray

    def of(self, name: str, weight: np.ndarray) -> np.ndarray:
        """Exponents [N] of an array's steps."""
        return np.clip(self.base[name] - weight, *BOUNDS[name])


def unpacked(file: TensorFile, about: dict, kinds: GaussianModel, segments: range | None = None) -> GaussianModel:
    """The model, or that of some segments, of an open file; about: the header's entry, kinds: a model of its kinds.

    Segments are unpacked side by side.  Raises FastGSError for a damaged file.
    """
    parts = [(data.tobytes(), count, _steps(steps, kinds), blocks)
             for data, count, steps, blocks in listed_segments(file, about, segments)]
    with ThreadPoolExecutor(max(1, min(len(parts), thread_count()))) as pool:
        arrays = list(pool.map(lambda part: _segment(*part, kinds), parts))
    if not arrays:
        return kinds
    return replace(kinds, **{name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]})


def _segment(data: bytes, count: int, steps: Steps, blocks, kinds: GaussianModel) -> dict[str, np.ndarray]:
    columns, at = {}, 0
    shapes = _shapes(kinds, count, blocks)
    if not isinstance(blocks, list) or len(blocks) != sum(int(np.prod(shape[1:], dtype=int)) for shape in shapes.values()):
        raise FastGSError("a segment of it lists other columns than its model has; copy the file again.")
    listed = iter(blocks)
    for name, shape in shapes.items():
        codes = np.empty((shape[0], int(np.prod(shape[1:], dtype=int))), np.int32)
        for k in range(codes.shape[1]):
            block = next(listed)
            good = isinstance(block, list) and len(block) == 4 and block[0] == f"{name}/{k}" and all(type(v) is int for v in block[1:])
            if not good or not 0 <= block[1] <= len(data) - at or not 1 <= block[2] <= 4:
                raise FastGSError(f"its header does not say where the column {name}/{k} of a segment lies; copy the file again.")
            part = data[at:at + block[1]]
            at += block[1]
            if zlib.crc32(part) != block[3]:
                raise FastGSError(f"the column {name}/{k} of a segment is damaged (its checksum is another); copy the file again.")
            codes[:, k] = _numbers(part, shape[0], block[2])
        columns[name] = codes.reshape(shape)
    with np.errstate(all="ignore"):
        return {name: np.ascontiguousarray(array, np.float32) for name, array in restored(columns, steps, kinds).items()}


def _shapes(kinds: GaussianModel, count: int, blocks) -> dict[str, tuple[int, ...]]:
    """The shapes of a segment's columns, in the order in which they are packed."""
    four = any(isinstance(block, list) and block[:1] == ["rotation/3"] for block in blocks) if isinstance(blocks, list) else False
    return {
        "grain": (count,), "weight": (count,), "life": (count,), "mu_tau": (count,), "motion": (count, kinds.basis.terms, 3),
        "anchor": (-(-count // NEIGHBOURS), 3), "position": (count, 3), "scale": (count, 3),
        "rotation_motion": (count, kinds.rotation_basis.terms, 4), "rotation": (count, 4 if four else 3), "opacity": (count,),
        "features": (count, kinds.appearance.width), **{f"temporal.{k}": (count,) for k in range(kinds.temporal_kind.width)}}


def _numbers(part: bytes, count: int, width: int) -> np.ndarray:
    """The whole numbers of a packed column; nothing is allocated on the word of the packed bytes."""
    import zstandard

    try:
        if zstandard.get_frame_parameters(part).content_size != count * width:
            raise FastGSError("a column of a segment holds another number of Gaussians than its header says; copy the file again.")
        raw = zstandard.ZstdDecompressor().decompress(part)
    except zstandard.ZstdError as error:
        raise FastGSError("a column of a segment cannot be unpacked; copy the file again.") from error
    if len(raw) != count * width:
        raise FastGSError("a column of a segment is cut short; copy the file again.")
    values = np.zeros((count, 4), np.uint8)
    values[:, :width] = np.frombuffer(raw, np.uint8).reshape(width, count).T
    zigzag = values.reshape(-1).view("<u4")
    return ((zigzag >> 1) ^ (0 - (zigzag & 1))).view(np.int32)


def _steps(values, kinds: GaussianModel) -> Steps:
    """The steps of a segment; raises FastGSError unless all are small whole numbers of the right shapes."""
    shapes = {"motion": (LIVES, kinds.basis.terms), "turn": (LIVES, kinds.rotation_basis.terms), "features": (kinds.appearance.width,)}
    found = {}
    for name, shape in shapes.items():
        table = np.array(values[name] if isinstance(values, dict) and name in values else None, dtype=object)
        if table.shape != shape or not all(type(v) is int and abs(v) <= 64 for v in table.ravel()):
            raise FastGSError(f"its header does not say how finely the {name} of a segment is kept; copy the file again.")
        found[name] = table.astype(int)
    base = values.get("base")
    names = ("position", "scale", "rotation", "opacity", "features", "temporal", "mu_tau")
    if not isinstance(base, dict) or not all(type(base.get(name)) is int and abs(base[name]) <= 64 for name in names):
        raise FastGSError("its header does not say how finely its arrays are kept; copy the file again.")
    return Steps({name: base[name] for name in names}, **found)


def restored(columns: dict[str, np.ndarray], steps: Steps, kinds: GaussianModel) -> dict[str, np.ndarray]:
    """The arrays of a model, float32, of columns of whole numbers; kinds: a model of its kinds."""
    weight, life, grain = (columns[name].astype(np.int32) for name in ("weight", "life", "grain"))
    life = np.clip(life, 0, LIVES - 1)
    fine = turning(columns, steps)
    rotation = _scaled(columns["rotation"], fine[:, None])
    if rotation.shape[1] == 3:
        real = np.sqrt(np.maximum(0.02, 1 - (rotation.astype(np.float64) ** 2).sum(1)))
        rotation = np.concatenate([real[:, None], rotation], 1)
    anchor = np.repeat(columns["anchor"].astype("<i4").view("<f4"), NEIGHBOURS, axis=0)[:len(weight)]
    opacity = np.clip(_scaled(columns["opacity"], steps.of("opacity", weight)), 1e-3, 1 - 1e-3)
    arrays = {
        "position": anchor + _scaled(columns["position"], grain[:, None]),
        "motion": _scaled(columns["motion"], (grain[:, None] + steps.motion[life])[..., None]),
        "scale": _scaled(columns["scale"], steps.of("scale", weight)[:, None]),
        "rotation": rotation,
        "rotation_motion": _scaled(columns["rotation_motion"], (fine[:, None] + steps.turn[life])[..., None]),
        "opacity": np.log(opacity) - np.log1p(-opacity),
        "features": _scaled(columns["features"], steps.of("features", weight)[:, None] + steps.features),
        "mu_tau": _scaled(columns["mu_tau"], steps.of("mu_tau", weight) - life),
    }
    arrays["temporal"] = np.empty((len(weight), kinds.temporal_kind.width), np.float32)
    for k, logarithm in enumerate(kinds.temporal_kind.logarithms):
        column = columns[f"temporal.{k}"]
        arrays["temporal"][:, k] = _scaled(column, steps.of("temporal", weight)) if logarithm else column.astype("<i4").view("<f4")
    return arrays


def turning(columns: dict[str, np.ndarray], steps: Steps) -> np.ndarray:
    """Exponents [N] of rotations' steps: a Gaussian that is nearly round may be turned more."""
    codes, weight = columns["scale"].astype(np.int64), columns["weight"].astype(np.int64)
    spread = np.ldexp((codes.max(1) - codes.min(1)).astype(np.float64), steps.of("scale", weight))  # ln of longest over shortest
    return steps.of("rotation", weight) - np.clip(np.frexp(spread)[1], -2, 2)


def _scaled(codes: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """codes x 2^exponent as float32."""
    powers = ((np.clip(exponent, -120, 120) + 127).astype(np.int32) << 23).view(np.float32)  # the bits of 2^exponent
    return codes.astype(np.float32) * powers
