# SPDX-License-Identifier: GPL-3.0-or-later
"""Joins the models of a long capture's segments (core/spans.py) into one clip.

All segments share the first one's decoder, so that their Gaussians can be blended in one picture (joining.py).
"""
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from ...model.chapters import Chapters
from ...model.cutting import cut, same_rows
from ...model.gaussians import Clip, GaussianModel
from ...model.joining import FOREVER, Segment, join
from ...model.motion import Static
from ...model.surroundings import Surroundings, together
from ..core.spans import Span
from ..initial.continued import stands

FLANK = 2.36
"""Widths of a flank after which the most opaque Gaussian is no longer drawn: exp(-d^2) = 1 / 255."""


def joined_clip(load: Callable[[int], GaussianModel], cuts: list[Span], clip: Clip, provenance: dict[str, str]) -> Chapters:
    """The segments' models as one clip in chapters; load(i) reads the i-th, of which one or two are in memory at a time.

    In an overlap the later one fades in first, then the earlier one fades out.  A flank takes a quarter of the overlap: it lies where the
    neighbour is fully shown.  Segments that share no frame change over between two frames, so each frame is one segment's.
    """
    segments = _Segments(load, cuts, clip)
    chapters, pieces = segments.cut(0).chapters, []
    template = replace(chapters[0].template, surroundings=together(segments.surroundings), provenance=provenance)
    for i in range(len(cuts)):
        for k, piece in enumerate(segments.cut(i).pieces):
            pieces.append(replace(piece, read=partial(segments.piece, i, k)))
    return Chapters(clip, [replace(chapter, template=template) for chapter in chapters], pieces, about="the segments")


class _Segments:
    """What each segment gives to the clip.

    kept, since  of each segment's Gaussians [N]: whether it gives them, and the segment since which they stand.  A Gaussian that stands
                 still, and is held by segments that follow each other, comes once, from the last of them
    """

    def __init__(self, load: Callable[[int], GaussianModel], cuts: list[Span], clip: Clip) -> None:
        self.load, self.cuts, self.clip = load, cuts, clip
        self.surroundings: list[Surroundings] = []
        self.kept: list[np.ndarray] = []
        self.since: list[np.ndarray] = []
        self._last: tuple[int, Chapters | None] = -1, None
        rows, still = np.zeros(0, int), None
        for i in range(len(cuts)):
            model = load(i)
            self.surroundings.append(model.surroundings)
            self.kept.append(np.ones(len(model), bool))
            self.since.append(np.full(len(model), i, np.int16))
            before, earlier = rows, still
            rows = np.flatnonzero(stands(model))
            still = _at_rest(model.take(rows))
            if earlier is not None:
                same = same_rows(earlier, still)
                self.since[i][rows[same >= 0]] = self.since[i - 1][before[same[same >= 0]]]
                self.kept[i - 1][before[same[same >= 0]]] = False
        seams = [tuple(sorted((after.first, before.first + before.count - 1))) for before, after in pairwise(cuts)]
        if not all(kept.all() for kept in self.kept):
            seams = [((low + high) // 2, (low + high) // 2 + 1) for low, high in seams]
        self.seams = seams

    def cut(self, i: int) -> Chapters:
        """The i-th segment in the clip's time, as a clip of its own; the last one is held."""
        number, found = self._last
        if found is None or number != i:
            found = cut(self._joined(i), about="the segments")
            self._last = i, found
        return found

    def piece(self, i: int, k: int) -> GaussianModel:
        """The k-th piece of the i-th segment."""
        return self.cut(i).pieces[k].read()

    def _joined(self, i: int) -> GaussianModel:
        span, whole = self.cuts[i], self.clip.frame_count
        beside = self.seams[max(i - 1, 0):i + 1]
        fade = max(min((high - low) for low, high in beside) * 0.25 / FLANK, 0.02) if beside else 1.0
        last = None if i == len(self.seams) else self._at(i, 0.625)
        part = Segment(self.load(i).take(self.kept[i]), span.first / whole, span.count / whole, (None, last), fade / whole)
        joined = join([part], self.clip)
        begins = np.array([-FOREVER, *(self._at(k, 0.375) for k in range(i))])
        joined.temporal[:, 1] = begins[self.since[i][self.kept[i]]]
        return joined

    def _at(self, i: int, share: float) -> float:
        """The time t at which this share of the seam after the i-th segment is over."""
        low, high = self.seams[i]
        return (low + share * (high - low)) / self.clip.frame_count


def _at_rest(model: GaussianModel) -> GaussianModel:
    """Gaussians that stand still, without their motion, which is 0."""
    return replace(model, motion=np.zeros((len(model), 0, 3)), rotation_motion=np.zeros((len(model), 0, 4)), basis=Static(),
                   rotation_basis=Static())
