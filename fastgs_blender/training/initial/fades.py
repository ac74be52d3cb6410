# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds cameras whose exposure changes while they film, from what stands still before them.

Automatic exposure follows what enters the picture.  What stands still then becomes brighter or darker in that camera alone: the median over
its pixels of their change is the camera's, whatever moves before it, as long as that covers less than half of the picture.  A change that
all cameras show is the light's, and belongs to the model.
"""
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...captures.capture import Capture, Shot, by_view
from ...captures.gains import BRIGHT, DARK
from ...captures.pixels.store import FrameStore
from ...training.core.settings import Settings
from .dense import picture, spread

MOMENTS, LEAST_MOMENTS = 16, 5
"""Pictures of each camera that are looked at, and with fewer of which nothing is told."""
SIDE = 96
"""Pixels of these pictures, along the longer side."""
LEAST_PIXELS = 200
"""Pixels that are neither dark nor overexposed at any of these moments, with fewer of which nothing is told."""
NOTICED, SURE = 0.02, 3.0
"""Change of the logarithm of a gain from the middle of the clip to its end, and that change in its standard deviations, below which a
camera counts as steady."""


def fades_of(capture: Capture, store: FrameStore, settings: Settings) -> np.ndarray:
    """How exposures change: for the V views trained on [V, 3] the logarithm of each channel's gain at the end of the clip, where that in
    the middle is 0; it is linear in time.  0 for cameras that are steady or move."""
    found = [_fade(capture, store, settings, shots) for shots in by_view(capture.training).values()]
    fades, errors = (np.array([each[k] for each in found]).reshape(-1, 3) for k in (0, 1))
    known = np.isfinite(errors).all(1)
    if known.sum() < 2:
        return np.zeros_like(fades)
    fades = fades - np.median(fades[known], axis=0)
    size = np.abs(fades).max(1)
    changes = known & (size > NOTICED) & (size > SURE * np.where(known[:, None], errors, np.inf).max(1))
    return np.where(changes[:, None], fades, 0.0)


def _fade(capture: Capture, store: Any, settings: Settings, shots: Sequence[Shot]) -> tuple[np.ndarray, np.ndarray]:
    """The slopes [3] of one camera's brightness over the time -1 to 1, and their standard errors [3], NaN where nothing is told."""
    unknown = np.zeros(3), np.full(3, np.nan)
    shots = spread(shots, MOMENTS)
    if len(shots) < LEAST_MOMENTS or len({shot.camera.world_to_camera.tobytes() for shot in shots}) > 1:
        return unknown
    shown = [picture(capture, store, settings, shot, SIDE) for shot in shots]
    if len({rgb.shape for rgb, _, _ in shown}) > 1:
        return unknown
    colours = np.array([rgb for rgb, _, _ in shown], np.float64)
    usable = ((colours > DARK) & (colours < BRIGHT)).all((0, 3))
    for inside in (inside for _, _, inside in shown if inside is not None):
        usable &= inside > 0.5
    if usable.sum() < LEAST_PIXELS:
        return unknown
    logs = np.log(colours[:, usable])
    curve = np.median(logs - np.median(logs, 0), axis=1)
    time = np.array([2 * shot.t - 1 for shot in shots])
    time = time - time.mean()
    slope = time @ (curve - curve.mean(0)) / (time @ time)
    rest = curve - curve.mean(0) - time[:, None] * slope
    return slope, np.sqrt((rest**2).sum(0) / (len(shots) - 2) / (time @ time))
