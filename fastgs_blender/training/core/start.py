# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training run begins with; initial/ makes it."""
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...model.gaussians import GaussianModel


@dataclass(frozen=True, eq=False)
class Start:
    """The first model, and what is known of the scene and of the V views trained on; None: it is not known.

    model   one Gaussian for each starting point, or those of a model that shows the scene (warm)
    sizes   [N] distances between its backdrop's Gaussians, NaN for others (anchor.py)
    depth   how far away is what the cameras film; None: the capture's extent
    frozen  how many Gaussians, the first ones, stay as they are
    gains, fades, clocks  what CameraResponse.initial() takes;  unsure: what CameraTurns.initial() takes
    """

    model: GaussianModel
    sizes: np.ndarray | None = None
    depth: float | None = None
    gains: np.ndarray | None = None
    fades: np.ndarray | None = None
    clocks: np.ndarray | None = None
    warm: bool = False
    frozen: int = 0
    unsure: Mapping[str, float] = field(default_factory=dict)
