# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples images between their pixels by interpolation."""
import numpy as np


def between_pixels(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The image [h, w] or [h, w, C] at positions [P] in pixels, whole numbers at their centres: straight between the four neighbours."""
    height, width = image.shape[:2]
    i, j = np.clip(np.floor(y).astype(int), 0, height - 2), np.clip(np.floor(x).astype(int), 0, width - 2)
    v, u = y - i, x - j
    if image.ndim == 3:
        u, v = u[:, None], v[:, None]
    return (1 - v) * ((1 - u) * image[i, j] + u * image[i, j + 1]) + v * ((1 - u) * image[i + 1, j] + u * image[i + 1, j + 1])
