# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
from __future__ import annotations

import numpy as np

from .camera import Camera
from .model import GaussianModel

PASSES = {"rgb": 3, "alpha": 1, "depth": 1, "median_depth": 1}
"""Passes and their channels."""


def render(model: GaussianModel | list, camera: Camera, t: float = 0.0, passes=("rgb", "alpha"), backend: str = "auto",
           progress=None) -> dict[str, np.ndarray]:
    """Render 4D Gaussians at time t."""
    raise NotImplementedError
