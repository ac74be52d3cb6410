# SPDX-License-Identifier: GPL-3.0-or-later
"""A made scene and training steps on it, by which a backend's pace is measured before there is a capture's own."""
import statistics
from collections.abc import Callable
from itertools import count as counted
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import Appearance, Features
from ..model.gaussians import GaussianModel
from ..model.motion import Fourier, Polynomial
from ..model.temporal import Radial
from .cpu.cache import folder

ROUNDS = 3
"""The median of so many steps counts; one goes before them."""
TIME = 0.4
RATE = 1e-5
"""Learning rate of the steps: so small that the view stays as it is."""


def is_compiled() -> bool:
    """Whether the processor's kernels of a training step are in the cache."""
    return any((folder() / "cpu").glob("raster_backward.*.nbi"))


def step_seconds(backend: Any, model: GaussianModel, camera: Camera, clock: Callable[[], float]) -> float:
    """Seconds of one training step of a model on a backend, with the threads in use: the median of a few, after one that compiles."""
    work, found = steps(backend, model, camera), []
    work(1)
    for _ in range(ROUNDS):
        start = clock()
        work(1)
        found.append(clock() - start)
    return statistics.median(found)


def made_model(look: Appearance, n: int, small: float) -> GaussianModel:
    """A random model with a given appearance; small: how much smaller its Gaussians are, as a logarithm."""
    rng = np.random.default_rng(2)
    return GaussianModel(
        position=rng.uniform((-2, -1.4, 1.5), (2, 1.4, 6), (n, 3)), rotation=rng.normal(size=(n, 4)),
        scale=rng.normal(-2.3 - small, 0.6, (n, 3)), opacity=rng.normal(0.5, 2, n), features=rng.normal(0.3, 0.3, (n, look.width)),
        motion=rng.normal(0, 0.05, (n, 4, 3)), rotation_motion=rng.normal(0, 0.3, (n, 1, 4)), mu_tau=rng.uniform(0, 1, n),
        temporal=rng.normal(1, 1, (n, 1)), basis=Fourier(2), rotation_basis=Polynomial(1), temporal_kind=Radial(), appearance=look)


def made_decoder() -> Features:
    """An appearance with a random decoder."""
    w1, w2 = (np.random.default_rng(1).normal(0, 0.5, shape) for shape in ((6, 12), (3, 6)))
    return Features(w1, w2)


def made_camera(width: int, height: int) -> Camera:
    """A camera that has the made model before it."""
    return Camera(width, height, 0.73 * width, 0.78 * width, width / 2 - 1, height / 2 + 1, np.eye(4))


def steps(backend: Any, model: GaussianModel, camera: Camera) -> Callable[[int], bool]:
    """Takes so many training steps on one view, and returns whether all came to their end: forward, loss, backward, statistics of density
    control, Adam."""
    n, number = len(model), counted(1)
    values = {name: backend.array(array.copy()) for name, array in model.arrays.items()}
    moments = {name: (*(backend.zeros(array.shape) for _ in range(2)), backend.zeros((n,), np.int32))
               for name, array in model.arrays.items()}
    gathered = SimpleNamespace(**{name: backend.zeros((n,)) for name in ("gradient", "absolute", "seen", "radius")})
    moved = backend.array(np.zeros(n, np.int64))
    target = np.random.default_rng(5).integers(0, 256, (camera.height, camera.width, 3), np.uint8)

    def step() -> Callable[[], list[np.ndarray] | None]:
        backend.begin_step()
        goal, seen = backend.picture(target.astype(np.float32) / 255, target), backend.zeros((n,))
        picture = backend.forward(values, model, camera, TIME)
        loss = backend.compare(picture, goal, None, None, 0.2, 0.0, 1.0)
        slopes = backend.backward(picture, loss.rgb, loss.alpha, statistics=gathered, emphasis=loss.emphasis, seen=seen)
        tensors = [(values[name], slopes[name], *moments[name], RATE, 0.0, False) for name in values]
        backend.adam(backend.rows(seen), tensors, (0.9, 0.999), moved, next(number))
        return backend.end_step(loss.values)

    def work(count: int) -> bool:
        begun = [step() for _ in range(count)]
        ended = [end() for end in begun]
        return all(found is not None for found in ended)
    return work
