# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a GPU and the processor take for a small frame and a small training step.

Both are whole: a frame begins with the model's coefficients and ends with a picture in the processor's memory; a step begins with a view
and ends with moved parameters.  Several of them are begun before the GPU is waited for, as rendering a film and training do.
"""
import statistics
from collections.abc import Callable
from itertools import count

import numpy as np

from ...cameras.camera import Camera
from ...model.gaussians import GaussianModel
from ...rendering.instances import Instance
from ...rendering.layout import Layout
from ...util.threads import all_threads
from ..cpu.backend import CPU
from ..made import steps
from .device import Failure

ROUNDS, AT_ONCE = 3, 4
"""The median of so many rounds counts, each of so many frames or steps; a single one goes before them."""
APART = 0.05
"""Time between two frames."""

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
    """Steps of training on one view."""
    step = steps(backend, model, camera)

    def work(count: int) -> None:
        if not step(count):
            raise Failure("it finds more splats in a picture that it has drawn before")
    return work
