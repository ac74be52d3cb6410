# SPDX-License-Identifier: GPL-3.0-or-later
"""Converts the library's colours to Blender's scene-linear ones, once, after blending.

Captures are display-referred: their Gaussians were fitted by blending sRGB numbers, so they are blended as such, and the
blended colour of a pixel is decoded afterwards, without the alpha in it.  docs/colour.md says what that means for artists.
"""
import numpy as np
from mathutils import Color

from ..fastgs_blender.rendering import colour
from ..fastgs_blender.util.threads import ranges, run

ROWS = 32
"""Of a picture that are put over a background at once: what stays in the processor's cache."""

LOBES = ((0, 1.056, 599.8, 37.9, 31.0), (0, 0.362, 442.0, 16.0, 26.7), (0, -0.065, 501.1, 20.4, 26.2), (1, 0.821, 568.8, 46.9, 40.5),
         (1, 0.286, 530.9, 16.3, 31.1), (2, 1.217, 437.0, 11.8, 36.0), (2, 0.681, 459.0, 26.0, 13.8))
"""What the eye's curves x, y, z are made of: which one, height, and in nm middle and spread to the left and right."""


def rec709_to_working() -> np.ndarray:
    """[3, 3] float32 from linear Rec.709 to the scene-linear space of the open file and its OpenColorIO configuration."""
    columns = [Color(axis).from_rec709_linear_to_scene_linear() for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    return np.array(columns, np.float32).T


def linear(rgb: np.ndarray, colour_space: str) -> np.ndarray:
    """Colours [M, 3] of a model's colour space as linear Rec.709, 0 or more."""
    rgb = np.clip(np.nan_to_num(rgb), 0, 100)
    return rgb if colour_space == "linear" else colour.srgb_to_linear(rgb)


def blackbody(kelvin: float) -> np.ndarray:
    """Scene-linear colour [3] of a body that glows, of the luminance 1, within 3 % of Cycles' from 2000 K on.

    Planck's law, seen with the curves of Wyman et al., Simple Analytic Approximations to the CIE XYZ Color Matching Functions (2013).
    """
    nm = np.arange(360.0, 831.0)
    light = nm**-5 / np.expm1(1.4387769e7 / (nm * np.clip(kelvin, 800, 12_000)))
    curves = np.zeros((3, len(nm)))
    for row, height, middle, left, right in LOBES:
        curves[row] += height * np.exp(-0.5 * ((nm - middle) / np.where(nm < middle, left, right)) ** 2)
    xyz = curves @ light
    return np.maximum(Color(xyz / xyz[1]).from_xyz_d65_to_scene_linear(), 0)


def scene_linear(rgb: np.ndarray, weight: np.ndarray, display_referred: bool, working: np.ndarray) -> np.ndarray:
    """Premultiplied scene-linear colour [h, w, 3] of a premultiplied picture with its weight (alpha) [h, w].

    display_referred  whether rgb is sRGB-encoded; otherwise it is linear Rec.709
    working           what rec709_to_working() says
    """
    light = colour.scene_linear(rgb, weight, "srgb" if display_referred else "linear")
    return light if np.allclose(working, np.eye(3), atol=1e-5) else light @ working.T


def film(rgb: np.ndarray, alpha: np.ndarray, background, held: np.ndarray | None = None) -> np.ndarray:
    """Combined [h, w, 4]: premultiplied splats over a background, a colour [3] or picture [h, w, 3], or on transparent film (None).

    held  [h, w]: the light that meshes stop, or None; there the film stays transparent, as Cycles has it behind holdouts
    In memory the last row comes first, as Blender wants it.
    """
    out = np.empty((*alpha.shape, 4), np.float32)[::-1]
    ground = None if background is None else np.broadcast_to(np.asarray(background, np.float32), rgb.shape)

    def piece(first: int, last: int):
        rows = slice(first, last)
        behind = 1 - alpha[rows] if held is None else np.maximum(1 - alpha[rows] - held[rows], 0)
        for c in range(3):  # NumPy takes several times as long for rows of three numbers
            out[rows, :, c] = rgb[rows, :, c] if ground is None else rgb[rows, :, c] + behind * ground[rows, :, c]
        out[rows, :, 3] = alpha[rows] if ground is None else 1 if held is None else 1 - held[rows]

    run(piece, ranges(len(out), ROWS))
    return out
