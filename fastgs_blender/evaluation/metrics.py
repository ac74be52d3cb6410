# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of one picture against the truth, in float64, with the definitions that published tables use.

Pictures are [h, w, 3], display-referred, 0..1; what lies outside is clipped first, as every trainer's evaluation does.
"""
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..util.errors import FastGSError

GAUSSIAN_WINDOW, SIGMA = 11, 1.5
UNIFORM_WINDOW = 7
K1, K2 = 0.01, 0.03
FOREGROUND = 0.5
"""Pixels whose mask is at least this are foreground."""


def psnr(picture: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Peak signal-to-noise ratio in dB of a picture [h, w, 3], range 1; with a mask [h, w], over its foreground pixels only.

    truth  [h, w, 3], to which the picture is compared
    inf for equal pictures; nan where the mask has no foreground.

    Example:
        decibels = fg.psnr(fg.render(model, camera, 0.5)["rgb"], fg.render(model, camera, 0.6)["rgb"])
    """
    a, b = _pair(picture, truth)
    error = np.square(a - b)
    if mask is not None:
        error = error[np.asarray(mask) >= FOREGROUND]
    if not error.size:
        return float("nan")
    mean = float(error.mean())
    return float("inf") if mean == 0 else -10 * float(np.log10(mean))


def dssim1(picture: ArrayLike, truth: ArrayLike, valid: ArrayLike | None = None) -> float:
    """(1 - SSIM) / 2 with 3DGS's SSIM: Gaussian window of 11 x 11 pixels, sigma 1.5, zeros beyond the edges, data range 1.

    With valid [h, w], the mean is taken over windows whose centre is valid; nan where there is none.  Pictures should be black elsewhere.
    """
    distance = np.arange(GAUSSIAN_WINDOW) - GAUSSIAN_WINDOW // 2
    window = np.exp(-distance**2 / (2 * SIGMA**2))
    a, b = (np.pad(x, ((5, 5), (5, 5), (0, 0))) for x in _pair(picture, truth))
    return (1 - _ssim(a, b, window / window.sum(), 1.0, 1.0, None if valid is None else np.asarray(valid) > 0)) / 2


def dssim2(picture: ArrayLike, truth: ArrayLike, valid: ArrayLike | None = None) -> float:
    """(1 - SSIM) / 2 with scikit-image's structural_similarity(..., channel_axis=-1, data_range=2.0); see _skimage().

    Older versions of scikit-image took 2 as the range of any floating-point picture, and the published figures stem from them.
    """
    return _skimage(picture, truth, valid, 2.0)


def dssim1_skimage(picture: ArrayLike, truth: ArrayLike, valid: ArrayLike | None = None) -> float:
    """The same with data_range=1.0: the DSSIM1 that the paper on Spacetime Gaussians defines.  Its code measures dssim1()."""
    return _skimage(picture, truth, valid, 1.0)


def _skimage(picture: ArrayLike, truth: ArrayLike, valid: ArrayLike | None, data_range: float) -> float:
    """Uniform window of 7 x 7 pixels, sample covariances (N / (N - 1)), only windows that lie inside the picture.

    With valid [h, w], only windows of valid pixels count; nan where there is none.
    """
    a, b = _pair(picture, truth)
    if min(a.shape[:2]) < UNIFORM_WINDOW:
        raise FastGSError(f"scikit-image's SSIM needs pictures of at least 7 x 7 pixels, not {a.shape[1]} x {a.shape[0]}.")
    count = UNIFORM_WINDOW**2
    window = np.full(UNIFORM_WINDOW, 1 / UNIFORM_WINDOW)
    whole = None if valid is None else _filtered((np.asarray(valid) > 0).astype(np.float64), window) > 1 - 0.5 / count
    return (1 - _ssim(a, b, window, data_range, count / (count - 1), whole)) / 2


def temporal_error(picture: ArrayLike, before: ArrayLike, truth: ArrayLike, truth_before: ArrayLike,
                   valid: ArrayLike | None = None) -> float:
    """Flicker: the mean of |(picture - before) - (truth - truth_before)| over pixels and channels, 0..2.

    It is 0 where a picture changes from one frame to the next exactly as the truth does, however wrong it is.  With valid [h, w], only
    valid pixels count; nan where there is none.
    """
    now, then = _pair(picture, truth), _pair(before, truth_before)
    error = np.abs((now[0] - then[0]) - (now[1] - then[1]))
    if valid is not None:
        error = error[np.asarray(valid) > 0]
    return float(error.mean()) if error.size else float("nan")


def _pair(picture: ArrayLike, truth: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    a, b = (np.clip(np.asarray(x, np.float64), 0, 1) for x in (picture, truth))
    if a.shape != b.shape or a.ndim != 3:
        raise FastGSError(f"pictures of the shapes {a.shape} and {b.shape} cannot be compared; both must be [h, w, 3].")
    return a, b


def _ssim(x: np.ndarray, y: np.ndarray, window: np.ndarray, data_range: float, sample: float, counted: np.ndarray | None = None) -> float:
    """Mean SSIM over all whole windows (Wang et al. 2004): `window` [k] is one axis of a separable one, `sample` scales covariances.

    counted  which windows [h - k + 1, w - k + 1] the mean is taken over; None: all.  nan where there are none.
    """
    if counted is not None and not counted.any():
        return float("nan")
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    total = 0.0
    for channel in range(x.shape[-1]):
        a, b = (np.ascontiguousarray(v[..., channel]) for v in (x, y))
        ma, mb, aa, bb, ab = (_filtered(v, window) for v in (a, b, a * a, b * b, a * b))
        va, vb, vab = (sample * (s - m) for s, m in ((aa, ma * ma), (bb, mb * mb), (ab, ma * mb)))
        ssim = (2 * ma * mb + c1) * (2 * vab + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
        total += float((ssim if counted is None else ssim[counted]).mean())
    return total / x.shape[-1]


def _filtered(plane: np.ndarray, window: np.ndarray) -> np.ndarray:
    """plane [h, w] under the separable window [k], whole windows only: [h - k + 1, w - k + 1]."""
    for axis in (0, 1):
        count = plane.shape[axis] - len(window) + 1
        out: Any = 0.0
        for i, weight in enumerate(window):
            out = out + weight * (plane[i:i + count] if axis == 0 else plane[:, i:i + count])
        plane = out
    return plane
