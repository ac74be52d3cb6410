# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of the arguments that Python programs pass: what is wrong is told in one sentence, which says what is wanted."""
from __future__ import annotations

import os
from dataclasses import asdict
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FastGSError


def shown(value: object) -> str:
    """A value in a few words: a number or a text as it is, an array by its shape, anything else by its type."""
    if value is None or isinstance(value, (bool, Real)):
        return repr(value)
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else f"{value[:37]}...")
    return f"an array of the shape {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def file_path(value: object, what: str = "the name of a file") -> Path:
    """A path, from a text or a path."""
    if not isinstance(value, (str, bytes, os.PathLike)):
        raise FastGSError(f"{what} must be a text or a path, not {shown(value)}.")
    return Path(os.fsdecode(value))


def real(value: Any, what: str, low: float = -np.inf, high: float = np.inf) -> float:
    """A finite number from low to high."""
    if not isinstance(value, Real) or isinstance(value, bool) or not np.isfinite(float(value)) or not low <= float(value) <= high:
        bounds = "" if np.isinf(low) else f" of {low:g} or more" if np.isinf(high) else f" from {low:g} to {high:g}"
        raise FastGSError(f"{what} must be a finite number{bounds}, not {shown(value)}.")
    return float(value)


def whole(value: Any, what: str, low: int, high: int) -> int:
    """A whole number from low to high; 64.0 is one, 64.5 is not."""
    number = isinstance(value, Real) and not isinstance(value, bool) and np.isfinite(float(value))
    if not number or value != int(value):
        raise FastGSError(f"{what} must be a whole number, not {shown(value)}.")
    if not low <= value <= high:
        raise FastGSError(f"{what} must be a whole number from {low} to {high}, not {shown(value)}.")
    return int(value)


def numbers(value: Any, what: str, shape: str, kind: Any = np.float64) -> np.ndarray:
    """An array of numbers; `shape` says in words which shape is wanted."""
    try:
        return np.asarray(value, kind)
    except (TypeError, ValueError) as error:
        raise FastGSError(f"{what} must be numbers of the shape {shape}, not {shown(value)}.") from error


def in_words(values: Any) -> str:
    """The names and values of a dictionary, or of a dataclass' fields, for a sentence."""
    table = values if isinstance(values, dict) else asdict(values)
    return ", ".join(f"{name} {shown(value)}" for name, value in table.items())
