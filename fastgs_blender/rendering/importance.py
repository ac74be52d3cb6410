# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranks the Gaussians of a model by importance, for pictures that show only some of them."""
import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..util.kept import kept


@kept
def importance_rank(model: GaussianModel) -> np.ndarray:
    """[N] float32 from 0, the most important Gaussian, up to 1: by the area that it covers at most, times its opacity; kept while
    the model lives."""
    size = np.sort(model.scale, axis=1)
    weight = np.nan_to_num(size[:, 1] + size[:, 2] + np.log(sigmoid(model.opacity) + 1e-12), nan=-np.inf)
    rank = np.empty(len(model), np.float32)
    rank[np.argsort(-weight, kind="stable")] = np.arange(len(model)) / max(len(model), 1)
    return rank
