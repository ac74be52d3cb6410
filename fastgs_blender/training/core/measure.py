# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures a model on shots of its capture, quickly: for previews and the report of a run (evaluation/ has all measures)."""
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ...captures.capture import Capture, Shot
from ...evaluation import halves
from ...evaluation.metrics import psnr
from ...model.sequence import Source
from ...rendering.api import render
from .settings import Settings
from .targets import cover_of, use_of_mask


def measure(model: Source, capture: Capture, store: Any, settings: Settings, shots: Iterable[Shot], backend: str = "cpu",
            fit_colours: bool = False, pictures: list | None = None,
            progress: Callable[[int, int], None] = lambda done, of: None) -> tuple[float, float | None]:
    """(mean PSNR of shots, that of their foreground where masks show it or None), over black.

    fit_colours  colours of each half of a picture are fitted on its other half (evaluation/halves.py)
    pictures     gets (picture, truth) of each;  progress(done, of) is called after each, of those that the capture holds out
    """
    whole, part = [], []
    for shot in shots:
        assert shot.camera is not None
        pixels = store.pixels(shot)
        picture = render(model, shot.camera, shot.t, ("rgb",), backend)["rgb"]
        cover = cover_of(use_of_mask(settings, capture, shot, pixels.mask), pixels)
        truth, mask = pixels.rgb if cover is None else pixels.rgb * cover[..., None], pixels.mask
        picture = halves.fitted(picture, truth, pixels.valid) if fit_colours else picture
        whole.append(psnr(picture, truth, pixels.valid))
        if mask is not None:
            part.append(psnr(picture, truth, mask if pixels.valid is None else mask * pixels.valid))
        if pictures is not None:
            pictures.append((picture, truth))
        progress(len(whole), len(capture.held_out))
    part = [value for value in part if np.isfinite(value)]
    return float(np.mean(whole)), float(np.mean(part)) if part else None
