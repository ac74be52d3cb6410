# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks the state of a trainer, as a checkpoint holds it, before anything computes with it."""
from typing import Any

import numpy as np

from ...formats.base import LIMIT, LIMITS
from ...model.appearance import Features
from ...model.gaussians import Clip, GaussianModel
from ...util.errors import FastGSError
from . import camera_response, camera_turns
from .anchor import ANCHOR
from .camera_estimates import KEPT, SUMS
from .camera_response import FARTHEST
from .statistics import NAMES as STATISTICS

DECODER = ("w1", "w2")
LARGEST_SUM = 1e15
"""Sums over a camera's pictures, of squares of pixels' changes, stay far below it."""
LONGEST_STEP = 10.0
"""Adam's mean is at most 7.3 times the root of its mean square with the rates of forgetting that training uses, 0.9 and 0.999."""
TINY = 1e-18
"""Gradients so small vanish when they are squared."""
MOST_LOG = 100.0
"""Logarithm of a gain that is expected, and of its standard deviation."""
LARGEST_OFFSET = 1e6
"""Frames of a clock offset that is expected, and of its standard deviation."""
LARGEST_COUNT = 2**31 - 2
"""Steps that fit in the optimiser's int32 counters."""
LONGEST = 1e12
"""Seconds."""
ADVICE = "the checkpoint is damaged or of another run, so delete it to train from the beginning."


def is_number(value: Any, low: float, high: float, kind: Any = (int, float)) -> bool:
    """Whether a JSON value is a number from low to high."""
    return isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high


def _are_numbers(values: object, count: int, most: float) -> bool:
    """Whether a JSON value is a list of so many numbers that are no larger than `most`."""
    return isinstance(values, list) and len(values) == count and all(is_number(value, -most, most) for value in values)


def checked_clip(values: Any) -> Clip:
    """The clip of [frame_count, fps, start_frame]; raises FastGSError where these are no such numbers."""
    if not _are_numbers(values, 3, 1e12) or int(values[0]) != values[0] or int(values[2]) != values[2]:
        raise FastGSError(f"it does not say which frames the run is about; {ADVICE}")
    return Clip(int(values[0]), float(values[1]), int(values[2]))


def check_state(arrays: dict[str, np.ndarray], about: dict, template: GaussianModel, iterations: int) -> None:
    """Raise FastGSError unless `arrays` and `about` are what Trainer.state() gives for a model of the template's kinds.

    arrays      names, types, shapes and ranges are compared with those of N Gaussians; N is the length of the positions
    iterations  of the whole run
    """
    iteration: Any = about.get("iteration")
    if not is_number(iteration, 0, min(iterations, LARGEST_COUNT), int):
        raise FastGSError(f"it says that {iteration} of {iterations} steps are done; {ADVICE}")
    if not is_number(about.get("depth"), 1e-30, 1e30):
        raise FastGSError(f"it does not say how far away the scene is; {ADVICE}")
    if not _are_numbers(about.get("around"), 4, LIMIT):
        raise FastGSError(f"it does not say what the cameras stand around; {ADVICE}")
    if not isinstance(about.get("warm"), bool):
        raise FastGSError(f"it does not say whether it began with a model; {ADVICE}")
    if not is_number(about.get("frozen", 0), 0, LARGEST_COUNT, int):
        raise FastGSError(f"it does not say how many Gaussians are frozen; {ADVICE}")
    expected = _expected(arrays, template)
    odd = sorted(arrays.keys() ^ expected.keys())
    if odd:
        raise FastGSError(f"its array {odd[0]!r} is {'unknown' if odd[0] in arrays else 'missing'}; {ADVICE}")
    for name, (kind, shape) in expected.items():
        array = arrays[name]
        if array.dtype != kind or array.shape != shape:
            raise FastGSError(f"its array {name!r} holds {array.dtype} {array.shape}, not {np.dtype(kind)} {shape}; {ADVICE}")
        with np.errstate(all="ignore"):
            good = _in_range(name, array, iteration)
        if not good:
            raise FastGSError(f"its array {name!r} has numbers out of range; {ADVICE}")
    for name in expected:
        if name.startswith("optimiser.mean."):
            _check_mean(name, arrays)


def _expected(arrays: dict[str, np.ndarray], template: GaussianModel) -> dict[str, tuple[type, tuple[int, ...]]]:
    """Type and shape of each array by name."""
    position = arrays.get("optimiser.value.position")
    count = len(position) if position is not None and position.ndim else 0
    if not count:
        raise FastGSError(f"it holds no Gaussians; {ADVICE}")
    shapes = template.shapes(count)
    if isinstance(template.appearance, Features):
        shapes |= {name: getattr(template.appearance, name).shape for name in DECODER}
    if f"optimiser.value.{ANCHOR}" in arrays:
        shapes[ANCHOR] = shapes["features"]
    expected: dict[str, tuple[type, tuple[int, ...]]] = {}
    for name, shape in shapes.items():
        expected |= {f"optimiser.{part}.{name}": (np.float32, shape) for part in ("value", "mean", "square")}
        expected[f"optimiser.count.{name}"] = np.int32, shape[:1]
    turns, steps = (arrays.get(f"cameras.{name}") for name in ("turns", "delayed.steps"))
    cameras, queued = (len(array) if array is not None and array.ndim else 0 for array in (turns, steps))
    if queued > KEPT:
        raise FastGSError(f"it queues {queued} steps; {ADVICE}")
    expected |= {f"cameras.{name}": (np.float64, (cameras, *shape))
                 for name, shape in (camera_response.SHAPES | camera_turns.SHAPES).items()}
    expected |= {f"cameras.delayed.{name}": (np.float64, (queued, cameras, *shape)) for name, shape in SUMS.items()}
    expected["cameras.delayed.steps"] = np.int64, (queued,)
    expected |= {f"statistics.{name}": (np.float32, (count,)) for name in STATISTICS}
    return expected | {"optimiser.moved": (np.int64, (count,)), "optimiser.steps": (np.int64, (1,)), "optimiser.betas": (np.float64, (2,))}


def _check_mean(name: str, arrays: dict[str, np.ndarray]) -> None:
    """Raise FastGSError for a mean gradient that its mean square cannot have: one step would lead anywhere."""
    square = arrays[name.replace(".mean.", ".square.")].astype(np.float64)
    if (np.abs(arrays[name]) > LONGEST_STEP * np.sqrt(square) + TINY).any():
        raise FastGSError(f"its array {name!r} has numbers out of range; {ADVICE}")


def _in_range(name: str, array: np.ndarray, iteration: int) -> bool:
    """Whether all numbers of an array are such as training makes; a NaN is within no bounds."""
    group, part, *rest = name.split(".")
    if part in ("count", "moved"):
        return array.size == 0 or bool(array.min() >= 0 and array.max() <= iteration)
    if part == "steps":
        return int(array[0]) == iteration
    if part == "betas":
        return bool(((array >= 0) & (array < 1)).all())
    if group == "statistics":  # magnitudes
        return not bool((array < 0).any())
    if name == "cameras.delayed.steps":
        return bool(((array >= 0) & (array < iteration)).all())
    if group == "cameras":
        return _cameras_in_range(name.rpartition(".")[2], array)
    if part == "square":
        return bool((array >= 0).all())
    if part == "mean":
        return bool(np.isfinite(array).all())
    kind = "features" if rest == [ANCHOR] else rest[0]
    bounded = (np.abs(array) <= LIMIT) & (array <= LIMITS.get(kind, LIMIT))
    return bool((bounded | np.isnan(array) if rest == [ANCHOR] else bounded).all())  # NaN: no target


def _cameras_in_range(part: str, array: np.ndarray) -> bool:
    most = {"biases": 10.0, "offsets": 2 * FARTHEST, "fades": 5.0, "turns": 0.1}
    if part in most:
        return bool((np.abs(array) <= most[part]).all())
    if part == "gains":
        return bool(((array > 0.01) & (array < 100)).all())
    if part == "turn_limits":
        return bool(((array >= 0) & (array <= 0.1)).all())
    if part == "gain_priors":
        return bool((np.abs(array) <= MOST_LOG).all() and (array[:, 1] >= 0).all())
    if part == "offset_priors":
        return bool((np.abs(array[:, 0]) <= LARGEST_OFFSET).all() and ((array[:, 1] >= 0) & (array[:, 1] <= LARGEST_OFFSET)).all())
    if not (np.abs(array) <= LARGEST_SUM).all():
        return False
    if part == "turn_sums":
        return _turns_in_range(array)
    if part == "clock_sums":
        square, _, error, count = np.moveaxis(array, -1, 0)
        return bool(((square >= 0) & (error >= 0) & (count >= 0)).all())
    count, p, _, pp, _ = np.moveaxis(array, -1, 0)
    return bool(((count >= 0) & (pp >= 0) & (p * p <= 1.001 * count * pp + TINY)).all())  # Cauchy and Schwarz


def _turns_in_range(array: np.ndarray) -> bool:
    """Whether [..., 14] sums of turns are those of real pictures: a symmetric matrix without negative eigenvalues, and magnitudes."""
    if not (array[..., 12:] >= 0).all():
        return False
    square = array[..., :9].reshape(-1, 3, 3)
    slack = 1e-6 * np.abs(square).max((1, 2), initial=0.0) + TINY
    alike = np.abs(square - square.transpose(0, 2, 1)).max((1, 2), initial=0.0) <= slack
    return bool(alike.all() and (np.linalg.eigvalsh(square)[:, 0] >= -slack).all())
