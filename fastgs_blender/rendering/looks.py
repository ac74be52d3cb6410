# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks: how the settings of an object change its Gaussians' colour, opacity and size.  Every renderer takes them as one row of numbers.

A Gaussian of opacity sigma (without its temporal factor) and standard deviations s, the largest of them S:

    it is left out           where sigma < opacity_cut
    its opacity becomes      sigma * opacity
    its size becomes         s * clip(S * splat_scale, min_size, max_size) / S            (its shape stays)

A colour x, scene linear, becomes

    factor * max(0, M x) ^ power,    M = 2^exposure diag(tint) Saturation Hue,
    power = contrast / gamma,        factor = GREY ^ ((1 - contrast) / gamma)

so that contrast leaves middle grey, and hue and saturation leave luminance and greys.  Colours of models in sRGB are turned into scene
linear ones and back.  Colours of Gaussians are changed before they are blended; those of a decoder are changed where it made them.
"""
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np

from .colour import linear_to_srgb, srgb_to_linear

GREY = 0.18
"""Middle grey, scene linear."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of Rec.709."""
BOUND = 1e30
"""Stands for no limit; single precision holds it."""


class Look(IntEnum):
    """Places in the row of numbers.

    OPACITY        factor on the opacity
    FAINTEST       largest 1 / sigma that is drawn
    SCALE, SMALLEST, LARGEST    of the size
    SIZED, GRADED  whether sizes and colours change: where they do not, nothing is computed
    LINEAR         whether the model's colours are scene linear
    FACTOR, POWER  of the colour
    MATRIX         nine numbers, row by row
    MARK           see ObjectSettings; nothing is computed with it here
    """

    OPACITY = 0
    FAINTEST = 1
    SCALE = 2
    SMALLEST = 3
    LARGEST = 4
    SIZED = 5
    GRADED = 6
    LINEAR = 7
    FACTOR = 8
    POWER = 9
    MATRIX = 10
    MARK = 19


LOOK_NUMBERS = 20
"""Length of the row: five texels."""


def look_numbers(settings: Any, colour_space: str) -> np.ndarray:
    """The row [LOOK_NUMBERS] float64 of an ObjectSettings, for a model of a colour space ("srgb" or "linear")."""
    row = np.zeros(LOOK_NUMBERS)
    row[Look.OPACITY] = settings.opacity
    row[Look.FAINTEST] = min(1 / settings.opacity_cut, BOUND) if settings.opacity_cut > 0 else BOUND
    largest = settings.max_size or BOUND
    row[Look.SCALE], row[Look.SMALLEST], row[Look.LARGEST] = settings.splat_scale, min(settings.min_size, largest), largest
    row[Look.SIZED] = (row[Look.SCALE], row[Look.SMALLEST], row[Look.LARGEST]) != (1, 0, BOUND)
    row[Look.LINEAR] = colour_space == "linear"
    matrix, power = _matrix(settings.exposure, settings.saturation, settings.hue, tuple(settings.tint)), settings.contrast / settings.gamma
    factor = GREY ** ((1 - settings.contrast) / settings.gamma)
    row[Look.FACTOR], row[Look.POWER], row[Look.MATRIX:Look.MATRIX + 9] = factor, power, matrix.ravel()
    row[Look.MARK] = settings.mark
    row[Look.GRADED] = (factor, power) != (1, 1) or np.abs(matrix - np.eye(3)).max() > 1e-12
    return row


@lru_cache(maxsize=64)
def _matrix(exposure: float, saturation: float, hue: float, tint: tuple[float, float, float]) -> np.ndarray:
    grey = np.outer(np.ones(3), LUMINANCE)
    chroma = np.eye(3) - grey
    c, s = np.cos(hue), np.sin(hue) / np.sqrt(3)
    third = (1 - c) / 3
    turn = np.array([[c + third, third - s, third + s], [third + s, c + third, third - s], [third - s, third + s, c + third]])
    return 2.0**exposure * np.diag(tint) @ (grey + saturation * chroma) @ (grey + chroma @ turn @ chroma)


def graded(colour: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Colours [..., 3] of a model, changed as a row of look_numbers() says."""
    if not row[Look.GRADED]:
        return colour
    linear = bool(row[Look.LINEAR])
    x = colour if linear else srgb_to_linear(colour)
    x = np.maximum(x @ row[Look.MATRIX:Look.MATRIX + 9].reshape(3, 3).T, 0)
    x = row[Look.FACTOR] * x ** row[Look.POWER]
    return x if linear else linear_to_srgb(x)


def graded_picture(rgb: np.ndarray, weight: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Premultiplied colour [h, w, 3] that a decoder made, with its blending weight [h, w], changed likewise."""
    if not row[Look.GRADED]:
        return rgb
    w = weight[..., None]
    colour = np.divide(rgb, w, out=np.zeros_like(rgb), where=w > 0)
    return (graded(colour, row) * w).astype(rgb.dtype, copy=False)


def size_factor(scale: np.ndarray, row: np.ndarray) -> np.ndarray:
    """What multiplies the standard deviations of Gaussians with the largest one `scale` [M]."""
    if not row[Look.SIZED]:
        return np.ones_like(scale)
    wanted = np.clip(scale * row[Look.SCALE], row[Look.SMALLEST], row[Look.LARGEST])
    return np.divide(wanted, scale, out=np.ones_like(scale), where=scale > 0)
