# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulls the features of backdrop Gaussians that pictures hardly show towards their first values.

Adam's steps are as long for a Gaussian at the edge of one picture as for one in the middle of all pictures.  Gaussians of the
backdrop at the edge of what was filmed would take on any colour that helps the fringe, and a camera that stands elsewhere would see
blotches.  A pull towards the first colours, as strong as a few pixels, decides where there are no more pixels than that.
"""
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...model.surroundings import Backdrop

ANCHOR = "anchor"
"""Name of the optimiser's array [N, F] of the features that Gaussians are pulled to, NaN in rows that are free.  It is not trained; density
control copies it with its row."""
OFF, PIXELS = 0.1, 100.0
"""Difference in a feature at which the pull is as strong as the gradient of so many pixels."""

INNERMOST = 1.5
"""Least radius of the backdrop, in distances of the farthest camera from what all look at."""


def anchor_features(features: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The values [N, F] to anchor features at: those given for points with a known size [N] (backdrop.py), NaN for all others."""
    return np.where(np.isfinite(sizes)[:, None], features, np.nan).astype(np.float32)


def backdrop_of(arrays: dict[str, np.ndarray], around: Sequence[float]) -> Backdrop | None:
    """The sphere outside of which the anchored Gaussians, and what lies behind them, are; None where none is anchored.

    around  x, y, z of the place that all cameras look at, and the distance from there of the farthest camera
    A few that training drew nearer than INNERMOST of that distance do not make the sphere smaller.  Raises FastGSError for numbers that
    are no place.
    """
    anchored = np.isfinite(arrays[ANCHOR]).all(1) if ANCHOR in arrays else np.zeros(0, bool)
    if not anchored.any():
        return None
    x, y, z, farthest = around
    outermost = Backdrop((x, y, z), max(INNERMOST * farthest, 1e-6))
    nearest = float(outermost.distance(arrays["position"][anchored]).min())
    return replace(outermost, radius=outermost.radius * max(0.99 * nearest, 1.0))


def anchor(backend: Any, arrays: dict, gradients: dict, rows: Any, pixels: int) -> None:
    """Add the pull to the gradient of the features of those rows (of the backend) that are anchored.

    pixels  in a picture: each counts 1 / (3 pixels) in the mean absolute difference of three channels
    """
    if ANCHOR in arrays:
        backend.anchor(arrays["features"], arrays[ANCHOR], gradients["features"], rows, PIXELS / (3 * OFF * pixels))
