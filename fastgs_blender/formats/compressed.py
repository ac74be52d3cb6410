# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: quantised (quantising.py), in spatial order, each column packed with zstd.

It is a safetensors file of bytes.  `segment.<i>` holds SEGMENT Gaussians and can be read without the others: the packed columns one
after another, each a zstd frame of its whole numbers (zigzag: 0, -1, 1, -2, ...), first all lowest bytes, then all second ones, and so on.
The metadata's JSON says, beside what an uncompressed file says,

    compressed.count       Gaussians of each segment
    compressed.steps       exponents of the steps, see quantising.Steps
    compressed.blocks      for each segment [column, bytes packed, bytes of a number, CRC-32 of what is packed], ...
"""
from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from ..util.tensor_files import TensorFile
from ..util.threads import thread_count
from .description import whole_number
from .quantising import LIVES, NEIGHBOURS, Steps, quantised, restored
from .static import morton_order, plausible_count

SEGMENT = 1 << 16
LEVEL = 19
"""Of zstd: slow to pack, and as fast as any other to unpack."""
MOST = 1 << 31


def packed(model: GaussianModel, fineness: float) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays of bytes by name, and the entry of the header."""
    import zstandard

    model = model.take(morton_order(model.position))
    tensors, counts, listed, steps = {}, [], [], []
    for i, start in enumerate(range(0, len(model), SEGMENT)):
        columns, own = quantised(model.take(slice(start, start + SEGMENT)), fineness)
        data, blocks = b"", []
        for name, codes in columns.items():
            for k, column in enumerate(_flat(codes).T):
                raw, width = _planes(column)
                block = zstandard.ZstdCompressor(level=LEVEL).compress(raw)
                blocks.append([f"{name}/{k}", len(block), width, zlib.crc32(block)])
                data += block
        tensors[f"segment.{i}"] = np.frombuffer(data, np.uint8)
        counts.append(len(columns["weight"]))
        listed.append(blocks)
        steps.append({key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(own).items()})
    return tensors, {"count": counts, "steps": steps, "blocks": listed}


def unpacked(file: TensorFile, about: dict, kinds: GaussianModel, segments: range | None = None) -> GaussianModel:
    """The model, or that of some segments, of an open file; about: the header's entry, kinds: a model of its kinds.

    Segments are unpacked side by side.  Raises FastGSError for a damaged file.
    """
    counts, steps, blocks = (about.get(key) if isinstance(about, dict) else None for key in ("count", "steps", "blocks"))
    if not all(isinstance(v, list) for v in (counts, steps, blocks)) or not len(counts) == len(steps) == len(blocks):
        raise FastGSError("its header does not say which segments it has; copy the file again.")
    wanted = range(len(counts)) if segments is None else segments
    parts = []
    for i in wanted:
        count = whole_number(counts[i], "the number of Gaussians of a segment")
        if count > SEGMENT:
            raise FastGSError(f"its segment {i} would have {count} Gaussians, more than a segment may have; copy the file again.")
        data = file.read(f"segment.{i}")
        if data.dtype != np.uint8 or data.ndim != 1:
            raise FastGSError(f"its segment {i} holds no bytes; copy the file again.")
        plausible_count(count, len(data))
        parts.append((data.tobytes(), count, _steps(steps[i], kinds), blocks[i]))
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


def _flat(codes: np.ndarray) -> np.ndarray:
    return codes.reshape(len(codes), int(np.prod(codes.shape[1:], dtype=int)))


def _planes(codes: np.ndarray) -> tuple[bytes, int]:
    """The bytes of a column of whole numbers, lowest first, and how many bytes a number has."""
    codes = np.clip(codes, -MOST, MOST - 1)
    zigzag = ((codes << 1) ^ (codes >> 63)).astype(np.uint32)
    width = max(1, (int(zigzag.max(initial=0)).bit_length() + 7) // 8)
    return zigzag.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :width].T.tobytes(), width


def _numbers(part: bytes, count: int, width: int) -> np.ndarray:
    """The inverse of _planes() after unpacking; nothing is allocated on the word of the packed bytes."""
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
