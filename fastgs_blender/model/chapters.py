# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in chapters: a source that holds in memory only what its current chapter shows.

A chapter is a run of frames.  The Gaussians of a clip lie in pieces, and each piece is shown in a run of chapters.  The model of a chapter
is made of the pieces that it shows, in their order.  What always stays lies in a piece of all chapters, which is read once.  So memory does
not grow with the clip.  cutting.py makes such clips of models, formats/chaptered.py reads and writes them.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from ..util.errors import FastGSError
from .gaussians import Clip, GaussianModel, unchanging
from .joining import concatenate
from .sequence import ENDS, Sequence, ahead, cache
from .surroundings import Surroundings

RECENT = 32
"""Moments after which a chapter is forgotten of which none of them was: objects may show a clip at several times."""
_clips: WeakKeyDictionary[GaussianModel, object] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Piece:
    """Gaussians that are shown together.

    first, count  the chapters that show them: first .. first + count - 1
    size          the number of Gaussians
    read          gives their model; safe to call from any thread
    """

    first: int
    count: int
    size: int
    read: Callable[[], GaussianModel]

    def shows(self, i: int) -> bool:
        """Whether the i-th chapter shows it."""
        return self.first <= i < self.first + self.count


@dataclass(frozen=True, eq=False)
class Chapter:
    """A run of frames.

    begin     its first frame
    template  a model without Gaussians that has the chapter's kinds
    time      (begin, length) in the clip's t of the time of its models
    """

    begin: int
    template: GaussianModel
    time: tuple[float, float] = (0.0, 1.0)


class Chapters(Sequence):
    """A long clip; moment() gives the model of the chapter that shows a time.

    clip      of all chapters
    chapters  in order, the first begins at frame 0
    pieces    in the order in which their Gaussians are drawn
    state     state() -> a value that changes when the file does
    about     for error messages: where the clip comes from

    Example:
        source = fg.chapters(model, frames=30)
    """

    def __init__(self, clip: Clip, chapters: list[Chapter], pieces: list[Piece], state: Callable[[], object] = lambda: None,
                 about: str = "the clip") -> None:
        self.chapters, self.pieces = chapters, pieces
        self._shown, self._looked, self._clip = 0.0, (-1, 0), object()
        self._moments, self._used = 0, {0: 0}
        super().__init__(clip, np.array([chapter.begin for chapter in chapters]), self._made, lambda i: state(), about)
        self._count = sum(piece.size for piece in pieces)

    def moment(self, t: float, hold: bool = False, read: bool = True) -> tuple[GaussianModel, float]:
        """As Sequence.moment(); exact between frames, which `hold` does not change."""
        i = self.number(t)
        if read:
            self._read_ahead(i, t)
        begin, length = self.chapters[i].time
        return self.frame(i, read), (t - begin) / length

    def number(self, t: float) -> int:
        """The number of the chapter that shows t; the first before the clip, and the last after it."""
        return max(int(np.searchsorted(self.at, t * self.clip.frame_count + ENDS, side="right")) - 1, 0)

    def shown(self, i: int) -> list[int]:
        """The numbers of the pieces that the i-th chapter shows."""
        return [k for k, piece in enumerate(self.pieces) if piece.shows(i)]

    @property
    def one_time(self) -> bool:
        """Whether all chapters have the kinds of the first and the clip's time, so that joined() is possible."""
        first = self.chapters[0]
        return all(chapter.template is first.template and chapter.time == (0.0, 1.0) for chapter in self.chapters)

    def joined(self) -> GaussianModel:
        """One model of all chapters; raises FastGSError where these have kinds or a time of their own."""
        if not self.one_time:
            raise FastGSError(f"{self.about} is a clip whose chapters have motion of their own, so no one model holds it; "
                              "open it with open_source().")
        return self._together(0, [piece.read() for piece in self.pieces])

    def with_surroundings(self, around: Surroundings) -> Chapters:
        """The same clip with other surroundings."""
        templates = {chapter.template: replace(chapter.template, surroundings=around) for chapter in self.chapters}
        chapters = [replace(chapter, template=templates[chapter.template]) for chapter in self.chapters]
        return Chapters(self.clip, chapters, self.pieces, lambda: self._state(0), self.about)

    def _made(self, i: int) -> GaussianModel:
        found = self._together(i, [self._piece(i, k) for k in self.shown(i)])
        unchanging(found, declared=True)
        if self.one_time:
            _clips[found] = self._clip
        return found

    def _piece(self, i: int, k: int) -> GaussianModel:
        """The k-th piece; one of several chapters stays in memory for the next."""
        piece = self.pieces[k]
        return piece.read() if piece.count == 1 else cache.get((self._owner, "piece", k), self._state(i), piece.read)

    def _together(self, i: int, models: list[GaussianModel]) -> GaussianModel:
        template = self.chapters[i].template
        models = [model for model in models if len(model)]
        if not models:
            return template
        return replace(concatenate(models), clip=template.clip, surroundings=template.surroundings, provenance=template.provenance)

    def _read_ahead(self, i: int, t: float) -> None:
        """Let the chapter be read that comes next if playback goes on as it does."""
        looked = i, 1 if t >= self._shown else -1
        self._shown, self._moments = t, self._moments + 1
        self._used[i] = self._moments
        if looked != self._looked and len(self.chapters) > 1:
            after = sum(looked) % len(self.chapters)
            self._looked, self._used[after] = looked, self._moments
            for task in self._ahead:
                task.cancel()
            for old in [k for k, moment in list(self._used.items()) if moment < self._moments - RECENT]:
                del self._used[old]
                cache.drop((self._owner, old))
                for k in self.shown(old):
                    if not any(self.pieces[k].shows(other) for other in self._used):
                        cache.drop((self._owner, "piece", k))
            self._ahead = [ahead(self.frame, after)]

    def __repr__(self) -> str:
        return f"Chapters({self.about}, {len(self.chapters)} chapters, {len(self)} Gaussians, {self.clip!r})"


def one_clip(a: GaussianModel, b: GaussianModel) -> bool:
    """Whether two models are the same, or hold Gaussians of one clip in its time: near a seam, each shows what the other shows."""
    return a is b or (a in _clips and _clips[a] is _clips.get(b))
