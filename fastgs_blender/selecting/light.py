# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light of a picture comes from each Gaussian: the sum of its blending weights over pixels."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import RGB
from ..model.gaussians import GaussianModel
from ..util.backends import load_backend


def light(model: GaussianModel, camera: Camera, t: float, mask: np.ndarray | None = None) -> np.ndarray:
    """Sums of blending weights [N, 2] of each Gaussian over a picture, in pixels: over those of a mask [h, w] (0..1), and over all.

    Blending is linear in the colours, so that these are the picture's gradients by colours.  What hides a Gaussian lowers its sums.
    """
    backend = load_backend("cpu")
    plain = replace(model, features=np.full((len(model), 3), 0.5, np.float32), appearance=RGB())
    parameters = {name: backend.array(array) for name, array in plain.arrays.items()}
    picture = backend.forward(parameters, plain, camera, float(t))
    wanted = np.zeros((*backend.numpy(picture.alpha).shape, 3), np.float32)
    wanted[..., 0], wanted[..., 1] = 0 if mask is None else mask, 1
    return backend.numpy(backend.backward(picture, backend.array(wanted))["features"])[:, :2].astype(np.float64)
