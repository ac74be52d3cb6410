# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates a model whose training compensated for exposures: the exposure of a held-out camera is fitted on one half of each picture.

As in NeRF in the Wild (Martin-Brualla et al. 2021, section 5): the appearance, here a gain and an offset for each channel, is fitted on the
left half of each picture, and the right half is measured.  The fit is robust: where the model shows something else than the picture does,
nothing is told of exposures, and plain least squares would make the gain too small.
"""
from __future__ import annotations

import numpy as np

NOTE = "colours were fitted on the left half of each picture, and its right half is measured, because training evened exposures"
LEAST = 64
"""Pixels that a fit needs."""
OUTLYING, ROUNDS = 0.1, 6
"""Difference of colour (0..1) at which a pixel counts half, and rounds of weighted least squares."""
MOST = 50_000
"""Pixels of a half that are looked at; of more, evenly spread ones."""
PULL = 1e-4
"""Towards gain 1 and offset 0, in mean squares of colour: a half without contrast tells no gain."""


def fitted(picture: np.ndarray, truth: np.ndarray, counts: np.ndarray | None = None) -> np.ndarray:
    """The picture [h, w, 3] with the gain and offset of each channel that bring its left half nearest to the truth's.

    counts  [h, w], the pixels that are compared; None: all.  A left half with too few of them changes nothing
    """
    half = picture.shape[1] // 2
    where = np.ones((len(picture), half), bool) if counts is None else np.asarray(counts)[:, :half] > 0.5
    rows = np.flatnonzero(where)
    rows = rows[:: -(-len(rows) // MOST) or 1]
    p, q = (np.asarray(image[:, :half]).reshape(-1, 3)[rows].astype(np.float64) for image in (picture, truth))
    if len(p) < LEAST:
        return picture
    gain, offset = np.ones(3), np.zeros(3)
    for _ in range(ROUNDS):
        weight = 1 / (1 + np.square((q - gain * p - offset) / OUTLYING).sum(1, keepdims=True))
        weight /= weight.sum()
        mean_p, mean_q = (weight * p).sum(0), (weight * q).sum(0)
        gain = ((weight * (p - mean_p) * (q - mean_q)).sum(0) + PULL) / ((weight * (p - mean_p) ** 2).sum(0) + PULL)
        offset = mean_q - gain * mean_p
    return (picture * gain + offset).astype(picture.dtype)


def right(*images: np.ndarray | None) -> list[np.ndarray | None]:
    """The right halves of pictures [h, w, ...]; None stays None."""
    return [None if image is None else image[:, image.shape[1] // 2:] for image in images]
