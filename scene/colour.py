# SPDX-License-Identifier: GPL-3.0-or-later
"""Converts the library's colours to Blender's scene-linear ones, once, after blending.

Captures are display-referred: their Gaussians were fitted by blending sRGB numbers, so they are blended as such, and the
blended colour of a pixel is decoded afterwards, without the alpha in it.  docs/colour.md says what that means for artists.
"""
import numpy as np
from mathutils import Color

from ..fastgs_blender.rendering.colour import srgb_to_linear, straight


def rec709_to_working() -> np.ndarray:
    """[3, 3] float32 from linear Rec.709 to the scene-linear space of the open file and its OpenColorIO configuration."""
    columns = [Color(axis).from_rec709_linear_to_scene_linear() for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    return np.array(columns, np.float32).T


def scene_linear(rgb: np.ndarray, weight: np.ndarray, display_referred: bool, working: np.ndarray) -> np.ndarray:
    """Premultiplied scene-linear colour [h, w, 3] of a premultiplied picture with its weight (alpha) [h, w].

    display_referred  whether rgb is sRGB-encoded; otherwise it is linear Rec.709
    working           what rec709_to_working() says
    """
    colour = straight(rgb, weight)
    if display_referred:
        colour = srgb_to_linear(colour)
    if not np.allclose(working, np.eye(3), atol=1e-5):
        colour = colour @ working.T
    return (colour * weight[..., None]).astype(np.float32)


def film(rgb: np.ndarray, alpha: np.ndarray, background, held: np.ndarray | None = None) -> np.ndarray:
    """Combined [h, w, 4]: premultiplied splats over a background, a colour [3] or picture [h, w, 3], or on transparent film (None).

    held  [h, w]: the light that meshes stop, or None; there the film stays transparent, as Cycles has it behind holdouts
    """
    out = np.concatenate([rgb, alpha[..., None]], -1).astype(np.float32)
    if background is not None:
        behind = 1 - out[..., 3:] if held is None else np.maximum(1 - out[..., 3:] - held[..., None], 0)
        out[..., :3] += behind * np.asarray(background, np.float32)
        out[..., 3] = 1 if held is None else 1 - held
    return out
