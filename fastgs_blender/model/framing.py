# SPDX-License-Identifier: GPL-3.0-or-later
"""Separates a model's subject from its surroundings: the backdrop, and stray Gaussians far outside."""
from __future__ import annotations

import numpy as np

from .gaussians import GaussianModel

SPREAD = 3.5
"""The subject reaches up to so many median distances from its middle."""
FEW = 20
"""Of fewer positions none can be told to be a stray."""


def inside_backdrop(model: GaussianModel) -> np.ndarray:
    """Indices [M] of the Gaussians that rest inside a model's backdrop; all where it has none."""
    backdrop = model.surroundings.backdrop
    return np.arange(len(model)) if backdrop is None else np.flatnonzero(backdrop.distance(model.position) <= 1)


def without_backdrop(model: GaussianModel) -> GaussianModel:
    """The model of these Gaussians; the model itself where it has no backdrop."""
    return model if model.surroundings.backdrop is None else model.take(inside_backdrop(model))


def is_subject(position: np.ndarray) -> np.ndarray:
    """Which positions [M, 3] are part of the subject rather than strays or a far background: [M] bool."""
    if len(position) < FEW:
        return np.ones(len(position), bool)
    middle = np.median(position, axis=0)
    away = np.linalg.norm(position - middle, axis=1)
    return away <= SPREAD * np.median(away)
