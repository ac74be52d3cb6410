# SPDX-License-Identifier: GPL-3.0-or-later
"""Crop boxes: a Gaussian is drawn while its centre lies where the boxes leave the model."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid


@dataclass(frozen=True, eq=False)
class Crop:
    """A box.  Boxes to keep add up; what lies in a box to remove is gone, whatever keeps it.

    matrix  [4, 4] from the model's space to the box's own, in which it reaches from -1 to 1 along each axis.  A matrix with NaN
            is that of a box without an inside.
    remove  whether its inside is removed, rather than kept
    """

    matrix: np.ndarray
    remove: bool = False

    def _key(self):
        return np.asarray(self.matrix, np.float64).tobytes(), bool(self.remove)

    def __eq__(self, other):
        return isinstance(other, Crop) and self._key() == other._key()

    def __hash__(self):
        return hash(self._key())


def crop_arrays(crops) -> tuple[np.ndarray, np.ndarray]:
    """(rows of the matrices [B, 3, 4] float64, remove [B] bool), as kernels take them; boxes to keep come first."""
    ordered = sorted(crops, key=lambda crop: crop.remove)
    rows = np.array([np.asarray(crop.matrix, np.float64)[:3] for crop in ordered]).reshape(-1, 3, 4)
    return np.ascontiguousarray(rows), np.array([crop.remove for crop in ordered], bool)


def kept_by(crops, position: np.ndarray) -> np.ndarray:
    """Which positions [M, 3] in the model's space the boxes leave: [M] bool."""
    rows, remove = crop_arrays(crops)
    kept = np.full(len(position), bool(remove.all()))
    for matrix, removes in zip(rows, remove):
        inside = (np.abs(position @ matrix[:, :3].T + matrix[:, 3]) <= 1).all(1)
        kept = kept & ~inside if removes else kept | inside
    return kept


def cropped(model: GaussianModel, crops, per_frame: int = 2) -> GaussianModel:
    """The model of those Gaussians that the boxes leave at a moment at which they can be seen.

    Moments are taken from the whole clip, per_frame of them in each frame.
    """
    opacity, kept = sigmoid(model.opacity), np.zeros(len(model), bool)
    count = model.clip.frame_count * per_frame
    for t in np.arange(count) / count:
        seen = opacity * model.temporal_kind.factor(t, model.mu_tau, model.temporal) >= model.raster.alpha_cut
        at = np.flatnonzero(seen & ~kept)
        moved, _ = model.basis.evaluate(model.motion[at], t, model.mu_tau[at])
        kept[at] = kept_by(crops, model.position[at] + moved)
    return model.take(kept)
