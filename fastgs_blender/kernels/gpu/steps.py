# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a training step that work on all Gaussians, on a GPU: the penalty of motion, MCMC's random moves, Adam."""
from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from ..cpu.adam import corrections
from ..cpu.steps import GATE, NEGLIGIBLE, SHARPNESS
from ..protocol import MotionNorm
from .device import Array, Device
from .lists import room_for
from .training import total

AHEAD = 8
"""Steps that a GPU may have before it when the values of the first are asked for: by then they are there."""


def motion_penalty(device: Device, norm: MotionNorm, motion: Array, gradient: Array, scale: float, waits: Array) -> Array:
    """TrainingBackend.motion_penalty()."""
    n, terms = motion.shape[:2]
    if not n or not norm.weights.any():
        return device.zeros((1,), np.float64)
    rows = terms if norm.matrix is None else len(norm.matrix)
    matrix = np.zeros(0) if norm.matrix is None else norm.matrix.ravel()
    table = device.array(np.concatenate([matrix, norm.weights / (n * norm.extent)]).astype(np.float32))
    job = [[n, terms, rows, norm.matrix is not None], [norm.smooth * norm.extent, scale, 0.0, 0.0]]
    group, squares = norm.reading == "group", table
    if group:
        squares = device.empty((n, 3 * rows))
        device.run("penalty_squares", n * rows, job, motion, table, squares)
        squares = total(device, squares)
    values = device.empty((n, 1))
    device.run("penalty", n, job, motion, waits, table, squares, gradient, values, GROUP=group)
    return Array(total(device, values).buffer, (1,), np.dtype(np.float64))


def count(device: Device, seen: Array) -> Array:
    """TrainingBackend.count()."""
    return Array(total(device, Array(seen.buffer, (*seen.shape, 1), seen.dtype)).buffer, (1,), np.dtype(np.float64))


def waits(device: Device, seen: Array, moved: Array, step: int) -> Array:
    """TrainingBackend.waits()."""
    out = device.empty(seen.shape)
    device.run("waits", len_(seen), [[len_(seen), step, 0, 0]], seen, moved, out)
    return out


def hold(device: Device, features: Array, held: Array, gradient: Array, seen: Array, strength: float) -> None:
    """TrainingBackend.hold()."""
    numbers = math.prod(features.shape)
    device.run("hold", numbers, [[numbers, features.shape[1], 0, 0], [strength, 0.0, 0.0, 0.0]], seen, features, held, gradient)


def shrink(device: Device, parameters: dict, gradients: dict, opacity_weight: float, scale_weight: float, extent: float) -> None:
    """TrainingBackend.shrink()."""
    n = len_(parameters["opacity"])
    job = [[n, 0, 0, 0], [opacity_weight / max(n, 1), scale_weight / (3 * max(n, 1) * extent), 0.0, 0.0]]
    device.run("shrink", n, job, parameters["opacity"], parameters["scale"], gradients["opacity"], gradients["scale"])


def shake(device: Device, parameters: dict, reach: float, key: tuple[int, ...]) -> None:
    """TrainingBackend.shake()."""
    n = len_(parameters["opacity"])
    seeds = np.random.SeedSequence(key).generate_state(2).tolist()
    device.run("shake", n, [[n, *seeds, 0], [reach, GATE, SHARPNESS, NEGLIGIBLE]], parameters["opacity"], parameters["rotation"],
               parameters["scale"], parameters["position"], device.spilled)


def adam(device: Device, seen: Array, tensors, betas: tuple[float, float], moved: Array, step: int) -> None:
    """TrainingBackend.adam()."""
    table = _table(device, *betas)
    for value, gradient, mean, square, steps, rate, shared in tensors:
        n, numbers = len_(value), math.prod(value.shape)
        columns = numbers // n
        rates = np.zeros(-(-columns // 4) * 4, np.float32)
        rates[:columns] = np.asarray(rate, np.float32).reshape(-1)
        job = [[numbers, columns, shared, table.shape[0]], [*betas, *(1 - beta for beta in betas)], rates]
        device.run("adam", numbers, job, seen, steps, table, gradient, value, mean, square, device.spilled, RATES=len(rates) // 4)
        device.run("adam_count", n, [[n, shared, 0, 0]], seen, steps, device.spilled)
    device.run("moved", len_(seen), [[len_(seen), step, 0, 0]], seen, moved, device.spilled)


def begin(device: Device) -> int:
    """TrainingBackend.begin_step()."""
    device.guessing = True
    return AHEAD


def end(device: Device, arrays) -> Callable[[], list[np.ndarray] | None]:
    """TrainingBackend.end_step()."""
    device.guessing = False
    rooms, count = list(device.rooms.values()), len(arrays)
    arrive = device.read_later([*arrays, *(room.longest for room in rooms), device.spilled])

    def values():
        *found, spilled = arrive()
        for room, longest in zip(rooms, found[count:]):
            room.entries = max(room.entries, room_for(int(longest[0])))
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
