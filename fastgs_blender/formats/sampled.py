# SPDX-License-Identifier: GPL-3.0-or-later
"""Antialiasing for files that hold no cameras: the capture's sampling limit becomes a part of the Gaussians (rendering/distance.py).

The blur b that a pixel of the size F adds to a splat is added to the Gaussian itself, b F^2 to each of its squared standard deviations, and
the file says that it is antialiased.  Viewers that follow it (Mip-Splatting's mode: PlayCanvas, SuperSplat, Brush and others) then draw
views in finer pixels as smooth as the capture was, and views in coarser ones as faint.  At the size of the training the picture is a
little softer, because their own blur comes on top.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.gaussians import GaussianModel
from ..rendering.distance import Sampling


def sampled(model: GaussianModel, captured: Sampling) -> GaussianModel:
    """A static model with the sampling limit in its Gaussians; as it is where it is antialiased already."""
    if model.raster.antialiased:
        return model
    variance = np.exp(2 * model.scale.astype(np.float64))
    finest = captured.finest(model.position.astype(np.float64), np.sqrt(variance.max(1, initial=0)))
    return replace(model, scale=0.5 * np.log(variance + model.raster.blur * finest[:, None] ** 2),
                   raster=replace(model.raster, antialiased=True), surroundings=replace(model.surroundings, cameras=()))
