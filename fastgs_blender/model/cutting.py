# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes clips in chapters (chapters.py): of one long model, or of several models one after another.

Each Gaussian lies in one piece, the shortest that holds all its life, so that pictures are those of the whole model.  What stands still
in several models that follow each other is kept once.
"""
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..util.arguments import real
from ..util.errors import FastGSError
from .appearance import Changing, Features, momentary
from .chapters import Chapter, Chapters, Piece
from .gaussians import Clip, GaussianModel
from .joining import same_appearance
from .motion import Static
from .slicing import sigmoid
from .temporal import Always

FRAMES = 60
"""Of a chapter, unless told."""
PAD = 1.0
"""Frames beside a chapter whose Gaussians it holds too: a shutter that is open across a seam sees them."""
BRIGHTEST = 100.0
"""The highest factor of opacity that an object's look may have: with it a Gaussian is seen for longer."""
LASTING = 1e-6
"""A Gaussian whose opacity changes by less than this in its clip is always there."""


def chapters(*models: GaussianModel | Chapters, frames: float = FRAMES) -> Chapters:
    """A long clip in chapters of so many frames, of which only what is shown is in memory: that of one model, or of several models one
    after another.

    The frame rate is the first one's.  Each model keeps its motion and its duration, and they change over at once, between two frames.
    Gaussians that stand still and are the same in models that follow each other are kept once.  save() writes such a clip into one file.
    Raises FastGSError without a model, and where their axes or colour spaces differ.

    Example:
        fg.save(fg.chapters(model, model, frames=30), "twice.safetensors")
    """
    if not models or not all(isinstance(model, (GaussianModel, Chapters)) for model in models):
        raise FastGSError("chapters() wants models, as fg.load(path) reads them, or clips in chapters.")
    sources = [model if isinstance(model, Chapters) else cut(model, frames) for model in models]
    first = sources[0]
    if len(sources) == 1:
        return first
    if any((source.axes, source.colour_space) != (first.axes, first.colour_space) for source in sources):
        raise FastGSError("the models cannot follow each other: their axes or colour spaces differ; turn them with fastgs convert first.")
    lengths = [max(round(source.clip.frame_count * first.clip.fps / source.clip.fps), len(source.chapters)) for source in sources]
    clip = replace(first.clip, frame_count=sum(lengths))
    found: list[Chapter] = []
    offsets = []
    for source, length, begin in zip(sources, lengths, np.cumsum([0, *lengths[:-1]]).tolist(), strict=True):
        offsets.append(len(found))
        share = length / source.clip.frame_count
        for i, chapter in enumerate(source.chapters):
            at, long = chapter.time
            time = (begin + at * length) / clip.frame_count, long * length / clip.frame_count
            found.append(Chapter(begin + max(int(chapter.begin * share), i), chapter.template, time))
    pieces = []
    for piece in _shared(sources):
        last = piece.first + piece.count - 1
        begin = offsets[piece.first]
        pieces.append(replace(piece, first=begin, count=offsets[last] + len(sources[last].chapters) - begin))
    for source, offset in zip(sources, offsets, strict=True):
        pieces += [replace(piece, first=piece.first + offset) for piece in source.pieces if piece is not _standing(source)]
    return Chapters(clip, found, pieces, about=first.about)


def _standing(source: Chapters) -> Piece | None:
    """The piece that may hold what other clips hold as well: the first that all chapters show."""
    return next((piece for piece in source.pieces if piece.count == len(source.chapters)), None)


def _shared(sources: list[Chapters]) -> Iterator[Piece]:
    """The Gaussians of the standing pieces, each once for a run of sources that have it.  A piece's first and count are of sources."""
    before, begun, current = None, np.zeros(0, int), None
    for s, source in enumerate([*sources, None]):
        piece = None if source is None else _standing(source)
        model = None if piece is None else piece.read()
        same = np.full(0 if model is None else len(model), -1)
        if before is not None and model is not None:
            same = same_rows(before, model)
        if current is not None:
            ending = np.setdiff1d(np.arange(current.size), same)
            for first in np.unique(begun[ending]).tolist():
                rows = ending[begun[ending] == first]
                yield Piece(first, s - first, len(rows), _Rows(current, rows, s - first > 1))
        begun = np.where(same >= 0, begun[same] if len(begun) else s, s)
        before, current = model, piece


@dataclass(frozen=True, eq=False)
class _Rows:
    """Reads some Gaussians of a piece; always: they never fade, in whatever time."""

    piece: Piece
    rows: np.ndarray
    always: bool

    def __call__(self) -> GaussianModel:
        part = self.piece.read().take(self.rows)
        return replace(part, temporal=np.zeros((len(part), 0)), temporal_kind=Always()) if self.always else part


def same_rows(a: GaussianModel, b: GaussianModel) -> np.ndarray:
    """For each Gaussian of b [N] the number of one of a that looks the same at all times, each once; -1 where there is none."""
    none = np.full(len(b), -1)
    constants = ("raster", "axes", "colour_space")
    if not same_appearance(a.appearance, b.appearance) or any(getattr(a, name) != getattr(b, name) for name in constants) or not len(a):
        return none
    if a.parts.names != b.parts.names or not all(isinstance(m.basis, Static) and isinstance(m.rotation_basis, Static) for m in (a, b)):
        return none
    rows = [np.concatenate([m.position, m.rotation, m.scale, m.opacity[:, None], m.features, m.parts.bits.reshape(len(m), -1)], 1,
                           dtype=np.float32) for m in (a, b)]
    keys = [_keys(values) for values in rows]
    order = np.argsort(keys[0])
    found = order[np.minimum(np.searchsorted(keys[0][order], keys[1]), len(a) - 1)]
    same = (rows[0][found] == rows[1]).all(1) & _lasts(a)[found] & _lasts(b) & (keys[0][found] == keys[1])
    return np.where(same, found, -1)


def _keys(rows: np.ndarray) -> np.ndarray:
    """A number for each row [N] uint64 that tells it from others, and from the rows before it that are the same."""
    factors = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)
    keys = np.zeros(len(rows), np.uint64)
    for column, factor in zip(rows.view(np.uint32).T, factors, strict=True):
        keys = (keys ^ column) * factor
        keys ^= keys >> np.uint64(29)
    order = np.argsort(keys, kind="stable")
    begins = np.searchsorted(keys[order], keys[order])
    keys[order] += (np.arange(len(rows)) - begins).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return keys


def _lasts(model: GaussianModel) -> np.ndarray:
    """Which Gaussians [N] are the same at all times of the model's clip; they do not move."""
    kind, appearance = model.temporal_kind, model.appearance
    good = np.min([kind.factor(t, model.mu_tau, model.temporal) for t in (0.0, 1.0)], 0) > 1 - LASTING
    first = 6 if isinstance(appearance, Features) else momentary(appearance).width
    return good & ~model.features[:, first:].any(1)


def cut(model: GaussianModel, frames: float = FRAMES, about: str = "the clip") -> Chapters:
    """The clip of a model in chapters of so many frames.  The model is not copied.

    Where a basis of time has a table that is as long as the clip (Keyframes), what moves goes into each chapter that shows it, with that
    chapter's part of the table.
    """
    length = int(real(frames, "the frames of a chapter", 1))
    begins = np.arange(0, model.clip.frame_count, length)
    count = len(begins)
    first, last = _lives(model, begins)
    still = ~(_moves(model.motion) | _moves(model.rotation_motion))
    template = model.take(slice(0, 0))
    spans = [_span(model.clip, float(begin), length) for begin in begins]
    cuts = [_within(template, span) for span in spans]
    own = any(short is not template for short in cuts)
    if isinstance(model.appearance, Changing) and own:
        still[:] = False
    first_of, count_of = _homes(first, last, count)
    pieces = []
    for home in sorted({(-int(n), int(a)) for a, n in zip(first_of, count_of, strict=True)}):
        here = (first_of == home[1]) & (count_of == -home[0])
        for stands in (True, False):
            rows = np.flatnonzero(here & (still == stands))
            if len(rows) and (stands or not own):
                pieces.append(Piece(home[1], -home[0], len(rows), partial(_part, model, rows, stands)))
    for i, (short, span) in enumerate(zip(cuts, spans, strict=True) if own else ()):
        rows = np.flatnonzero(~still & (first <= i) & (i <= last))
        if len(rows):
            pieces.append(Piece(i, 1, len(rows), partial(_shortened, model, rows, short, span)))
    return Chapters(model.clip, [Chapter(int(begin), short) for begin, short in zip(begins, cuts, strict=True)], pieces, about=about)


def _moves(coefficients: np.ndarray) -> np.ndarray:
    return coefficients.any(axis=tuple(range(1, coefficients.ndim)))


def _lives(model: GaussianModel, begins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last chapter [N] that shows each Gaussian."""
    count = len(begins)
    if isinstance(model.temporal_kind, Always) or count == 1:
        return np.zeros(len(model), int), np.full(len(model), count - 1)
    with np.errstate(all="ignore"):
        visible = np.maximum(np.log(sigmoid(model.opacity) * (BRIGHTEST / model.raster.alpha_cut)), 0)
        life = model.temporal_kind.span(visible, model.mu_tau.astype(np.float64), model.temporal)
    seams, pad = begins[1:] / model.clip.frame_count, PAD / model.clip.frame_count
    first = np.searchsorted(seams + pad, life.begin, side="left")
    return first, np.maximum(np.searchsorted(seams - pad, life.end, side="right"), first)


def _homes(first: np.ndarray, last: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first chapter and the number of chapters [N] of the piece for what is shown from the chapters `first` to `last` [N].

    Pieces are 1, 2, 4, 8 ... chapters long.  They begin at each multiple of half of their length, so no life is far shorter than its piece.
    """
    begin, length = first.copy(), np.ones_like(first)
    size = 2
    while (larger := last >= begin + length).any():
        begin[larger] = first[larger] // (size // 2) * (size // 2)
        length[larger] = size
        size *= 2
    everything = length >= count
    begin[everything] = 0
    return begin, np.minimum(length, count - begin)


def _part(model: GaussianModel, rows: np.ndarray, stands: bool) -> GaussianModel:
    """Some of the Gaussians; of what stands still without motion that is 0."""
    part = model.take(rows)
    if not stands:
        return part
    return replace(part, motion=np.zeros((len(rows), 0, 3)), rotation_motion=np.zeros((len(rows), 0, 4)), basis=Static(),
                   rotation_basis=Static())


def _span(clip: Clip, begin: float, length: int) -> tuple[float, float]:
    """The times that a chapter of so many frames shows."""
    return clip.t_of_frame(begin - PAD), clip.t_of_frame(begin + length + PAD)


def _within(template: GaussianModel, span: tuple[float, float]) -> GaussianModel:
    """The template of what a span of times shows; the same object where none has a long table."""
    moving, turning = (basis.within(*span)[0] for basis in (template.basis, template.rotation_basis))
    appearance = template.appearance
    if isinstance(appearance, Changing):
        appearance = replace(appearance, basis=appearance.basis.within(*span)[0])
    if (moving, turning, appearance) == (template.basis, template.rotation_basis, template.appearance):
        return template
    return replace(template, basis=moving, rotation_basis=turning, appearance=appearance, motion=np.zeros((0, moving.terms, 3)),
                   rotation_motion=np.zeros((0, turning.terms, 4)), features=np.zeros((0, appearance.width)))


def _shortened(model: GaussianModel, rows: np.ndarray, template: GaussianModel, span: tuple[float, float]) -> GaussianModel:
    """Some of the Gaussians with the part of each long table that _within() left."""
    part, appearance = model.take(rows), model.appearance
    features = part.features
    if isinstance(appearance, Changing):
        width = appearance.look.width
        table = features[:, width:].reshape(len(rows), appearance.basis.terms, width)[:, appearance.basis.within(*span)[1]]
        features = np.concatenate([features[:, :width], table.reshape(len(rows), -1)], 1)
    return replace(part, motion=part.motion[:, model.basis.within(*span)[1]], basis=template.basis, rotation_basis=template.rotation_basis,
                   rotation_motion=part.rotation_motion[:, model.rotation_basis.within(*span)[1]], features=features,
                   appearance=template.appearance)
