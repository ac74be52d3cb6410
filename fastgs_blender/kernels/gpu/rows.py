# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays with a row for each Gaussian, in several buffers where a shader could not see them in one (128 MiB, if a GPU has no more).

Stages that go through all rows are run for one piece after the other: runs of rows in which each of their arrays lies in one buffer.
"""
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import DTypeLike

from .device import SLOT, Array, Buffer, Device

ROWS = SLOT // 4
"""Buffers and pieces begin with a multiple of so many rows, so that a shader may begin there whatever a row's width."""


@dataclass(frozen=True, eq=False)
class Split:
    """An array [N, ...] on a device whose rows lie in several Arrays, one after the other; all but the last have equally many."""

    parts: list[Array]
    shape: tuple[int, ...]
    dtype: np.dtype

    def numpy(self) -> np.ndarray:
        """The values."""
        return np.concatenate([part.numpy() for part in self.parts])


Rowed = Array | Split


def empty_rows(device: Device, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Rowed:
    """An array [N, ...] that is not initialised."""
    width = math.prod(shape[1:])
    most = device.binding // (4 * max(width, 1)) // ROWS * ROWS
    if not shape or shape[0] <= most or not most:
        return device.empty(shape, dtype)
    parts = [device.empty((min(most, shape[0] - first), *shape[1:]), dtype) for first in range(0, shape[0], most)]
    return Split(parts, tuple(shape), np.dtype(dtype))


def zero_rows(device: Device, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Rowed:
    """An array [N, ...] of zeros."""
    found = empty_rows(device, shape, dtype)
    for part in parts_of(found):
        device.clear(part.buffer)
    return found


def as_rows(device: Device, values: np.ndarray) -> Rowed:
    """The values [N, ...] as an array of the device."""
    values = np.asarray(values)
    found, done = empty_rows(device, values.shape, values.dtype), 0
    if isinstance(found, Array):
        return device.array(values)
    for part in found.parts:
        device.upload(part, values[done:done + part.shape[0]])
        done += part.shape[0]
    return found


def parts_of(array: Rowed) -> list[Array]:
    """The Arrays in which the rows lie."""
    return array.parts if isinstance(array, Split) else [array]


def rows_of(array: Rowed, first: int, last: int) -> Array:
    """The rows first..last, which begin with a multiple of ROWS and lie in one buffer."""
    if isinstance(array, Split):
        most = array.parts[0].shape[0]
        part = first // most
        return rows_of(array.parts[part], first - part * most, last - part * most)
    if (first, last) == (0, array.shape[0]):
        return array
    return Array(array.buffer, (last - first, *array.shape[1:]), array.dtype, None, first * math.prod(array.shape[1:]))


def pieces(*arrays: Rowed) -> Iterator[tuple[int, list[Array]]]:
    """(first row, the arrays' rows) for runs of rows in which each of the arrays, which have equally many, lies in one buffer."""
    cuts = {0, arrays[0].shape[0]}
    for array in arrays:
        cuts.update(np.cumsum([part.shape[0] for part in parts_of(array)]).tolist())
    for first, last in pairwise(sorted(cuts)):
        yield first, [rows_of(array, first, last) for array in arrays]


def copy_out(device: Device, array: Rowed, first: int, number: int, target: Buffer, at: int) -> None:
    """Copy `number` rows from `first` on to the place `at` of a buffer."""
    _copied(array, first, number, at, lambda part, begin, count, place: device.copy(part.buffer, target, count, begin, place))


def copy_in(device: Device, source: Buffer, at: int, array: Rowed, first: int, number: int) -> None:
    """The other way round: from the place `at` of a buffer to `number` rows."""
    _copied(array, first, number, at, lambda part, begin, count, place: device.copy(source, part.buffer, count, place, begin))


def add_in(device: Device, source: Buffer, at: int, array: Rowed, first: int, number: int) -> None:
    """Add what lies from the place `at` of a buffer on to `number` rows."""
    _copied(array, first, number, at, lambda part, begin, count, place: device.run("add", count, [[count, place, begin, 0]], source, part))


def _copied(array: Rowed, first: int, number: int, at: int, copy: Callable[..., None]) -> None:
    """copy(part, first number in it, how many, place in the buffer) for each part that holds some of the rows."""
    width, done = math.prod(array.shape[1:]), 0
    for part in parts_of(array):
        begin, end = max(first, done), min(first + number, done + part.shape[0])
        if begin < end and width:
            copy(part, (begin - done) * width, (end - begin) * width, at + (begin - first) * width)
        done += part.shape[0]
