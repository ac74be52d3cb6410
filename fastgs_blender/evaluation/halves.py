# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates a model whose training compensated for exposures: the exposure of a held-out camera is fitted on one half of each picture.

As in NeRF in the Wild (Martin-Brualla et al. 2021, section 5), the appearance, here a gain and an offset for each channel, is fitted on one
half of each picture and measured on the other one.  They fit on the left half and measure the right one, and evaluate() gives that figure
(psnr_right).  For all others both halves are measured, each with the fit of the other: half a picture can be several dB easier than the
whole, so that its figure cannot be compared with that of a whole picture.  The fit is robust: where the model shows something else than
the picture does, nothing is told of exposures, and plain least squares would make the gain too small.
"""
import numpy as np

NOTE = "the colours of each half of a picture were fitted on its other half, because training evened exposures"
LEAST = 64
"""Pixels that a fit needs."""
OUTLYING, ROUNDS = 0.1, 6
"""Difference of colour (0..1) at which a pixel counts half, and rounds of weighted least squares."""
MOST = 50_000
"""Pixels of a half that are looked at; of more, evenly spread ones."""
CLIPPED = 0.99
"""Values from which on a lamp may be brighter than a picture can show.  They tell no exposure, and stay as bright in a darker one."""
PULL = 1e-4
"""Towards gain 1 and offset 0, in mean squares of colour: a half without contrast tells no gain."""


def fitted(picture: np.ndarray, truth: np.ndarray, counts: np.ndarray | None = None) -> np.ndarray:
    """The picture [h, w, 3], each half with the gain and offset of each channel that bring the other half nearest to the truth's.

    counts  [h, w], the pixels that are compared; None: all.  A half with too few of them changes nothing in the other
    """
    half = middle(picture)
    result = picture.copy()
    for fitted, measured in ((np.s_[:, :half], np.s_[:, half:]), (np.s_[:, half:], np.s_[:, :half])):
        found = _fit(picture[fitted], truth[fitted], None if counts is None else np.asarray(counts)[fitted])
        if found:
            shown = picture[measured]
            exposed = shown * found[0] + found[1]
            result[measured] = np.where(shown < CLIPPED, exposed, np.maximum(exposed, shown))
    return result


def middle(picture: np.ndarray) -> int:
    """The first column of the right half of a picture [h, w, ...]."""
    return picture.shape[1] // 2


def _fit(picture: np.ndarray, truth: np.ndarray, counts: np.ndarray | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Gains and offsets [3] that bring a picture [h, w, 3] nearest to the truth; None where too few pixels count."""
    where = (np.maximum(picture, truth) < CLIPPED).all(-1) & (True if counts is None else counts > 0.5)
    rows = np.flatnonzero(where)
    rows = rows[:: -(-len(rows) // MOST) or 1]
    p, q = (np.asarray(image).reshape(-1, 3)[rows].astype(np.float64) for image in (picture, truth))
    if len(p) < LEAST:
        return None
    gain, offset = np.ones(3), np.zeros(3)
    for _ in range(ROUNDS):
        weight = 1 / (1 + np.square((q - gain * p - offset) / OUTLYING).sum(1, keepdims=True))
        weight /= weight.sum()
        mean_p, mean_q = (weight * p).sum(0), (weight * q).sum(0)
        gain = ((weight * (p - mean_p) * (q - mean_q)).sum(0) + PULL) / ((weight * (p - mean_p) ** 2).sum(0) + PULL)
        offset = mean_q - gain * mean_p
    return gain, offset
