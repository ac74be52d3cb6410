# SPDX-License-Identifier: GPL-3.0-or-later
"""Rate control of compression: finds the coarsest step sizes, and the Gaussians to leave out, for a loss in dB that the user allows.

The loss is counted on held-out views.  A model has a PSNR of R dB there.  Compression adds a mean squared error e, independent of the
model's own error, which lowers the PSNR by 10 log10(1 + e / 10^(-R/10)) dB.  All figures here follow this convention.  R is stated in the
model's provenance (HELD_OUT); else it is NOMINAL.
"""
from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..model.temporal import Radial
from ..util.curve import hilbert_order
from ..util.errors import FastGSError
from .quantising import Prepared, Steps, canonical, prepared
from .refit import OUTLIER, as_read, in_parts
from .sensitivity import mean_square, pictures, sensitivity, shots
from .thinning import NEAR as REFITTED
from .thinning import thinned, worthy

PARTS = "parts"
"""What a part of allotted() calls the bits of the model's parts, bool [n, P]."""
NOMINAL = 32.0
"""dB of held-out views: what Spacetime Gaussians and its successors report on Neural 3D Video."""
HELD_OUT = "held_out_psnr"
"""Key of the provenance: dB of the views of its capture that the model was not trained on."""
LEVELS = {"fine": 0.09, "small": 0.283}
"""Losses in dB by name: they are to stay below 0.1 and 0.3 dB in views that they were not judged by."""
BETWEEN = 0.76
"""Of what may be lost, where a model tells the cameras of its capture.  A camera at the border of the rig, which has fewer neighbours,
loses more than those that the model is judged by: up to twice as much.  Cameras that are guessed are spread wider."""
FEW = 12_000
"""Gaussians.  A smaller model may lose less, down to half: the error of each of its pictures comes from few Gaussians, so that pictures
differ more from those that were judged; and its file hardly becomes smaller by it."""
LEAST, MOST = 0.001, 10.0
"""dB that may be lost."""
LOWEST, HIGHEST = 15.0, 50.0
"""Range in dB in which the PSNR of a provenance is believed."""
SHOTS, JUDGED = 250, 24
"""Numbers of pictures: of those that sensitivities are measured on, and of others that the loss is measured on."""
SHOWN = 676
"""Pixels of the longer side of the pictures that the loss is measured on and that a model is refitted to: about what a viewport or a
print on a page shows.  Judged at 400 pixels, one model lost half as much again at 676, and another a fifth less."""
SENSING = 0.5
"""Share of the time of allotted() that measuring sensitivities takes."""
TRIALS = 9
HASTE = 0.6
"""For the progress bar: the share of the remaining work that remains after a trial, as the number of trials is not known."""
NEAR, ROUGHLY = 0.95, 0.6
"""The search ends where the error is at least this share of the allowed error: without refitting, and in the search before it.  The one
after refitting ends at thinning.NEAR."""
QUICK = 0.1
"""dB up to which a model is not refitted."""
REFITTING = 0.85
"""Share of the time of allotted() that leaving out and refitting take."""
THIN = 0.1
"""Pixels.  Thinner Gaussians look the same as this, because the rasteriser's blur is wider."""
LASTING = 0.002
"""Exponent of temporal opacity within the clip below which a Gaussian lasts for ever."""


@dataclass(frozen=True)
class Loss:
    """How much held-out views may lose by compression, in decibels.

    span   the times that are looked at, for a piece of a long clip, which is seen for a part of it
    share  of the error that may come from this model, where others are in the same pictures
    """

    decibels: float
    span: tuple[float, float] = (0.0, 1.0)
    share: float = 1.0

    @classmethod
    def of(cls, value: float | str) -> Loss:
        """A loss by its name in LEVELS, or in dB; raises FastGSError."""
        with contextlib.suppress(TypeError, ValueError):
            decibels = float(LEVELS.get(str(value), value))
            if LEAST <= decibels <= MOST:
                return cls(decibels)
        raise FastGSError(f"a file is compressed {' or '.join(LEVELS)}, or by a loss from {LEAST:g} to {MOST:g} dB, not {value!r}.")

    def error(self, model: GaussianModel) -> float:
        """The mean squared error of the judged pictures at which other views lose no more, as far as BETWEEN and FEW tell."""
        share = self.share * (BETWEEN if model.surroundings.cameras else 1.0) * min(1.0, max(0.5, len(model) / FEW))
        return share * 10 ** (-held_out(model) / 10) * (10 ** (self.decibels / 10) - 1)


def held_out(model: GaussianModel) -> float:
    """The PSNR of a model's held-out views in dB, as far as it is known."""
    with contextlib.suppress(ValueError):
        found = float(model.provenance.get(HELD_OUT, NOMINAL))
        if LOWEST <= found <= HIGHEST:
            return found
    return NOMINAL


def allotted(model: GaussianModel, loss: Loss, segment: int, progress: Callable[[float], None]
             ) -> list[tuple[dict[str, np.ndarray], Steps]]:
    """The model quantised as coarsely as the loss allows, in parts of at most `segment` Gaussians along a curve through space.

    One number, the level, decides the step sizes and which Gaussians are left out: log2 of the error that each parameter may add.  It is
    searched on pictures that were not used to measure sensitivities.  For a loss above QUICK more Gaussians are left out, and the others
    are refitted (thinning.py).  Raises FastGSError where no level is good enough.  progress is called with 0..1; exceptions that it raises
    pass through.
    """
    if not len(model):
        return []
    original, refit = model, loss.decibels > QUICK
    series, judged = shots(model, SHOTS, span=loss.span), shots(model, JUDGED, SHOTS, SHOWN, loss.span)
    truth, allowed = pictures(model, judged), loss.error(model)
    model = plain(canonical(model.take(hilbert_order(model.position))), [shot.camera for shot in series])
    first = 1 - REFITTING if refit else 1.0
    found = sensitivity(model, series, lambda share: progress(first * SENSING * share))

    def tried(ready: Prepared, level: float) -> tuple[list, float]:
        """The parts at a level, and the mean squared error of their pictures."""
        parts = in_parts(ready, level, segment)
        square = usual_square(truth, pictures(replace(ready.model, **as_read(parts, ready.model)), judged))
        bits = ready.model.parts.bits  # nothing is measured by them, but they come in the Gaussians' new order
        return [(codes | {PARTS: bits[i * segment:(i + 1) * segment]}, steps) for i, (codes, steps) in enumerate(parts)], square

    numbers = sum(array[0].size for array in model.arrays.values()) * len(model)
    def plainly(level: float) -> tuple[list, float]:
        """tried(), without refitting, of the Gaussians that are worth their bits."""
        keep = worthy(model, found, level)
        return tried(prepared(model.take(keep), found.take(keep)), level)

    level, parts = search(plainly, 0.5 * float(np.log2(12 * allowed / numbers)) - 1.7, allowed, ROUGHLY if refit else NEAR,
                          lambda share: progress(first * (SENSING + (1 - SENSING) * share)))
    if parts is None:
        raise FastGSError(f"its pictures would lose more than {loss.decibels:g} dB however finely it is kept; allow a greater loss.")
    if not refit:
        return parts
    again, level = thinned(model, found, level, segment, original, SHOTS + JUDGED, SHOWN,
                           lambda ready, level: tried(ready, level)[1] / allowed,
                           lambda share: progress(first + 0.9 * REFITTING * share), loss.span)
    return search(lambda level: tried(again, level), level, allowed, REFITTED,
                  lambda share: progress(first + REFITTING * (0.9 + 0.1 * share)))[1] or parts


def usual_square(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """Mean squared difference of two series of pictures, each of at most OUTLIER times the median of all.

    A few cameras may have come to lie next to a Gaussian, or look where the model was hardly filmed.  Their pictures lose up to 25 times as
    much as others, and would decide alone how finely a model is kept.
    """
    squares = np.array([mean_square([one], [other]) for one, other in zip(first, second, strict=True)])
    return float(np.minimum(squares, OUTLIER * np.median(squares)).mean())


def search(tried: Callable[[float], tuple[Any, float]], level: float, most: float, near: float, progress: Callable[[float], None]
           ) -> tuple[float, Any]:
    """Search the level whose error is just below `most`; the error rises with the level.

    tried(level) gives (result, error).  The search ends early at an error from near * most to most, else after TRIALS trials.
    Returns the estimated level for the error `most`, and the best result with an error of at most `most`: None where there is none.
    """
    low, high, share, best = -np.inf, np.inf, 1.0, None
    for k in range(TRIALS):
        found, error = tried(level)
        progress(1 - HASTE ** (k + 1))
        if error <= most:
            best, low, share = found, level, error / most
            if error >= near * most:
                break
        else:
            high = level
        level += float(np.clip(0.5 * np.log2(0.5 * (1 + near) * most / max(error, 1e-12)), -2, 2))
        if not low < level < high:
            level = 0.5 * (max(low, high - 4) + min(high, low + 4))
    return low - 0.5 * float(np.log2(max(share, 1 / 16))), best


def plain(model: GaussianModel, cameras: list[Camera]) -> GaussianModel:
    """The model with differences removed that no picture shows: axes far thinner than a pixel, lifetimes far longer than the clip."""
    eyes = np.unique([np.linalg.inv(camera.world_to_camera)[:3, 3] for camera in cameras], axis=0)
    distance = np.min([np.linalg.norm(model.position - eye, axis=1) for eye in eyes], axis=0)
    distance = np.maximum(distance, 0.3 * max(float(np.median(distance)), 1e-9))
    thin = THIN * distance / max(camera.fx for camera in cameras)
    temporal = model.temporal
    if isinstance(model.temporal_kind, Radial):
        reach = np.maximum(1, np.maximum(model.mu_tau.astype(np.float64) ** 2, (1 - model.mu_tau.astype(np.float64)) ** 2))
        temporal = np.maximum(temporal, np.log(LASTING / reach)[:, None])
    return replace(model, scale=np.maximum(model.scale, np.log(thin)[:, None]), temporal=temporal)
