# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates a model whose training compensated for exposures: the exposure of a held-out camera is fitted on one half of each picture.

As in NeRF in the Wild (Martin-Brualla et al. 2021, section 5): the appearance, here a gain and an offset for each channel, is fitted on the
left half of each picture, and the right half is measured.
"""
from __future__ import annotations

import numpy as np

NOTE = "colours were fitted on the left half of each picture, and its right half is measured, because training evened exposures"
LEAST = 64
"""Pixels that a fit needs."""
PULL = 1e-4
"""Towards gain 1 and offset 0, in mean squares of colour: a half without contrast tells no gain."""


def fitted(picture: np.ndarray, truth: np.ndarray, counts: np.ndarray | None = None) -> np.ndarray:
    """The picture [h, w, 3] with the gain and offset of each channel that bring its left half nearest to the truth's.

    counts  [h, w], the pixels that are compared; None: all.  A left half with too few of them changes nothing
    """
    half = picture.shape[1] // 2
    where = np.ones((len(picture), half), bool) if counts is None else np.asarray(counts)[:, :half] > 0.5
    p, q = (np.asarray(image[:, :half], np.float64)[where] for image in (picture, truth))
    if len(p) < LEAST:
        return picture
    mean_p, mean_q = p.mean(0), q.mean(0)
    gain = (((p - mean_p) * (q - mean_q)).mean(0) + PULL) / (((p - mean_p) ** 2).mean(0) + PULL)
    return (picture * gain + (mean_q - gain * mean_p)).astype(picture.dtype)


def right(*images: np.ndarray | None) -> list[np.ndarray | None]:
    """The right halves of pictures [h, w, ...]; None stays None."""
    return [None if image is None else image[:, image.shape[1] // 2:] for image in images]
