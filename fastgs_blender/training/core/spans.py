# SPDX-License-Identifier: GPL-3.0-or-later
"""Cuts long clips into overlapping segments of equal length, which are trained one after the other."""
from dataclasses import dataclass

import numpy as np

from .settings import Settings


@dataclass(frozen=True)
class Span:
    """Frames first .. first + count - 1 of a capture."""

    first: int
    count: int


def spans(frame_count: int, segment_frames: int, overlap: int) -> list[Span]:
    """The segments of a clip: all equally long, at most segment_frames, each sharing at least `overlap` frames (0: none) with the next.

    One span where the clip is no longer than a segment, or segment_frames is 0.
    """
    if not segment_frames or frame_count <= segment_frames:
        return [Span(0, frame_count)]
    overlap = min(overlap, segment_frames - 1)
    number = -(-(frame_count - overlap) // (segment_frames - overlap))
    count = min(-(-(frame_count + (number - 1) * overlap) // number), segment_frames)
    firsts = np.floor(np.linspace(0, frame_count - count, number) + 0.5).astype(int)
    return [Span(int(first), count) for first in firsts]


def steps_of(frame_count: int, settings: Settings) -> int:
    """Steps of a whole run on a clip, in all its segments."""
    cuts = spans(frame_count, settings.segment_frames, settings.segment_overlap)
    return sum(settings.of_segment(k).iterations for k in range(len(cuts)))
