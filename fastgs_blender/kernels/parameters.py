# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of a model in training: a dictionary of its arrays, with the decoder's matrices among them."""
from dataclasses import replace
from typing import Any

import numpy as np

from ..model.appearance import Features
from ..model.gaussians import GaussianModel

DECODER = ("w1", "w2")
"""Parameters of the whole model: the decoder's matrices [6, 12] and [3, 6].  All others have a row for each Gaussian."""


def model_of(template: GaussianModel, parameters: dict[str, np.ndarray]) -> GaussianModel:
    """The template with the parameters instead of its own arrays: float32, not copied; what else `parameters` holds is ignored."""
    fields: dict[str, Any] = {name: parameters[name] for name in template.arrays}
    decoder: dict[str, Any] = {name: parameters[name] for name in DECODER if name in parameters}
    appearance = template.appearance
    return replace(template, appearance=replace(appearance, **decoder) if isinstance(appearance, Features) else appearance, **fields)
