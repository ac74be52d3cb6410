# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures a model on shots of its capture, quickly: for previews and the report of a run (evaluation/ has all measures)."""
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...captures.capture import Capture, Shot
from ...evaluation import halves
from ...evaluation.metrics import psnr
from ...model.gaussians import GaussianModel
from ...rendering.api import render
from .settings import Settings
from .targets import cover_of, use_of_mask


def measure(model: GaussianModel, capture: Capture, store: Any, settings: Settings, shots: Sequence[Shot], backend: str = "cpu",
            fit_colours: bool = False) -> tuple[float, float | None, list]:
    """(mean PSNR of shots, that of their foreground where masks show it or None, [(picture, truth)] of each, over black).

    fit_colours  colours of each half of a picture are fitted on its other half (evaluation/halves.py)
    """
    whole, part, pictures = [], [], []
    for shot in shots:
        assert shot.camera is not None
        pixels = store.pixels(shot)
        picture = render(model, shot.camera, shot.t, ("rgb",), backend)["rgb"]
        cover = cover_of(use_of_mask(settings, capture, shot, pixels.mask), pixels)
        truth = pixels.rgb if cover is None else pixels.rgb * cover[..., None]
        picture = halves.fitted(picture, truth, pixels.valid) if fit_colours else picture
        whole.append(psnr(picture, truth))
        if pixels.mask is not None:
            part.append(psnr(picture, truth, pixels.mask))
        pictures.append((picture, truth))
    part = [value for value in part if np.isfinite(value)]
    return float(np.mean(whole)), float(np.mean(part)) if part else None, pictures
