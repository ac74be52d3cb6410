# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of Gaussians as trainers save them, in files of PyTorch (torch_zip.py) or NumPy: checked by their shapes, then read."""
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..util.errors import FastGSError
from ..util.numpy_files import PackedArray
from .torch_zip import Tensor

HIGHEST = 4
"""Degree of spherical harmonics."""


def numbers_of(array: Any) -> np.ndarray:
    """The float32 numbers of an array that is not yet read; what is too large becomes infinite."""
    if not isinstance(array, (Tensor, PackedArray)):
        raise FastGSError("something in it that should be numbers is none; save the checkpoint again.")
    with np.errstate(over="ignore", invalid="ignore"):
        return array.read().astype(np.float32)


def rows(table: Mapping[str, Any], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    """Arrays [N, *shape] by name; trainers differ in axes of length 1.  Raises FastGSError for other shapes."""
    missing = [name for name in shapes if not isinstance(table.get(name), (Tensor, PackedArray))]
    if missing:
        raise FastGSError(f"its arrays {', '.join(missing)} are missing; save the checkpoint again.")
    n = [*table[next(iter(shapes))].shape, 0][0]
    for name, shape in shapes.items():
        found = table[name].shape
        if found[:1] != (n,) or tuple(axis for axis in found[1:] if axis != 1) != shape:
            raise FastGSError(f"its array {name} has the shape {found}, which does not fit {n} Gaussians; save the checkpoint again.")
    return {name: numbers_of(table[name]).reshape(n, *shape) for name, shape in shapes.items()}


def harmonics(base: Any, rest: Any, n: int, count: int | None = None) -> tuple[np.ndarray, int]:
    """Features [N, 3 B] of the coefficients of degree 0 [N, 3] (or [N, 1, 3]) and of others [N, B - 1, 3], and their degree.

    count  of coefficients, where the others may be more than are wanted and are not of one degree
    Raises FastGSError.
    """
    base, rest = (each if isinstance(each, np.ndarray) else numbers_of(each) for each in (base, rest))
    degree = math.isqrt(rest.shape[1] + 1) - 1 if rest.ndim == 3 else -1
    fits = rest.ndim == 3 and (rest.shape[1] + 1 >= count if count else degree <= HIGHEST and (degree + 1) ** 2 == rest.shape[1] + 1)
    if not fits or rest.shape[::2] != (n, 3) or base.shape not in ((n, 3), (n, 1, 3)):
        raise FastGSError(f"its spherical harmonics have the shapes {base.shape} and {rest.shape}, which fit no degree or not its {n} "
                          "Gaussians; save the checkpoint again.")
    return np.concatenate([base.reshape(n, 1, 3), rest], 1)[:, :count].reshape(n, -1), degree


def first_and_last(said: Mapping[str, Any], t: np.ndarray) -> tuple[float, float]:
    """First and last second of the capture: as settings say it, else 0 and 1 or 10, as the Gaussians' times tell."""
    span = said.get("time_duration")
    if isinstance(span, list) and len(span) == 2 and all(isinstance(v, (int, float)) and abs(v) < 1e6 for v in span) and span[1] > span[0]:
        return float(span[0]), float(span[1])
    known = np.sort(t[np.isfinite(t)])
    return (0.0, 1.0) if not len(known) or known[int(0.99 * (len(known) - 1))] <= 1.1 else (0.0, 10.0)
