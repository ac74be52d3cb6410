# SPDX-License-Identifier: GPL-3.0-or-later
"""Refits a model that is being compressed: trains its remaining Gaussians on pictures of the original model, with quantisation in the loop.

Many Gaussians can be left out of a model if the positions, shapes and colours of the others are adjusted.  The target pictures are
renders of the original model; each step uses one, from a new camera and at a new time.  The quantised model, as a reader of the file would
have it, is rendered and compared with the target.  Its gradients update the parameters before rounding, as if rounding were the identity
(straight-through estimator, Bengio et al. 2013).  Parameters are measured in their quantisation steps: one step of any parameter changes
the pictures by about the same amount, so one learning rate of Adam suits all.

What is minimised is the error plus the price of the bits (rounding.py): where pictures hardly change with a parameter, its whole number
becomes a smaller one.
"""
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..util import rotations
from .quantising import SAMPLES, Prepared, Steps, quantised, restored, scales, step_sizes
from .rounding import TAIL
from .sensitivity import OPAQUE, Shot, differentiable, parameters_of, pictures

RATE = 0.015
"""Adam's learning rate at the first pictures, in quantisation steps; it falls to END times that along half a cosine."""
END = 0.05
EVERY = 20
"""Pictures between two roundings."""
BETAS = 0.9, 0.99
OUTLIER = 3.0
"""A picture counts less where its error is more than this many times the usual one: its camera may have come to lie next to a Gaussian."""
MOVED = ("position", "motion", "scale", "rotation", "opacity", "features")
"""The arrays that are refitted."""
STEEPEST = 0.02
"""Opacities are clamped to this distance from 0 and 1 where their step is converted to a step of the logit."""


def refitted(ready: Prepared, level: float, segment: int, original: GaussianModel, series: list[Shot],
             progress: Callable[[float], None]) -> Prepared:
    """The model refitted, so that quantised at this level its pictures are nearer to those of the original.

    series    the shots to train on, in this order
    progress  called with 0..1; exceptions that it raises pass through
    """
    backend, start, n = differentiable(), ready.model, len(ready.model)
    units = _units(in_parts(ready, level, segment), ready, segment)
    moved, means, squares = ({name: backend.zeros(unit.shape) for name, unit in units.items()} for _ in range(3))
    counts = {name: backend.zeros((n,), np.int32) for name in units}
    rows, when = backend.rows(backend.array(np.ones(n, np.float32))), backend.zeros((n,), np.int64)
    model, rounding, dear, errors = start, {}, {}, []
    for k, shot in enumerate(series):
        if k % EVERY == 0:
            parts = in_parts(replace(ready, model=model), level, segment)
            known = as_read(parts, model)
            rounding = {name: known[name] - array for name, array in model.arrays.items()}
            dear = {name: (price(name, parts) * (4.0**level * unit if name == "motion" else 4.0**level)).astype(np.float32)
                    for name, unit in units.items()}
        shown = replace(model, **{name: array + rounding[name] for name, array in model.arrays.items()})
        shown = replace(shown, opacity=np.minimum(shown.opacity, OPAQUE))
        gradients, error = _gradients(backend, shown, original, shot)
        errors.append(error)
        trust = min(1.0, OUTLIER * float(np.median(errors)) / max(error, 1e-12))
        rate = RATE * (END + (1 - END) * 0.5 * (1 + np.cos(np.pi * k / len(series))))
        slopes = {name: backend.array(gradients[name].reshape(unit.shape) * (trust * unit) + dear[name]) for name, unit in units.items()}
        tensors = [(moved[name], slopes[name], means[name], squares[name], counts[name], rate, 0.0, False) for name in units]
        backend.adam(rows, tensors, BETAS, when, k + 1)
        model = _after(start, {name: backend.numpy(moved[name]) * unit for name, unit in units.items()})
        progress((k + 1) / len(series))
    return replace(ready, model=model)


def price(name: str, parts: list[tuple[dict[str, np.ndarray], Steps]]) -> np.ndarray:
    """How the cost of an array's whole numbers at level 0 changes with its parameters, [N, ...]: for a step, of motion for a unit.

    The cost of c is TAIL / 6 ln(1 + |c|), see rounding.py.  A parameter stands in its own whole number and, where columns are differences,
    in that of the next Gaussian and in those of other columns.
    """
    found = []
    for codes, steps in parts:
        code = codes[name].reshape(len(codes[name]), -1)
        step = np.broadcast_to(step_sizes(codes, steps, scales(codes, steps))[name], codes[name].shape).reshape(code.shape)
        slope = np.sign(code) / (1.0 + np.abs(code))
        for k in range(slope.shape[1]):
            if name == "position" or f"{name}/{k}" in steps.chained:
                slope[:-1, k] -= slope[1:, k] * step[:-1, k] / step[1:, k]
        for k, other in steps.paired if name == "features" else ():
            slope[:, other] -= slope[:, k] * step[:, other] / step[:, k]
        if name == "motion":
            slope = slope / step
        if name == "rotation" and slope.shape[1] == 3:
            slope = np.concatenate([np.zeros((len(slope), 1)), slope], axis=1)
        found.append(slope.reshape(*codes[name].shape[:-1], -1) if codes[name].ndim > 1 else slope[:, 0])
    return TAIL / 6 * np.concatenate(found)


def in_parts(ready: Prepared, level: float, segment: int) -> list[tuple[dict[str, np.ndarray], Steps]]:
    """The model quantised at a level, in parts of at most `segment` Gaussians."""
    return [quantised(ready.part(slice(at, at + segment)), level) for at in range(0, len(ready.model), segment)]


def as_read(parts: list[tuple[dict[str, np.ndarray], Steps]], template: GaussianModel) -> dict[str, Any]:
    """The arrays that a reader of these parts has."""
    if not parts:
        return template.arrays
    arrays = [restored(codes, steps, template) for codes, steps in parts]
    return {name: np.concatenate([each[name] for each in arrays]).astype(np.float32) for name in template.arrays}


def _units(parts: list[tuple[dict[str, np.ndarray], Steps]], ready: Prepared, segment: int) -> dict[str, np.ndarray]:
    """The quantisation step of each parameter of the arrays in MOVED, float32 in their shapes; of opacities, the step of the logit.

    A coefficient of motion is written after what the others can do as well has been taken from its function, and within a short lifetime
    next to nothing is left of it: its step is huge.  Moved alone, it moves by all of its function, so its unit is what moves the Gaussian
    by one step of its position.
    """
    model = ready.model
    units = {name: np.empty_like(model.arrays[name]) for name in MOVED if model.arrays[name].size}
    for i, (codes, steps) in enumerate(parts):
        sizes = step_sizes(codes, steps, scales(codes, steps))
        part = slice(i * segment, (i + 1) * segment)
        if "motion" in units:
            sizes["motion"] = np.minimum(sizes["motion"], (sizes["position"] / _reach(ready.part(part)))[..., None])
        for name, unit in units.items():
            unit[part] = sizes[name]
    opacity = np.clip(sigmoid(model.opacity), STEEPEST, 1 - STEEPEST)
    units["opacity"] /= opacity * (1 - opacity)
    return units


def _reach(ready: Prepared) -> np.ndarray:
    """The root mean square of each function of motion over each Gaussian's lifetime, [N, K], never 0."""
    t = ready.low[:, None] + (ready.high - ready.low)[:, None] * np.linspace(0, 1, SAMPLES)
    basis = ready.model.basis
    weights = basis.weights(t - ready.model.mu_tau[:, None].astype(np.float64) if basis.centred else t)
    return np.maximum(np.sqrt(np.mean(weights**2, axis=1)), 1e-9)


def _gradients(backend: Any, model: GaussianModel, original: GaussianModel, shot: Shot) -> tuple[dict[str, np.ndarray], float]:
    """Gradients of the mean squared difference between a shot's two pictures by the model's arrays, and this difference."""
    truth = pictures(original, [shot])[0]
    picture = backend.forward(parameters_of(model, backend), model, shot.camera, float(shot.t))
    rgb, alpha = backend.numpy(picture.rgb), backend.numpy(picture.alpha)
    seen = rgb + shot.background * (1 - alpha)[..., None]
    slope = ((seen - truth) * ((seen >= 0) & (seen <= 1)) * (2 / rgb.size)).astype(np.float32)
    found = backend.backward(picture, backend.array(slope), backend.array(-shot.background * slope.sum(2)))
    return {name: backend.numpy(found[name]) for name in MOVED}, float(np.mean((np.clip(seen, 0, 1) - truth) ** 2))


def _after(model: GaussianModel, change: dict[str, np.ndarray]) -> GaussianModel:
    """The model with its arrays changed, and unit quaternions."""
    arrays: dict[str, Any] = {name: array + change.get(name, 0) for name, array in model.arrays.items()}
    length = np.maximum(np.linalg.norm(arrays["rotation"].astype(np.float64), axis=1), 1e-12)
    arrays["rotation"] = rotations.unit(arrays["rotation"].astype(np.float64))
    arrays["rotation_motion"] = arrays["rotation_motion"] / length[:, None, None]
    return replace(model, **arrays)
