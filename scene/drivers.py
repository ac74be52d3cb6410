# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates drivers at other frames than the current one, where what they depend on is known there.

That is so for simple expressions of the frame and of properties that are constant or have F-curves.  Blender evaluates these expressions
without Python, and they are trusted in any file; others are not evaluated here.
"""
import math
from collections.abc import Callable

from .cameras.keys import curve_of, driver_of

FRAMES = ("frame_current", "frame_current_final", "frame_float")
"""Properties of scenes that follow the frame."""
DEEPEST = 8


def _lerp(a, b, share):
    return a + (b - a) * share


def _clamp(x, low=0.0, high=1.0):
    return min(max(x, low), high)


def _smoothstep(low, high, x):
    s = _clamp((x - low) / (high - low)) if high != low else float(x >= high)
    return s * s * (3 - 2 * s)


def _round(x):
    return math.copysign(math.floor(abs(x) + 0.5), x)


NAMES = {name: getattr(math, name) for name in (
    "pi", "radians", "degrees", "fabs", "floor", "ceil", "trunc", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log",
    "sqrt", "pow", "fmod")} | {"abs": abs, "round": _round, "int": int, "min": min, "max": max, "lerp": _lerp, "clamp": _clamp,
                               "smoothstep": _smoothstep}
"""What simple expressions may name."""


def value_at(owner, path: str, deep: int = DEEPEST) -> Callable[[float], float] | None:
    """What the driver of a property gives, as a function of the frame; None where it is not known at other frames.

    deep  through how many drivers that depend on each other it is followed
    """
    if deep < 1:
        return None
    curve = driver_of(owner, path)
    driver = curve.driver
    if not driver.is_valid or (driver.type == 'SCRIPTED' and not driver.is_simple_expression):
        return None
    given = {variable.name: _variable(variable, deep - 1) for variable in driver.variables}
    if None in given.values():
        return None
    combined = _combined(driver)
    mapped = curve.evaluate if len(curve.keyframe_points) or len(curve.modifiers) else float

    def at(frame: float) -> float:
        try:
            return mapped(float(combined(frame, {name: value(frame) for name, value in given.items()})))
        except (ArithmeticError, ValueError):  # Blender's drivers give 0 then
            return mapped(0.0)

    return at


def _combined(driver) -> Callable[[float, dict], float]:
    """How a driver combines its variables."""
    if driver.type == 'SCRIPTED':
        code = compile(driver.expression.strip(), "<driver>", "eval")
        return lambda frame, given: eval(code, {"__builtins__": {}}, NAMES | {"frame": frame} | given)  # noqa: S307 (simple)
    how = {'AVERAGE': lambda values: sum(values) / max(len(values), 1), 'SUM': sum, 'MIN': min, 'MAX': max}[driver.type]
    return lambda frame, given: how(list(given.values()))


def _variable(variable, deep: int) -> Callable[[float], float] | None:
    """A driver's variable as a function of the frame; None where it is not known at other frames."""
    if variable.type != 'SINGLE_PROP' or variable.targets[0].id is None:
        return None
    owner, path = variable.targets[0].id, variable.targets[0].data_path
    if owner.id_type == 'SCENE' and path in FRAMES:
        return math.floor if path == FRAMES[0] else float
    if driver_of(owner, path) is not None:
        return value_at(owner, path, deep)
    curve = curve_of(owner, path)
    if curve is not None:
        return curve.evaluate
    try:
        value = float(owner.path_resolve(path))
    except (ValueError, TypeError):
        return None
    return lambda frame: value
