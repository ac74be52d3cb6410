# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks sharpness: cameras that are out of focus or blurred by motion."""
from collections.abc import Sequence

import numpy as np

from . import drawing
from .report import Section, listed, rounded
from .samples import Inspection

SOFTER, SOFT = 0.9, 1.6
"""Pixels of blur more than the other cameras above which a camera is reported; pixels of blur above which all cameras are."""


def run(inspection: Inspection) -> Section:
    """The blur of each camera against the others'."""
    blur = {view: _middle([sample.blur for sample in samples]) for view, samples in inspection.samples.items()}
    known = np.array([value for value in blur.values() if np.isfinite(value)])
    usual = float(np.median(known)) if len(known) else np.nan
    section = Section("Sharpness", "How many pixels of blur each camera has, from the contrast of fine details against that of coarse ones "
                      "where there is texture; a sharp picture has less than 1.")
    soft = [view for view, value in blur.items() if len(known) > 2 and value > usual + SOFTER]
    for view in soft:
        section.add("poor", f"{view} is blurred by about {blur[view]:.1f} pixels, the others by {usual:.1f}: what it alone sees stays "
                    "soft, and it pulls down what others see.", "Film again with the focus set by hand, or leave that camera out with the "
                    "capture's list of cameras or as a held-out view.", [view], ("blur", blur[view], "pixels"))
    if len(known) and usual > SOFT:
        scale = max(0.25, round(1 / usual, 2))  # where the blur is about one pixel
        section.add("poor", f"All cameras are blurred by about {usual:.1f} pixels.",
                    f"Train with --scale {scale:g}: it loses no detail and is faster.", (), ("blur", usual, "pixels"))
    blind = [view for view, value in blur.items() if not np.isfinite(value)]
    if blind:
        section.add("note", f"The sharpness of {listed(blind)} cannot be measured: the pictures have too little texture or are too small.",
                    "Look at them in full size.", blind)
    section.pictures.append(drawing.bars("Blur of each camera in pixels of the pictures as they are trained on.", blur, "px",
                                         dict.fromkeys(soft, "poor")))
    section.columns = {"Blur": {view: f"{value:.1f} px" if np.isfinite(value) else "?" for view, value in blur.items()}}
    section.measures = {"blur_pixels": {view: rounded(value) for view, value in blur.items()}}
    return section


def _middle(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else np.nan
