# SPDX-License-Identifier: GPL-3.0-or-later
"""The compressed variant of our own file: quantised (quantising.py), in spatial order, each column packed with zlib (columns.py).

It is a safetensors file of uint8 arrays.  `segment.<i>` holds the packed columns of at most SEGMENT Gaussians, one column after another,
and can be read without the other segments.  The metadata's JSON has the keys of an uncompressed file, and

    compressed.count       the number of Gaussians of each segment
    compressed.steps       the step sizes of each segment, see quantising.Steps
    compressed.blocks      for each segment a list of its columns, see columns.Block
"""
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from ..util.tensor_files import TensorFile
from ..util.threads import run
from . import columns
from .description import whole_number
from .quantising import ATTRIBUTES, LARGEST, LIVES, SPREADS, Steps, restored, scales, spread
from .rate import PARTS, Loss, allotted
from .static import plausible_count

SEGMENT = 1 << 16
CONTEXTS = ("shape", "tint", "life")
"""Arrays of one column by which others may be put in order."""
ALLOTTING = 0.9
"""Share of the time of compressing that deciding how finely takes; the rest is packing."""


def packed(model: GaussianModel, loss: Loss, progress: Callable[[float], None]) -> tuple[dict[str, np.ndarray], dict, np.ndarray]:
    """Arrays of bytes by name, the entry of the header, and the bits [M, P] of the model's parts in the new order.

    progress is called with 0..1, and what it raises passes through.
    """
    tensors, counts, listed, steps = {}, [], [], []
    parts = allotted(model, loss, SEGMENT, lambda share: progress(ALLOTTING * share))
    for i, (codes, own) in enumerate(parts):
        data, blocks = packed_segment(codes, own, model)
        tensors[f"segment.{i}"] = np.frombuffer(data, np.uint8)
        counts.append(len(codes["shape"]))
        listed.append(blocks)
        steps.append({key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(own).items()})
        progress(ALLOTTING + (1 - ALLOTTING) * (i + 1) / len(parts))
    bits = np.concatenate([codes[PARTS] for codes, _ in parts]) if parts else model.parts.bits
    return tensors, {"count": counts, "steps": steps, "blocks": listed}, bits


def unpacked(file: TensorFile, about: dict, template: GaussianModel, segments: range | None = None) -> GaussianModel:
    """The model, or that of some segments, of an open file; about: the header's entry, template: a model of its kinds.

    Segments are unpacked side by side.  Raises FastGSError for a damaged file.
    """
    parts, total = [], 0
    for data, count, steps, blocks in listed_segments(file, about, segments):
        parts.append((data, count, _steps(steps, template), blocks, total))
        total += count
    arrays: dict[str, Any] = {name: np.empty(shape, np.float32) for name, shape in template.shapes(total).items()}
    run(partial(_segment, template, arrays), parts)
    return replace(template, **arrays)


def listed_segments(file: TensorFile, about: dict, segments: range | None = None) -> Iterator[tuple[np.ndarray, int, object, object]]:
    """(bytes uint8, number of Gaussians, its steps, its blocks) of each segment, or of some; the last two are as the header has them.

    Raises FastGSError where the header does not say which segments there are, or they are not there.
    """
    lists: list[Any] = [about.get(key) if isinstance(about, dict) else None for key in ("count", "steps", "blocks")]
    if not all(isinstance(v, list) for v in lists) or len(set(map(len, lists))) > 1:
        raise FastGSError("its header does not say which segments it has; copy the file again.")
    counts, steps, blocks = lists
    for i in range(len(counts)) if segments is None else segments:
        count = whole_number(counts[i], "the number of Gaussians of a segment")
        if count > SEGMENT:
            raise FastGSError(f"its segment {i} would have {count} Gaussians, more than a segment may have; copy the file again.")
        data = file.read(f"segment.{i}")
        if data.dtype != np.uint8 or data.ndim != 1:
            raise FastGSError(f"its segment {i} holds no bytes; copy the file again.")
        plausible_count(count, len(data))
        yield data, count, steps[i], blocks[i]


def _segment(template: GaussianModel, arrays: dict[str, np.ndarray], data: np.ndarray, count: int, steps: Steps, blocks: object,
             first: int) -> None:
    """Unpack a segment into the model's arrays, from row `first` on."""
    shapes = columns_of(template)
    if not isinstance(blocks, list) or len(blocks) != sum(int(np.prod(shape, dtype=int)) for shape in shapes.values()):
        raise FastGSError("a segment of it lists other columns than its model has; copy the file again.")
    order, codes, at, listed = columns.Order(), {}, 0, iter(blocks)
    for name, shape in shapes.items():
        width = int(np.prod(shape, dtype=int))
        flat = np.empty((width, count), np.int32)
        order.follow(None)
        for k in range(width):
            block = columns.Block.checked(next(listed), f"{name}/{k}", order)
            if not 0 <= block.size <= len(data) - at:
                raise FastGSError(f"its header does not say where the column {name}/{k} of a segment lies; copy the file again.")
            flat[k] = columns.unpacked(data[at:at + block.size].data, block, count, order)
            order.follow(flat[k] - block.centre)
            at += block.size
        codes[name] = np.moveaxis(flat.reshape((*shape, count)), -1, 0)
        order.columns |= contexts(name, codes, steps)
    with np.errstate(all="ignore"):
        for name, array in restored(codes, steps, template).items():
            arrays[name][first:first + count] = array


def columns_of(template: GaussianModel) -> dict[str, tuple[int, ...]]:
    """The columns of a segment, in the order in which they are packed, and the shape of each Gaussian's row."""
    four = template.rotation_basis.terms and not template.rotation_basis.centred
    shapes: dict[str, tuple[int, ...]] = {
        "shape": (), "tint": (), "life": (), "scale": (3,), "opacity": (), "features": (template.appearance.width,), "mu_tau": (),
        "motion": (template.basis.terms, 3), "position": (3,), "rotation_motion": (template.rotation_basis.terms, 4),
        "rotation": (4 if four else 3,)}
    for k, logarithm in enumerate(template.temporal_kind.logarithms):
        shapes |= {f"temporal.{k}": ()} if logarithm else {f"temporal.{k}.high": (), f"temporal.{k}.low": ()}
    return shapes


def packed_segment(codes: dict[str, np.ndarray], steps: Steps, template: GaussianModel) -> tuple[bytes, list[list]]:
    """The packed columns of a segment, and what its header says of them."""
    order, data, blocks = columns.Order(), b"", []
    for name in columns_of(template):
        order.follow(None)
        rows = codes[name]
        for k, column in enumerate(rows.reshape(len(rows), int(np.prod(rows.shape[1:], dtype=int))).T):
            part, block = columns.packed(f"{name}/{k}", column, order)
            data += part
            blocks.append(block.listed())
            order.follow(column - block.centre)
        order.columns |= contexts(name, codes, steps)
    return data, blocks


def contexts(name: str, codes: dict[str, np.ndarray], steps: Steps) -> dict[str, np.ndarray]:
    """By what other columns may be put in order once an array's columns are known."""
    if name == "scale":
        scale = scales(codes, steps)
        return {"grain": steps.grain(scale, codes["shape"]), "spread": spread(scale)}
    return {name: codes[name]} if name in CONTEXTS else {}


def _steps(stated: object, template: GaussianModel) -> Steps:
    """The steps of a segment; raises FastGSError unless all are numbers of the right shapes within reason."""
    values: Any = stated if isinstance(stated, dict) else {}
    tables = {}
    for name, shape in (("turn", (SPREADS,)), ("motion", (LIVES, template.basis.terms)), ("swing", (LIVES, template.rotation_basis.terms))):
        table = np.array(values.get(name), dtype=object)
        if table.shape != shape or not all(type(v) is int and abs(v) <= LARGEST for v in table.ravel()):
            raise FastGSError(f"its header does not say how finely a segment is kept ({name}); copy the file again.")
        tables[name] = table.astype(int)
    base, tint, least = values.get("base"), values.get("tint"), values.get("least")
    width = template.appearance.width
    good = isinstance(base, dict) and isinstance(tint, list) and len(tint) == width and type(least) is int and abs(least) <= 200
    steps = (*(base.get(name) for name in ATTRIBUTES), *tint) if good else ()
    if not good or not all(isinstance(step, float) and 2.0**-LARGEST <= step <= 2.0**LARGEST for step in steps):
        raise FastGSError("its header does not say how finely the numbers of a segment are kept; copy the file again.")
    chained, paired = values.get("chained"), values.get("paired")
    good = isinstance(chained, list) and all(isinstance(name, str) for name in chained) and isinstance(paired, list)
    if not good or not all(isinstance(p, list) and len(p) == 2 and all(type(k) is int and 0 <= k < width for k in p) for p in paired):
        raise FastGSError("its header does not say which columns of a segment are differences; copy the file again.")
    if {k for k, _ in paired} & {other for _, other in paired}:
        raise FastGSError("its header says of a column that it is a difference from one that is a difference itself; copy the file again.")
    return Steps({name: float(base[name]) for name in ATTRIBUTES}, np.array(tint, float), tables["turn"], tables["motion"], tables["swing"],
                 chained, [(k, other) for k, other in paired], least)
