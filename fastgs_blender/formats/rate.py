# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely a model is kept, and which of its Gaussians, so that its pictures lose no more than they may.

A model that is R dB from the truth in views that it was not trained on loses 10 log10(1 + e / 10^(-R/10)) dB there by a mean squared
error e of its pictures that has nothing to do with its own: the convention of all figures here.  R is what the model's provenance says
(HELD_OUT), NOMINAL where it says nothing.
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
from ..util.errors import FastGSError
from .curve import hilbert_order
from .quantising import Steps, canonical, prepared, quantised, restored
from .sensitivity import mean_square, pictures, removal, sensitivity, shots

NOMINAL = 32.0
"""dB of held-out views: what Spacetime Gaussians and its successors report on Neural 3D Video."""
HELD_OUT = "held_out_psnr"
"""Key of the provenance: dB of the views of its capture that the model was not trained on."""
LEVELS = {"fine": 0.085, "small": 0.3}
"""Losses in dB by name; fine is to stay below 0.1 dB in views that it was not judged by."""
LEAST, MOST = 0.001, 10.0
"""dB that may be lost."""
LOWEST, HIGHEST = 15.0, 50.0
"""dB that a provenance is believed."""
SHOTS, JUDGED = 64, 12
"""Pictures that sensitivities are measured on, and others that the loss is measured on."""
COST = 60.0
"""Bits that are taken to be saved by leaving a Gaussian out: fewer than they are, for errors of neighbours that are left out add up."""
HARM = COST * 2 * np.log(2) / 12
"""A bit more for a number with an error uniform over a step of 2^level / root of its sensitivity takes 4^level 2 ln 2 / 12 of error away: a
Gaussian is left out where that is less harm than its bits would mend elsewhere."""
TRIALS = 9
NEAR = 0.95
"""The search ends where the error is this share of what is allowed, or more."""
THIN = 0.1
"""Pixels: a Gaussian that is thinner still looks the same, because the rasteriser's blur is wider."""
LASTING = 0.002
"""Exponent of temporal opacity within the clip below which a Gaussian lasts for ever."""



@dataclass(frozen=True)
class Loss:
    """How much held-out views may lose by compression, in decibels."""

    decibels: float

    @classmethod
    def of(cls, value: float | str) -> Loss:
        """A loss by its name in LEVELS, or in dB; raises FastGSError."""
        with contextlib.suppress(TypeError, ValueError):
            decibels = float(LEVELS.get(value, value))
            if LEAST <= decibels <= MOST:
                return cls(decibels)
        raise FastGSError(f"a file is compressed {' or '.join(LEVELS)}, or by a loss from {LEAST:g} to {MOST:g} dB, not {value!r}.")

    def error(self, model: GaussianModel) -> float:
        """The mean squared error of a model's pictures that loses them."""
        return 10 ** (-held_out(model) / 10) * (10 ** (self.decibels / 10) - 1)


def held_out(model: GaussianModel) -> float:
    """The PSNR of a model's held-out views in dB, as far as it is known."""
    with contextlib.suppress(ValueError):
        found = float(model.provenance.get(HELD_OUT, NOMINAL))
        if LOWEST <= found <= HIGHEST:
            return found
    return NOMINAL


def allotted(model: GaussianModel, loss: Loss, segment: int) -> list[tuple[dict[str, np.ndarray], Steps]]:
    """The model quantised as coarsely as the loss allows, in parts of at most `segment` Gaussians along a curve through space.

    How coarsely numbers are kept, and which Gaussians at all, follows from one number, the level: the logarithm of the error that each
    number may add.  It is searched on pictures that the sensitivities have not seen.  Raises FastGSError where none is good enough.
    """
    if not len(model):
        return []
    series, judged = shots(model, SHOTS), shots(model, JUDGED, SHOTS)
    truth, allowed = pictures(model, judged), loss.error(model)
    model = plain(canonical(model.take(hilbert_order(model.position))), [camera for camera, _ in series])
    found = sensitivity(model, series)
    harm = removal(model, found)

    def tried(level: float) -> tuple[list, float]:
        """The parts at a level, and the mean squared error of their pictures."""
        keep = harm > HARM * 4.0**level
        ready = prepared(model.take(keep), found.take(keep))
        parts = [quantised(ready.part(slice(at, at + segment)), level) for at in range(0, len(ready.model), segment)]
        arrays = [restored(codes, steps, model) for codes, steps in parts]
        again = {name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]} if arrays else ready.model.arrays
        return parts, mean_square(truth, pictures(replace(model, **again), judged))

    numbers = sum(array[0].size for array in model.arrays.values()) * len(model)
    return search(tried, 0.5 * float(np.log2(12 * allowed / numbers)) - 1, allowed, NEAR, loss)


def search(tried: Callable[[float], tuple[Any, float]], level: float, most: float, near: float, loss: Loss) -> Any:
    """What tried(level) gives at a level whose error, which rises with the level, is at most `most`, and `near` of it or more if that is
    found soon.  Raises FastGSError where no level is good enough."""
    low, high, best = -np.inf, np.inf, None
    for _ in range(TRIALS):
        found, error = tried(level)
        if error <= most:
            best, low = (found,), level
            if error >= near * most:
                break
        else:
            high = level
        level += float(np.clip(0.5 * np.log2(0.5 * (1 + near) * most / max(error, 1e-12)), -2, 2))
        if not low < level < high:
            level = 0.5 * (max(low, high - 4) + min(high, low + 4))
    if best is None:
        raise FastGSError(f"its pictures would lose more than {loss.decibels:g} dB however finely it is kept; allow a greater loss.")
    return best[0]


def plain(model: GaussianModel, cameras: list[Camera]) -> GaussianModel:
    """The model without differences that no picture shows: how thin what is far thinner than a pixel is, how long what always lasts."""
    eyes = np.unique([np.linalg.inv(camera.world_to_camera)[:3, 3] for camera in cameras], axis=0)
    distance = np.min([np.linalg.norm(model.position - eye, axis=1) for eye in eyes], axis=0)
    distance = np.maximum(distance, 0.3 * max(float(np.median(distance)), 1e-9))
    thin = THIN * distance / max(camera.fx for camera in cameras)
    temporal = model.temporal
    if isinstance(model.temporal_kind, Radial):
        reach = np.maximum(1, np.maximum(model.mu_tau.astype(np.float64) ** 2, (1 - model.mu_tau.astype(np.float64)) ** 2))
        temporal = np.maximum(temporal, np.log(LASTING / reach)[:, None])
    return replace(model, scale=np.maximum(model.scale, np.log(thin)[:, None]), temporal=temporal)
