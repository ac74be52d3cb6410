# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks the state of a trainer, as a checkpoint holds it, before anything computes with it."""
from __future__ import annotations

import numpy as np

from ...model.appearance import Features
from ...model.gaussians import Clip, GaussianModel
from ...util.errors import FastGSError
from .evening import AWAITED
from .evening import shapes as evening_shapes
from .hold import HELD
from .poses import shapes as poses_shapes

DECODER = ("w1", "w2")
STATISTICS = ("gradient", "absolute", "seen", "radius")
NEWER = ("told", "fades", "awaited_colour", "awaited_clock")
"""Arrays of the evening that checkpoints of earlier versions lack."""
LARGEST_COUNT = 2**31 - 2
"""Steps that fit in the optimiser's int32 counters."""
ADVICE = "the checkpoint is damaged or of another run, so delete it to train from the beginning."


def is_count(value) -> bool:
    """Whether a JSON value is a number of steps."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST_COUNT


def is_duration(value) -> bool:
    """Whether a JSON value is a number of seconds."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= 1e12


def is_length(value) -> bool:
    """Whether a JSON value is a length in the scene."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= 1e30


def checked_clip(values) -> Clip:
    """The clip of [frame_count, fps, start_frame]; raises FastGSError where these are no such numbers."""
    numbers = isinstance(values, list) and len(values) == 3 and all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) < 1e12 for v in values)
    if not numbers or int(values[0]) != values[0] or int(values[2]) != values[2]:
        raise FastGSError(f"it does not say which frames the run is about; {ADVICE}")
    return Clip(int(values[0]), float(values[1]), int(values[2]))


def check_state(arrays: dict[str, np.ndarray], about: dict, template: GaussianModel, iterations: int) -> None:
    """Raise FastGSError unless `arrays` and `about` are what Trainer.state() gives for a model of the template's kinds.

    arrays      names, types, shapes and ranges are compared with those of N Gaussians; N is the length of the positions
    iterations  of the whole run
    """
    iteration = about.get("iteration")
    if not is_count(iteration) or iteration > iterations:
        raise FastGSError(f"it says that {iteration} of {iterations} steps are done; {ADVICE}")
    if not is_length(about.get("reach", 1.0)):  # older checkpoints state none
        raise FastGSError(f"it does not say how far away the scene is; {ADVICE}")
    if not isinstance(about.get("known", False), bool):  # nor this
        raise FastGSError(f"it does not say whether it began with a model; {ADVICE}")
    expected = _expected(arrays, template)
    odd = sorted(arrays.keys() ^ expected.keys())
    if odd:
        raise FastGSError(f"its array {odd[0]!r} is {'unknown' if odd[0] in arrays else 'missing'}; {ADVICE}")
    for name, (kind, shape) in expected.items():
        array = arrays[name]
        if array.dtype != kind or array.shape != shape:
            raise FastGSError(f"its array {name!r} holds {array.dtype} {array.shape}, not {np.dtype(kind)} {shape}; {ADVICE}")
        if not _in_range(name, array, iteration):
            raise FastGSError(f"its array {name!r} has numbers out of range; {ADVICE}")


def _expected(arrays, template) -> dict[str, tuple[type, tuple[int, ...]]]:
    """Type and shape of each array by name."""
    position = arrays.get("optimiser.value.position")
    count = len(position) if position is not None and position.ndim else 0
    if not count:
        raise FastGSError(f"it holds no Gaussians; {ADVICE}")
    shapes = template.shapes(count)
    if isinstance(template.appearance, Features):
        shapes |= {name: getattr(template.appearance, name).shape for name in DECODER}
    if f"optimiser.value.{HELD}" in arrays:
        shapes[HELD] = shapes["features"]
    expected = {}
    for name, shape in shapes.items():
        expected |= {f"optimiser.{part}.{name}": (np.float32, shape) for part in ("value", "mean", "square")}
        expected[f"optimiser.count.{name}"] = np.int32, shape[:1]
    late = arrays.get("evening.late")
    if late is not None and late.ndim == 1:  # earlier versions had none
        expected |= {f"evening.{name}": (np.float64, shape) for name, shape in evening_shapes(len(late)).items()
                     if name not in NEWER or f"evening.{name}" in arrays}
    turns = arrays.get("poses.turns")
    if turns is not None and turns.ndim == 2:  # nor these
        expected |= {f"poses.{name}": (np.float64, shape) for name, shape in poses_shapes(len(turns), AWAITED).items()}
    expected |= {f"statistics.{name}": (np.float32, (count,)) for name in STATISTICS}
    return expected | {"optimiser.moved": (np.int64, (count,)), "optimiser.steps": (np.int64, (1,)), "optimiser.betas": (np.float64, (2,))}


def _in_range(name: str, array: np.ndarray, iteration: int) -> bool:
    """Whether all numbers of an array are such as training makes."""
    part = name.split(".")[1]
    if part in ("count", "moved"):
        return array.size == 0 or bool(array.min() >= 0 and array.max() <= iteration)
    if name == "evening.gains":
        return bool(((array > 0.01) & (array < 100)).all())
    if name == "evening.fades":
        return bool((np.abs(array) < 5).all())
    if name == "poses.turns":
        return bool((np.abs(array) < 0.1).all())
    if part == "steps":
        return int(array[0]) == iteration
    if part == "betas":
        return bool(((array >= 0) & (array < 1)).all())
    if part == "square" or name.startswith("statistics."):  # sums of squares and magnitudes
        return not bool((array < 0).any())
    if name.endswith(f"value.{HELD}"):  # NaN: not held
        return not bool(np.isinf(array).any())
    return bool(np.isfinite(array).all())
