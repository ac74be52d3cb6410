# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour: the sRGB curve (IEC 61966-2-1), and what happens to an image after blending.

Images are premultiplied and in the space in which their model was trained and is blended.  A conversion happens once,
after blending, on un-premultiplied colour.
"""
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..util.threads import ranges, run

SRGB_CUT, SRGB_LINEAR_CUT, SRGB_SLOPE, SRGB_OFFSET, SRGB_GAMMA = 0.04045, 0.0031308, 12.92, 0.055, 2.4
"""Of the sRGB curve: linear up to the cut (of sRGB, of linear values), a power beyond it.  Kernels and shaders take them from here."""
LIFTED_FROM = 0.5
"""Linear value from which on captures are taken to show less light than there was: sRGB 0.735."""
PIXELS = 32_768
"""Of a picture that are converted at once."""
BRIGHTEST = 1e12
"""Largest sRGB value that is told from larger ones: float32 holds no linear value of much larger ones, which looks can make."""


def srgb_to_linear(srgb: np.ndarray) -> np.ndarray:
    """Scene-linear values of sRGB ones; the curve goes on above 1 and is point-symmetric below 0."""
    x = np.asarray(srgb)
    a = np.minimum(np.abs(x), BRIGHTEST)
    linear = np.where(a <= SRGB_CUT, a / SRGB_SLOPE, ((a + SRGB_OFFSET) / (1 + SRGB_OFFSET)) ** SRGB_GAMMA)
    return np.copysign(linear, x).astype(x.dtype, copy=False)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """The inverse of srgb_to_linear."""
    x = np.asarray(linear)
    a = np.abs(x)
    srgb = np.where(a <= SRGB_LINEAR_CUT, a * SRGB_SLOPE, (1 + SRGB_OFFSET) * a ** (1 / SRGB_GAMMA) - SRGB_OFFSET)
    return np.copysign(srgb, x).astype(x.dtype, copy=False)


def by_channel(work: Callable[[np.ndarray, np.ndarray], np.ndarray], rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """work(values [...], alpha [...]) of each channel of rgb [..., 3], with alpha [...], on all threads.

    NumPy takes several times as long for rows of three numbers, and for what does not stay in the processor's cache.
    """
    out = np.empty_like(rgb)
    rows, told = max(1, PIXELS // max(alpha[:1].size, 1)), np.geterr()

    def piece(channel: int, first: int, last: int) -> None:
        with np.errstate(**told):  # NumPy keeps it for each thread
            out[first:last, ..., channel] = work(rgb[first:last, ..., channel], alpha[first:last])

    run(piece, [(channel, *rows) for rows in ranges(len(rgb), rows) for channel in range(rgb.shape[-1])])
    return out


def _straight(values: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.divide(values, alpha, out=np.zeros_like(values), where=alpha > 0)


def straight(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Un-premultiplied colour [..., 3] of rgb [..., 3] and alpha [...]; 0 where alpha is 0."""
    return by_channel(_straight, rgb, alpha)


def lifted(rgb: np.ndarray, highlights: float) -> np.ndarray:
    """Linear colours [..., 3] with highlights as bright as light is, not as a display shows it: white becomes `highlights` times as bright.

    With m, the largest of red, green and blue, the factor is 1 up to LIFTED_FROM and then grows smoothly to `highlights` at m = 1:
    1 + (highlights - 1) s^2 (3 - 2 s), s = (m - LIFTED_FROM) / (1 - LIFTED_FROM) within 0..1.  Hues stay.
    """
    s = np.clip((rgb.max(-1, keepdims=True) - LIFTED_FROM) / (1 - LIFTED_FROM), 0, 1)
    return rgb * (1 + (highlights - 1) * s * s * (3 - 2 * s))


def over(rgb: np.ndarray, alpha: np.ndarray, background: ArrayLike | None) -> np.ndarray:
    """Premultiplied rgb over an opaque background [3] of the same colour space."""
    return rgb + (1 - alpha[..., None]) * np.asarray(background, rgb.dtype)


def scene_linear(rgb: np.ndarray, alpha: np.ndarray, colour_space: str) -> np.ndarray:
    """Premultiplied scene-linear colour of premultiplied colour in a model's space ("srgb" or "linear")."""
    return rgb if colour_space == "linear" else by_channel(lambda x, a: srgb_to_linear(_straight(x, a)) * a, rgb, alpha)


def encoded(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Premultiplied sRGB colour of premultiplied linear colour."""
    return by_channel(lambda x, a: linear_to_srgb(_straight(x, a)) * a, rgb, alpha)


def display(rgb: np.ndarray, alpha: np.ndarray, colour_space: str) -> np.ndarray:
    """Straight sRGB colour of premultiplied colour in a model's space."""
    return by_channel(_straight if colour_space == "srgb" else lambda x, a: linear_to_srgb(_straight(x, a)), rgb, alpha)
