# SPDX-License-Identifier: GPL-3.0-or-later
"""Prunes a model: leaves out the Gaussians that contribute least to pictures."""
import numpy as np

from ..util.errors import FastGSError
from .gaussians import GaussianModel
from .slicing import sigmoid

MOMENTS = 33
"""Times of the clip at which temporal opacity is looked at."""


def scores(model: GaussianModel, eyes: list | None = None) -> np.ndarray:
    """How much of a picture, and for how long, each Gaussian can be, [N]: the area of its two longer axes before the capture's nearest
    camera (eyes, where they are given; the middle of the model, where none is known), times its opacity over the clip.  0: never drawn.

    As 4DGS-1K's score (Yuan et al. 2025) it is spatial times temporal; what stands before a Gaussian is not looked at.
    """
    eyes = eyes or [camera.position for camera in model.surroundings.cameras] or [np.median(model.position, axis=0)]
    distance = np.min([np.linalg.norm(model.position - np.asarray(eye), axis=1) for eye in eyes], axis=0)
    distance = np.maximum(distance, 0.5 * max(float(np.median(distance)), 1e-9))
    extent = np.sort(np.exp(model.scale.astype(np.float64)), axis=1)
    mean, most = np.zeros(len(model)), np.zeros(len(model))
    for t in np.linspace(0, 1, MOMENTS):
        factor = model.temporal_kind.factor(t, model.mu_tau, model.temporal)
        mean, most = mean + factor / MOMENTS, np.maximum(most, factor)
    opacity = sigmoid(model.opacity)
    life = np.maximum(mean, most / (4 * model.clip.frame_count))  # what lives between two of the times is not lost
    reach = model.temporal_kind.span(np.log(np.maximum(opacity / model.raster.alpha_cut, 1)), model.mu_tau, model.temporal)
    seen = (opacity >= model.raster.alpha_cut) & (reach[1] >= 0) & (reach[0] <= 1)
    return np.where(seen, extent[:, 1] * extent[:, 2] / distance**2 * opacity * np.maximum(life, 1e-12), 0)


def pruned(model: GaussianModel, share: float = 0.0) -> GaussianModel:
    """The model without the Gaussians that are never drawn at any time of the clip, and without this share of the others, those that
    score least.  Raises FastGSError unless the share is from 0 to less than 1."""
    if not 0 <= share < 1:
        raise FastGSError(f"the share of Gaussians to leave out is from 0 to less than 1, not {share!r}.")
    score = scores(model)
    least = np.quantile(score[score > 0], share) if share and (score > 0).any() else 0
    return model.take((score > 0) & (score >= least))
