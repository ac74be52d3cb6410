# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of a model in training: a dictionary of its arrays, with the decoder's matrices among them."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.gaussians import GaussianModel

DECODER = ("w1", "w2")
"""Parameters of the whole model: the decoder's matrices [6, 12] and [3, 6].  All others have a row for each Gaussian."""


def model_of(template: GaussianModel, parameters: dict[str, np.ndarray]) -> GaussianModel:
    """The template with the parameters instead of its own arrays: float32, not copied; what else `parameters` holds is ignored."""
    fields = {name: parameters[name] for name in template.arrays}
    decoder = {name: parameters[name] for name in DECODER if name in parameters}
    return replace(template, appearance=replace(template.appearance, **decoder), **fields)
