# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the blur of a picture in pixels: the variance of its Laplacian against that of the same picture at a quarter of its size.

Natural pictures have a similar contrast at all scales (their spectrum falls as 1 / f), so that missing contrast at the finest scale is a
sign of blur.  Only textured places count: a plain wall looks blurred, and noise on it looks sharp.
"""
import numpy as np

from ..training.core.targets import smaller

COARSE = 4
"""How many times the coarse picture is smaller."""
TILE = 8
"""Pixels of the coarse picture across a tile."""
TEXTURED, LEAST_CONTRAST, LEAST_TILES = 0.35, 4e-5, 6
"""Share of the tiles that count, those with most texture; the variance of the Laplacian (0..1) that they need; their least number."""
SIGMAS = np.array([0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
RATIOS = np.array([1.092, 0.542, 0.332, 0.227, 0.141, 0.108, 0.0829, 0.0739, 0.0676])
"""ratio_of() of noise with a spectrum of 1 / f that a Gaussian of so many pixels blurred."""


def blur_of(rgb: np.ndarray, valid: np.ndarray | None = None) -> float:
    """The deviation in pixels of the Gaussian that blurs a picture [h, w, 3] uint8 most likely; NaN where it has too little texture.

    valid  [h, w] bool or None: what counts
    """
    grey = rgb.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32) / 255
    ratio = ratio_of(grey, valid)
    return float(np.interp(-ratio, -RATIOS, SIGMAS)) if np.isfinite(ratio) else np.nan


def ratio_of(grey: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Deviation of the Laplacian over that of the shrunk picture's, the median of the textured tiles; NaN where there are too few."""
    side = COARSE * TILE
    rows, columns = grey.shape[0] // side, grey.shape[1] // side
    if rows < 2 or columns < 2:
        return np.nan
    grey = grey[:rows * side, :columns * side]
    fine = _tiles(_laplacian(grey), side)
    coarse = _tiles(_laplacian(smaller(grey, COARSE)), TILE)
    good = coarse > max(LEAST_CONTRAST, float(np.quantile(coarse, 1 - TEXTURED)))
    if valid is not None:
        good &= smaller(valid[:rows * side, :columns * side].astype(np.float32), side) > 0.99
    if good.sum() < LEAST_TILES:
        return np.nan
    return float(np.median(np.sqrt(fine[good] / coarse[good])))


def _laplacian(grey: np.ndarray) -> np.ndarray:
    """The sum of the four neighbours less four times the pixel, 0 at the border."""
    out = np.zeros_like(grey)
    out[1:-1, 1:-1] = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:] - 4 * grey[1:-1, 1:-1]
    return out


def _tiles(values: np.ndarray, side: int) -> np.ndarray:
    """Mean squares over tiles of side x side."""
    return smaller(values * values, side)
