# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour: the sRGB curve (IEC 61966-2-1), and what happens to an image after blending.

Images are premultiplied and in the space in which their model was trained and is blended.  A conversion happens once,
after blending, on un-premultiplied colour.
"""
import numpy as np
from numpy.typing import ArrayLike

SRGB_CUT, SRGB_LINEAR_CUT, SRGB_SLOPE, SRGB_OFFSET, SRGB_GAMMA = 0.04045, 0.0031308, 12.92, 0.055, 2.4
"""Of the sRGB curve: linear up to the cut (of sRGB, of linear values), a power beyond it.  Kernels and shaders take them from here."""
LIFTED_FROM = 0.5
"""Linear value from which on captures are taken to show less light than there was: sRGB 0.735."""
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


def straight(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Un-premultiplied colour [h, w, 3] of rgb [h, w, 3] and alpha [h, w]; 0 where alpha is 0."""
    a = alpha[..., None]
    return np.divide(rgb, a, out=np.zeros_like(rgb), where=a > 0)


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
    return rgb if colour_space == "linear" else srgb_to_linear(straight(rgb, alpha)) * alpha[..., None]


def display(rgb: np.ndarray, alpha: np.ndarray, colour_space: str) -> np.ndarray:
    """Straight sRGB colour of premultiplied colour in a model's space."""
    colour = straight(rgb, alpha)
    return colour if colour_space == "srgb" else linear_to_srgb(colour)
