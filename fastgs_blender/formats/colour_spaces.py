# SPDX-License-Identifier: GPL-3.0-or-later
"""Static models with spherical harmonics in another colour space."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.appearance import sh_basis
from ..model.gaussians import GaussianModel
from ..rendering.colour import linear_to_srgb, srgb_to_linear

DIRECTIONS = 200
CHUNK = 1 << 11


def in_colour_space(model: GaussianModel, colour_space: str) -> GaussianModel:
    """The static model with the colours it shows in "srgb" or "linear".

    Colours that are the same from everywhere are exact.  Others are converted in DIRECTIONS directions, and the harmonics of the same
    degree that fit these best take their place.
    """
    if model.colour_space == colour_space:
        return model
    convert = linear_to_srgb if colour_space == "srgb" else srgb_to_linear
    height = np.linspace(-1, 1, DIRECTIONS + 2)[1:-1]
    angle = np.arange(DIRECTIONS) * np.pi * (3 - np.sqrt(5))  # a spiral over the sphere
    flat = np.sqrt(1 - height**2)
    basis = sh_basis(np.stack([flat * np.cos(angle), flat * np.sin(angle), height], 1), model.appearance.degree)
    fit = np.linalg.pinv(basis)
    features = np.empty_like(model.features)
    for start in range(0, len(model), CHUNK):
        rows = slice(start, start + CHUNK)
        coefficients = model.features[rows].reshape(len(model.features[rows]), -1, 3).astype(np.float64)
        shown = convert(np.maximum(0.5 + np.einsum("db,nbc->ndc", basis, coefficients), 0))
        features[rows] = np.einsum("bd,ndc->nbc", fit, shown - 0.5).reshape(len(coefficients), -1)
    return replace(model, features=features, colour_space=colour_space)
