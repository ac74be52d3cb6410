# SPDX-License-Identifier: GPL-3.0-or-later
"""Cuts long captures into overlapping segments of equal length, which are trained separately, and joins their models into one.

All segments share the first one's decoder, so that their Gaussians can be blended in one picture (joining.py).
"""
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...model.cutting import same_rows
from ...model.gaussians import Clip, GaussianModel
from ...model.joining import FOREVER, Segment, join
from ...model.motion import Static
from ..initial.continued import stands

FLANK = 2.36
"""Widths of a flank after which the most opaque Gaussian is no longer drawn: exp(-d^2) = 1 / 255."""


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


def joined_model(models: list[GaussianModel], cuts: list[Span], clip: Clip, provenance: dict[str, str]) -> GaussianModel:
    """Join the segments' models into one of the whole clip.  In an overlap the later one fades in first, then the earlier one fades out.

    A flank takes a quarter of the overlap: it lies where the neighbour is fully shown.  Segments that share no frame change over between
    two frames, so each frame is one segment's.
    """
    whole = clip.frame_count
    seams = [tuple(sorted((after.first, before.first + before.count - 1))) for before, after in pairwise(cuts)]  # where they change over
    parts, shown_from, (kept, begun) = [], [], _once(models)
    if any(len(rows) < len(model) for rows, model in zip(kept, models)):
        seams = [((low + high) // 2, (low + high) // 2 + 1) for low, high in seams]
    for i, (model, cut) in enumerate(zip(models, cuts)):
        beside = seams[max(i - 1, 0):i + 1]
        fade = max(min((high - low) for low, high in beside) * 0.25 / FLANK, 0.02) if beside else 1.0
        first = None if i == 0 else (seams[i - 1][0] + 0.375 * (seams[i - 1][1] - seams[i - 1][0])) / whole
        last = None if i == len(seams) else (seams[i][0] + 0.625 * (seams[i][1] - seams[i][0])) / whole
        parts.append(Segment(model.take(kept[i]), cut.first / whole, cut.count / whole, (first, last), fade / whole))
        shown_from.append(-FOREVER if first is None else first)
    joined = join(parts, clip)
    joined.temporal[:, 1] = np.array(shown_from)[np.concatenate([since[rows] for since, rows in zip(begun, kept)])]
    return replace(joined, provenance=provenance)


def _once(models: list[GaussianModel]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """For each segment the rows that it gives to the joined model, and for each of its Gaussians [N] the segment since which it stands.

    A Gaussian that stands still, and is held by segments that follow each other, comes once, from the last of them.
    """
    kept = [np.arange(len(model)) for model in models]
    begun = [np.full(len(model), i) for i, model in enumerate(models)]
    standing = [np.flatnonzero(stands(model)) for model in models]
    still = [_at_rest(model.take(rows)) for model, rows in zip(models, standing)]
    for i in range(1, len(models)):
        same = same_rows(still[i - 1], still[i])
        before, here = standing[i - 1][same[same >= 0]], standing[i][same >= 0]
        begun[i][here] = begun[i - 1][before]
        kept[i - 1] = np.setdiff1d(kept[i - 1], before)
    return kept, begun


def _at_rest(model: GaussianModel) -> GaussianModel:
    """Gaussians that stand still, without their motion, which is 0."""
    return replace(model, motion=np.zeros((len(model), 0, 3)), rotation_motion=np.zeros((len(model), 0, 4)), basis=Static(),
                   rotation_basis=Static())
