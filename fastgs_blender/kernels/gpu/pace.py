# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a GPU and the processor take for a small frame and a small training step.

Both are whole: a frame begins with the model's coefficients and ends with a picture in the processor's memory; a step begins with a view
and ends with moved parameters.  Several of them are begun before the GPU is waited for, as rendering a film and training do.
"""
import statistics
from collections.abc import Callable
from itertools import count
from types import SimpleNamespace

import numpy as np

from ...cameras.camera import Camera
from ...model.gaussians import GaussianModel
from ...rendering.instances import Instance
from ...rendering.layout import Layout
from ...util.threads import all_threads
from ..cpu.backend import CPU
from .device import Failure

ROUNDS, AT_ONCE = 3, 4
"""The median of so many rounds counts, each of so many frames or steps; a single one goes before them."""
TIME, APART = 0.4, 0.05
"""Time of the steps, and the time between two frames."""
RATE = 1e-5
"""Learning rate of the steps: so small that the view stays as it is."""

FAR = 4.0
"""A GPU that takes so many times as long in a round is not measured further."""

Work = Callable[[int], None]
"""Does so many frames or steps."""


def pace(gpu: CPU, cpu: CPU, model: GaussianModel, camera: Camera, clock: Callable[[], float]) -> dict[str, tuple[float, float]]:
    """(the GPU's, the processor's) milliseconds of a "frame" and of a training "step" of a model.

    gpu, cpu  backends; clock gives seconds
    Raises Failure where the GPU cannot do it.
    """
    for array in model.arrays.values():
        array.flags.writeable = False  # as those of a file are: a GPU keeps them
    with all_threads():
        return {name: _in_turn(begin(gpu, model, camera), begin(cpu, model, camera), clock)
                for name, begin in (("frame", _frames), ("step", _steps))}


def _in_turn(on_gpu: Work, on_cpu: Work, clock: Callable[[], float]) -> tuple[float, float]:
    """Milliseconds of one frame or step of each; they take turns, so that both meet the same other programs."""
    times: tuple[list[float], list[float]] = ([], [])
    on_gpu(1)
    on_cpu(1)
    for _ in range(ROUNDS):
        for work, found in zip((on_gpu, on_cpu), times, strict=True):
            start = clock()
            work(AT_ONCE)
            found.append(1e3 * (clock() - start) / AT_ONCE)
        if times[0][-1] > FAR * times[1][-1]:
            break
    return statistics.median(times[0]), statistics.median(times[1])


def _frames(backend: CPU, model: GaussianModel, camera: Camera) -> Work:
    """Frames of a film, each at another time."""
    times = (APART * number % 1 for number in count())

    def work(frames: int) -> None:
        for _ in range(frames):
            instances = [Instance(model, np.eye(4), next(times)).viewed(camera)]
            layout = Layout(instances, False)
            buffers = backend.draw(instances, camera, layout, (), lambda share: None)
            backend.numpy(backend.colour(buffers, layout, camera))
            backend.numpy(buffers.alpha)
    return work


def _steps(backend: CPU, model: GaussianModel, camera: Camera) -> Work:
    """Steps of training on one view: forward, loss, backward, statistics of density control, Adam."""
    n, number = len(model), count(1)
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

    def work(steps: int) -> None:
        ends = [step() for _ in range(steps)]
        if any(end() is None for end in ends):
            raise Failure("it finds more splats in a picture that it has drawn before")
    return work
