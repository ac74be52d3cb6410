# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of values that Python programs pass: numbers, shapes and names that are out of bounds are told in one sentence.

Arguments of a wrong type are left to Python's own errors, but where the mistake is a likely one."""
import math
from collections.abc import Iterable
from dataclasses import asdict
from numbers import Real
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


def real(value: Any, what: str, low: float = -np.inf, high: float = np.inf) -> float:
    """A finite number from low to high."""
    if not finite(value) or not low <= float(value) <= high:
        bounds = "" if np.isinf(low) else f" of {low:g} or more" if np.isinf(high) else f" from {low:g} to {high:g}"
        raise FastGSError(f"{what} must be a finite number{bounds}, not {shown(value)}.")
    return float(value)


def integer(value: Any, what: str, low: int, high: int) -> int:
    """A whole number from low to high; 64.0 is one, 64.5 is not."""
    if not finite(value) or value != int(value):
        raise FastGSError(f"{what} must be a whole number, not {shown(value)}.")
    if not low <= value <= high:
        raise FastGSError(f"{what} must be a whole number from {low} to {high}, not {shown(value)}.")
    return int(value)


def finite(value: Any) -> bool:
    """Whether a value is a number that float64 holds."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(float(value))
    except OverflowError:
        return False


def one_of(value: Any, what: str, names: Iterable[str]) -> str:
    """One of several names."""
    choices = list(names)
    if not isinstance(value, str) or value not in choices:
        raise FastGSError(f"{what} must be one of {', '.join(choices)}, not {shown(value)}.")
    return value


def numbers(value: Any, what: str, shape: str, kind: Any = np.float64) -> np.ndarray:
    """An array of numbers; `shape` says in words which shape is wanted."""
    try:
        return np.asarray(value, kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise FastGSError(f"{what} must be numbers of the shape {shape}, not {shown(value)}.") from error


def like(value: Any, example: Any, most: int = 10**9) -> Any:
    """A value of JSON or of a program in the type of an example: a truth value, a number, a text or a tuple of numbers.

    None where it is of another type, no finite number, or beyond reason; most: the largest whole number
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= 1e30
    if isinstance(example, (bool, str)):
        return value if isinstance(value, type(example)) else None
    if isinstance(example, int):
        return int(value) if number and value == int(value) and abs(value) <= most else None
    if isinstance(example, float):
        return float(value) if number else None
    numbers = [like(each, 0.0) for each in value] if isinstance(value, (list, tuple)) and len(value) <= 100_000 else [None]
    return None if None in numbers else tuple(numbers)


def in_words(values: Any) -> str:
    """The names and values of a dictionary, or of a dataclass' fields, for a sentence."""
    table = values if isinstance(values, dict) else asdict(values)
    return ", ".join(f"{name} {shown(value)}" for name, value in table.items())
