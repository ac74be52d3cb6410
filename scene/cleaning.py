# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a model had better be hidden, for reasons that an artist can see: Clean Up proposes it."""
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..fastgs_blender.model.gaussians import GaussianModel
from ..fastgs_blender.model.slicing import positions_at, sigmoid
from ..fastgs_blender.rendering.filters import values

LONELY = 5.0
"""Others around a Gaussian up to which it is a floater, at the amount 1."""
NEEDLE, LONG = 8.0, 20.0
"""A needle is so many times longer than it is thick, and than is usual, at the amount 1; at a smaller one, more."""
BEFORE = 0.25
"""Haze hangs nearer to a camera than this share of the way to what it looks at, at the amount 1."""
FAINT = 0.6
"""Opacity up to which Gaussians are haze."""
FEW = 2.0
"""Cameras that filmed a Gaussian up to which it was hardly seen, at the amount 1."""


def _floaters(model: GaussianModel, amount: float) -> np.ndarray:
    return values(model, "NEIGHBOURS") <= LONELY * amount


def _needles(model: GaussianModel, amount: float) -> np.ndarray:
    size = np.sort(np.exp(model.scale.astype(np.float64)), 1)
    usual = np.median(size[:, 2]) if len(size) else 1.0
    return (size[:, 2] * amount > NEEDLE * size[:, 1]) & (size[:, 2] * amount > LONG * usual)


def _haze(model: GaussianModel, amount: float) -> np.ndarray:
    place, faint = np.nan_to_num(positions_at(model, 0.5)), sigmoid(model.opacity) <= FAINT
    out = np.zeros(len(model), bool)
    middle = np.median(place, 0) if len(place) else np.zeros(3)
    for camera in model.surroundings.cameras:
        at = np.array(camera.position, np.float64)
        out |= ((place - at) ** 2).sum(1) < (BEFORE * amount) ** 2 * ((middle - at) ** 2).sum()
    return out & faint


def _unseen(model: GaussianModel, amount: float) -> np.ndarray:
    if not model.surroundings.cameras:
        return np.zeros(len(model), bool)
    return values(model, "CAMERAS") <= FEW * amount - 1


REASONS: dict[str, tuple[str, str, Callable[[GaussianModel, float], np.ndarray]]] = {
    "floaters": ("Floaters", "Gaussians that have hardly any others around them", _floaters),
    "needles": ("Needles", "Long and thin Gaussians, much larger than is usual", _needles),
    "haze": ("Haze before Cameras", "Faint Gaussians close before the cameras that filmed the capture, if the file knows them", _haze),
    "unseen": ("Hardly Filmed", "Gaussians that hardly any camera had in its pictures, if the file knows the cameras", _unseen),
}
"""By name: its label, what it means, and which Gaussians [N] bool of a model are meant at an amount 0..1."""


def proposed(model: GaussianModel, amount: float, reasons: set[str]) -> dict[str, np.ndarray]:
    """Which Gaussians [N] bool had better be hidden, by the reason; a Gaussian stands under the first of its reasons alone.

    The backdrop is left alone: it has few neighbours, and no camera is near it.
    """
    backdrop, out = model.surroundings.backdrop, {}
    left = np.ones(len(model), bool) if backdrop is None else backdrop.distance(model.position) <= 1
    for name, (_, _, find) in REASONS.items():
        if name in reasons and amount > 0:
            out[name] = left & find(model, amount)
            left &= ~out[name]
    return out
