# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a training step that work on all Gaussians, on a GPU: the penalty of motion, MCMC's random moves, Adam."""
import math
from collections.abc import Callable
from functools import cache

import numpy as np

from .. import asserts
from ..cpu.adam import EPSILON, LONGEST, corrections
from ..cpu.steps import GATE, NEGLIGIBLE, SHARPNESS
from ..protocol import MotionNorm
from .device import Array, Device
from .rows import ROWS, pieces, rows_of
from .training import total

AHEAD = 8
"""Steps that a GPU may have before it when the values of the first are asked for: by then they are there."""


def motion_penalty(device: Device, norm: MotionNorm, motion: Array, gradient: Array, scale: float, since: Array) -> Array:
    """TrainingBackend.motion_penalty()."""
    asserts.motion_penalty(norm, motion, gradient, since)
    n, terms = motion.shape[:2]
    if not n or not norm.weights.any():
        return device.zeros((1,), np.float64)
    rows = terms if norm.matrix is None else len(norm.matrix)
    matrix = np.zeros(0) if norm.matrix is None else norm.matrix.ravel()
    table = device.array(np.concatenate([matrix, norm.weights / (n * norm.extent)]).astype(np.float32))
    group, values = norm.reading == "group", device.empty((n, 1))
    squares = device.zeros((3 * rows,)) if group else table

    def job(part: Array) -> list:
        return [[part.shape[0], terms, rows, norm.matrix is not None], [norm.smooth * norm.extent, scale, float(n), 0.0]]

    if group:
        for _, (part,) in pieces(motion):
            for first in range(0, part.shape[0], at_once := max(device.binding // (12 * rows) // ROWS * ROWS, ROWS)):
                some = rows_of(part, first, min(first + at_once, part.shape[0]))
                found = device.empty((some.shape[0], 3 * rows))
                device.run("penalty_squares", some.shape[0] * rows, job(some), some, table, found)
                device.run("add", 3 * rows, [[3 * rows, 0, 0, 0]], total(device, found), squares)
    for _, (part, slopes, ago, out) in pieces(motion, gradient, since, values):
        device.run("penalty", part.shape[0], job(part), part, ago, table, squares, slopes, out, GROUP=group)
    return Array(total(device, values).buffer, (1,), np.dtype(np.float64))


def count(device: Device, rows: Array) -> Array:
    """TrainingBackend.count()."""
    return Array(total(device, Array(rows.buffer, (*rows.shape, 1), rows.dtype)).buffer, (1,), np.dtype(np.float64))


def steps_since(device: Device, rows: Array, moved: Array, step: int) -> Array:
    """TrainingBackend.steps_since()."""
    asserts.steps_since(moved)
    out = device.empty(rows.shape)
    device.run("steps_since", len_(rows), [[len_(rows), step, 0, 0]], rows, moved, out)
    return out


def anchor(device: Device, features: Array, target: Array, gradient: Array, rows: Array, strength: float) -> None:
    """TrainingBackend.anchor()."""
    asserts.anchor(features, target, gradient)
    for _, (some, *arrays) in pieces(rows, features, target, gradient):
        numbers, columns = math.prod(arrays[0].shape), features.shape[1]
        device.run("anchor", numbers, [[numbers, columns, 0, 0], [strength, 0.0, 0.0, 0.0]], some, *arrays)


def mcmc_penalty(device: Device, parameters: dict, gradients: dict, opacity_weight: float, scale_weight: float, extent: float) -> None:
    """TrainingBackend.mcmc_penalty()."""
    asserts.mcmc_penalty(parameters, gradients)
    n = len_(parameters["opacity"])
    weights = [opacity_weight / max(n, 1), scale_weight / (3 * max(n, 1) * extent), 0.0, 0.0]
    for _, arrays in pieces(parameters["opacity"], parameters["scale"], gradients["opacity"], gradients["scale"]):
        device.run("mcmc_penalty", len_(arrays[0]), [[len_(arrays[0]), 0, 0, 0], weights], *arrays)


def mcmc_noise(device: Device, parameters: dict, reach: float, key: tuple[int, ...], frozen: int = 0) -> None:
    """TrainingBackend.mcmc_noise()."""
    asserts.mcmc_noise(parameters)
    seeds = np.random.SeedSequence(key).generate_state(2).tolist()
    for first, arrays in pieces(*(parameters[name] for name in ("opacity", "rotation", "scale", "position"))):
        job = [[len_(arrays[0]), *seeds, first], [reach, GATE, SHARPNESS, NEGLIGIBLE], [frozen, 0, 0, 0]]
        device.run("mcmc_noise", len_(arrays[0]), job, *arrays, device.spilled)


def adam(device: Device, rows: Array, tensors: list[tuple], betas: tuple[float, float], moved: Array, step: int,
         since: Array | None = None) -> None:
    """TrainingBackend.adam()."""
    asserts.adam(tensors, moved)
    table, since = _table(device, *betas), steps_since(device, rows, moved, step) if since is None else since
    for value, gradient, mean, square, steps, rate, floor, shared in tensors:
        columns = math.prod(value.shape[1:])
        rates = np.zeros(-(-columns // 4) * 4, np.float32)
        rates[:columns] = np.asarray(rate, np.float32).reshape(-1)
        every = steps if shared else since  # of a shared array all rows move, and nothing asks who was seen
        for _, (some, took, *arrays) in pieces(every, steps, gradient, value, mean, square):
            numbers = math.prod(arrays[0].shape)
            job = [[numbers, columns, shared, table.shape[0]], [*betas, *(1 - beta for beta in betas)],
                   [max(floor, EPSILON), 0.0, 0.0, 0.0], rates]
            device.run("adam", numbers, job, some, took, table, *arrays, device.spilled, RATES=len(rates) // 4, LONGEST=LONGEST)
        device.run("adam_count", len_(value), [[len_(value), shared, 0, 0]], rows, steps, device.spilled)
    device.run("moved", len_(rows), [[len_(rows), step, 0, 0]], rows, moved, device.spilled)


def begin(device: Device) -> int:
    """TrainingBackend.begin_step()."""
    device.guessing = True
    return AHEAD


def end(device: Device, *arrays: Array) -> Callable[[], list[np.ndarray] | None]:
    """TrainingBackend.end_step()."""
    device.guessing = False
    guesses, count = list(device.guesses.values()), len(arrays)
    arrive = device.read_later([*arrays, *(guess.longest for guess in guesses), device.spilled])

    def values() -> list[np.ndarray] | None:
        *found, spilled = arrive()
        for guess, longest in zip(guesses, found[count:]):
            guess.largest = max(guess.largest, int(longest[0]))
        if not spilled[0]:
            return found[:count]
        device.clear(device.spilled.buffer)  # the steps that have been begun meanwhile came before this, and did nothing
        return None

    return values


@cache
def _table(device: Device, beta1: float, beta2: float) -> Array:
    """The corrections of bias, on a device."""
    return device.array(corrections(beta1, beta2))


def len_(array: Array) -> int:
    """The number of rows."""
    return array.shape[0]
