# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the empty model that the settings describe, and a model from the arrays that an optimiser holds."""
from dataclasses import replace

import numpy as np

from ...kernels.parameters import model_of
from ...model import fitting
from ...model.appearance import RGB, SH, Features
from ...model.gaussians import Clip, GaussianModel, Raster
from ...model.motion import Basis, Polynomial, Static, trained_motions
from ...model.temporal import Always, Radial
from ...training.core.settings import Settings
from ...util.errors import FastGSError

PLACE = slice(6, 9)
"""The decoder's inputs that say where the camera is."""


def motion_basis(motion: str, order: int, clip: Clip) -> Basis:
    """The basis of positions for a clip; order 0 chooses the usual order, with at most 0.4 coefficients per frame.

    But for the printed form the clip covers just the part of the period that leaves motion free (motion-bases study):
    half-period cosines run from the first frame to the last, the Fourier series over the middle 80 % of its period.
    """
    if motion == "static" or clip.frame_count < 2:
        return Static()
    last = (clip.frame_count - 1) / clip.frame_count
    offered = trained_motions(last)
    if motion not in offered:
        raise FastGSError(f"the motion {motion!r} is unknown; there are static, {', '.join(offered)}.")
    make, usual = offered[motion]
    if order:
        return make(order)
    most = max(int(fitting.SAFE * clip.frame_count), 1)
    while motion != "paper" and usual > 1 and make(usual).terms > most:
        usual -= 1
    return make(usual)


def empty_model(settings: Settings, clip: Clip, axes: str) -> GaussianModel:
    """A model of the settings' kinds without any Gaussian.  A clip of one frame gives a model without time."""
    still = clip.frame_count < 2
    if settings.appearance == "features":
        w1 = np.random.default_rng([settings.seed, 1]).uniform(-1, 1, (6, 12)) / np.sqrt(12)
        if not settings.decoder_place:
            w1[:, PLACE] = 0
        # at first every Gaussian shows its base colour
        look: Features | RGB | SH = Features(w1, np.zeros((3, 6)), settings.activation, settings.decode)
    else:
        look = RGB() if settings.appearance == "rgb" else SH(int(settings.appearance[2:]))
    return GaussianModel(
        np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, look.width)),
        basis=motion_basis(settings.motion, settings.order, clip),
        rotation_basis=Static() if still or not settings.rotation_degree else Polynomial(settings.rotation_degree),
        temporal_kind=Always() if still or settings.temporal == "always" else Radial(),
        appearance=look, raster=Raster(antialiased=settings.antialiased), clip=clip, axes=axes)


def with_arrays(template: GaussianModel, arrays: dict[str, np.ndarray], provenance: dict[str, str] | None = None) -> GaussianModel:
    """The template with what an optimiser trains instead of its own arrays (kernels/parameters.py), and a provenance."""
    return replace(model_of(template, arrays), provenance=provenance or {})


def lasting(model: GaussianModel) -> GaussianModel:
    """The model without the Gaussians that can never be seen."""
    with np.errstate(over="ignore"):
        peak = 1 / (1 + np.exp(-model.opacity.astype(np.float64)))
    return model.take(np.flatnonzero(peak >= model.raster.alpha_cut))
