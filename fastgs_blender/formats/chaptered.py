# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in one file of our own format (model/chapters.py): read piece by piece, when a chapter is shown.  docs/file-format.md.

The header's `chapters` and `pieces` list both in order.  Arrays of a piece have the names of a model's, after "piece.<number>.".
"""
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..model.chapters import Chapter, Chapters, Piece
from ..model.gaussians import GaussianModel
from ..model.joining import same_appearance
from ..util.arguments import finite
from ..util.errors import FastGSError
from ..util.identity import status_of
from ..util.reading import damaged_if, open_file, reading
from ..util.tensor_files import TensorFile, streamed_tensors
from .base import generator, usable
from .description import KINDS, describe, understand, whole_number, without_gaussians
from .native_arrays import arrays_of, decoder_of, read_model, with_decoder
from .rate import Loss

VERSION = 4
"""Of the format, for files with chapters."""
PIECE, CHAPTER = "piece.{}.", "chapter.{}."
"""What the names of their arrays begin with."""


def opened(path: Path, file: TensorFile, about: dict, template: GaussianModel) -> Chapters:
    """The clip in an open file; about: the header, template: a model of its kinds.  Raises FastGSError for a damaged one."""
    listed, pieces = about.get("chapters"), about.get("pieces")
    damaged_if(not isinstance(listed, list) or not listed or not isinstance(pieces, list), "its header lists no chapters and pieces")
    assert isinstance(listed, list) and isinstance(pieces, list)
    template = with_decoder(file, template)
    chapters = [_chapter(file, i, values, template) for i, values in enumerate(listed)]
    begins = [chapter.begin for chapter in chapters]
    damaged_if(begins[0] != 0 or (np.diff(begins) <= 0).any() or begins[-1] >= template.clip.frame_count, "its chapters are not in order")
    state = status_of(str(path))
    found = [_piece(path, state, file, k, values, chapters) for k, values in enumerate(pieces)]
    return Chapters(template.clip, chapters, found, lambda: status_of(str(path)), str(path))


def _chapter(file: TensorFile, i: int, values: object, template: GaussianModel) -> Chapter:
    damaged_if(not isinstance(values, dict), "its header does not say what a chapter is")
    assert isinstance(values, dict)
    begin, time = whole_number(values.get("begin"), "the first frame of a chapter"), values.get("time", [0.0, 1.0])
    good = isinstance(time, list) and len(time) == 2 and all(isinstance(v, (int, float)) and finite(v) for v in time)
    damaged_if(not good or not 0 <= time[0] <= 1 or not 1e-9 <= time[1] <= 1, "its header does not say when a chapter is")
    own = _changed(template, values.get("model", {}))
    if isinstance(values.get("model"), dict) and "appearance" in values["model"]:
        own = with_decoder(file.below(CHAPTER.format(i)), own)
    return Chapter(begin, own, (float(time[0]), float(time[1])))


def _piece(path: Path, state: object, file: TensorFile, k: int, values: object, chapters: list[Chapter]) -> Piece:
    damaged_if(not isinstance(values, dict), "its header does not say what a piece is")
    assert isinstance(values, dict)
    first, count, size = (whole_number(values.get(key), f"the {key} of a piece") for key in ("first", "count", "gaussians"))
    damaged_if(not (count and first + count <= len(chapters)), "a piece of it belongs to chapters that it has not")
    template = chapters[first].template
    own = _changed(template, values.get("model", {}))
    own = replace(own, appearance=template.appearance) if own is not template else own

    def read() -> GaussianModel:
        with reading(path), np.errstate(all="ignore"), open_file(path) as stream:
            if status_of(str(path)) != state:
                raise FastGSError(f"{path} has changed since it was opened; open it again.")
            model = read_model(replace(file.below(PIECE.format(k)), stream=stream), values, own)
            damaged_if(len(model) != size, "a piece of it has another number of Gaussians than its header says")
            return usable(model, path)

    return Piece(first, count, size, read)


def _changed(template: GaussianModel, values: Any) -> GaussianModel:
    """The template with the kinds that a part of the header changes; the same object where it changes none."""
    return without_gaussians({name: getattr(template, name) for name in KINDS} | understand(values)) if values else template


def write(source: Chapters, path: Path, loss: Loss | None, fit: Callable[[GaussianModel], GaussianModel],
          progress: Callable[[float], None]) -> None:
    """Write a clip, one piece after another; fit(model) is what can be written of a piece."""
    first = source.chapters[0].template
    whole = replace(first, clip=source.clip, surroundings=source.surroundings, provenance=source.provenance)
    common = describe(whole)
    listed, pieces = [], []
    described = {first: describe(first)}
    with streamed_tensors(path) as (add, metadata):
        for name, array in decoder_of(whole).items():
            add(name, array)
        for i, chapter in enumerate(source.chapters):
            if chapter.template not in described:
                described[chapter.template] = describe(chapter.template)
            values = _differing(described[chapter.template], common)
            if not same_appearance(chapter.template.appearance, whole.appearance):
                values["appearance"] = described[chapter.template]["appearance"]
                for name, array in decoder_of(chapter.template).items():
                    add(CHAPTER.format(i) + name, array)
            time = {} if chapter.time == (0.0, 1.0) else {"time": list(chapter.time)}
            listed.append({"begin": chapter.begin, **time, **_model(values)})
        for k, piece in enumerate(source.pieces):
            model = fit(piece.read())
            own = loss and replace(loss, span=_span(source, piece), share=piece.size / max(_sizes(source, piece)))
            tensors, entries = arrays_of(model, own, partial(_share, progress, k, len(source.pieces)))
            for name, array in tensors.items():
                add(PIECE.format(k) + name, array)
            template = source.chapters[piece.first].template
            values = {key: value for key, value in _differing(describe(model), described[template]).items()
                      if key in ("basis", "rotation_basis", "temporal")}
            size = sum(entries["compressed"]["count"]) if loss else len(model)
            pieces.append({"first": piece.first, "count": piece.count, "gaussians": size, **entries, **_model(values)})
            progress((k + 1) / len(source.pieces))
        about = {"version": VERSION, "generator": generator(), "model": common, "chapters": listed, "pieces": pieces}
        metadata["fast-gs"] = json.dumps(about, allow_nan=False)


def _span(source: Chapters, piece: Piece) -> tuple[float, float]:
    """When a piece is shown, in its own time."""
    begin, length = source.chapters[piece.first].time
    edges = [chapter.begin for chapter in source.chapters] + [source.clip.frame_count]
    low, high = (source.clip.t_of_frame(edges[i]) for i in (piece.first, piece.first + piece.count))
    return max((low - begin) / length, 0.0), min((high - begin) / length, 1.0)


def _sizes(source: Chapters, piece: Piece) -> list[int]:
    """The Gaussians of each chapter that shows a piece."""
    return [sum(source.pieces[k].size for k in source.shown(i)) for i in range(piece.first, piece.first + piece.count)]


def _share(progress: Callable[[float], None], done: int, number: int, share: float) -> None:
    progress((done + share) / number)


def _model(values: dict) -> dict:
    return {"model": values} if values else {}


def _differing(values: dict, common: dict) -> dict:
    return {key: value for key, value in values.items() if value != common.get(key)}
