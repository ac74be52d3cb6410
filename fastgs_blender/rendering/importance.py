# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranks the Gaussians of a model by importance, for pictures that show only some of them."""
import threading
from weakref import WeakKeyDictionary

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid

_ranks: WeakKeyDictionary = WeakKeyDictionary()
_lock = threading.Lock()


def importance_rank(model: GaussianModel) -> np.ndarray:
    """[N] float32 from 0, the most important Gaussian, up to 1: by the area that it covers at most, times its opacity."""
    size = np.sort(model.scale, axis=1)
    weight = np.nan_to_num(size[:, 1] + size[:, 2] + np.log(sigmoid(model.opacity) + 1e-12), nan=-np.inf)
    rank = np.empty(len(model), np.float32)
    rank[np.argsort(-weight, kind="stable")] = np.arange(len(model)) / max(len(model), 1)
    return rank


def kept_rank(model: GaussianModel) -> np.ndarray:
    """importance_rank(), kept while the model lives."""
    with _lock:
        found = _ranks.get(model)
    if found is None:
        found = importance_rank(model)
        with _lock:
            _ranks[model] = found
    return found
