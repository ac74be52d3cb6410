# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points on what stands still, from the median of each camera's pictures.

Nobody passes by in a median and it has less noise, so it is worth comparing at a finer size, once for all moments.  Seams and dots of a
painted wall differ from it by a few per cent, less than the shades of two cameras do.  So a colour is compared as its difference from its
surroundings, in units of the contrast there.
"""
from collections.abc import Iterable, Sequence

import numpy as np

from ...model.points import Points
from . import planes, sweep

SIDE, DEPTHS, WINDOW, ALIKE, NEIGHBOURS = 320, 144, 5, 0.15, (8, 90.0)
"""Pixels of a median along its longer side, and what differs from the sweep of a moment (sweep.py).  The upper walls of a dome are seen at
the rims of pictures, by few of those that look the same way: hence more neighbours, which look more differently."""
AROUND = 9
"""Pixels to each side that are a colour's surroundings."""
NOISE, MOST = 0.01, 2.0
"""Contrast (0..1) that is added to that of the surroundings, so that noise stays small; and the largest difference, in contrasts."""
MOVES, FEWEST = 0.06, 4
"""Difference of colour (0..1) from the median, above which a pixel moves; and pictures of which there is one."""


def standing(cameras: Iterable[Sequence[tuple]], near: float, far: float, seed: int) -> tuple[Points, np.ndarray]:
    """Points [P] on surfaces that stand still, and the large planes among these (planes.py).

    cameras  of each, its pictures (rgb [h, w, 3], camera, inside or None) at several moments
    near, far  depths between which surfaces are
    """
    pictures = []
    for its in cameras:
        images = np.array([image for image, _, _ in its])
        median = np.median(images, 0).astype(np.float32)
        still = (np.abs(images - median).mean(-1) < MOVES).all(0)
        for inside in (inside for _, _, inside in its if inside is not None):
            still &= inside > 0.5
        pictures.append((median, its[0][1], still.astype(np.float32)))
    compared = [(contrasts(median), *rest) for median, *rest in pictures]
    depths = sweep.swept(compared, near, far, DEPTHS, WINDOW, NEIGHBOURS)
    large = planes.large(np.concatenate([xyz for xyz, _ in sweep.surfaces(pictures, depths, alike=ALIKE)]), seed)
    depths = planes.laid(compared, depths, large, near, far, NEIGHBOURS)
    xyz, rgb = (np.concatenate(part) for part in zip(*sweep.surfaces(pictures, depths, alike=ALIKE)))
    return Points(xyz, rgb, np.full(len(xyz), np.nan)), large


def contrasts(image: np.ndarray) -> np.ndarray:
    """An image [h, w, 3] in differences from its surroundings, in units of the contrast there; 0..1, where 0.5 is no difference."""
    difference = image - _mean(image)
    contrast = np.sqrt(_mean((difference**2).mean(-1, keepdims=True)))
    return np.ascontiguousarray(0.5 + np.clip(difference / (contrast + NOISE), -MOST, MOST) / (2 * MOST), np.float32)


def _mean(image: np.ndarray) -> np.ndarray:
    """Means of an image [h, w, C] over the surroundings of each pixel; beyond the borders these repeat."""
    for axis in (0, 1):
        padded = np.pad(image, [(AROUND + 1, AROUND) if k == axis else (0, 0) for k in range(3)], "edge")
        sums = np.moveaxis(padded.cumsum(axis, np.float64), axis, 0)
        image = np.moveaxis((sums[2 * AROUND + 1:] - sums[:-2 * AROUND - 1]) / (2 * AROUND + 1), 0, axis)
    return image
