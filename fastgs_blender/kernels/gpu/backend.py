# SPDX-License-Identifier: GPL-3.0-or-later
"""The GPU backend: renders and trains through WebGPU, and calls the CPU backend for all other operations and where the GPU fails."""
import logging
from collections.abc import Callable, Collection, Sequence
from functools import cache, cached_property, wraps
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from ...cameras.camera import Camera
from ...rendering.exposure import Exposure
from ...rendering.instances import ViewedInstance
from ...rendering.layout import Buffers, Exposed, Layout
from ..cpu.backend import CPU, timed
from . import steps, training
from .adapters import find
from .blend import How, blend_all
from .device import Array, Device, Failure, TooLarge
from .expose import expose
from .holdout import surface
from .picture import Bands, DeviceBuffers, Models, colour, draw
from .rows import Split, as_rows, copy_in, zero_rows
from .splats import front_to_back, project


def _on_device(work: Callable[..., Any]) -> Callable[..., Any]:
    """The method whose function takes the backend's device first."""
    return wraps(work)(lambda self, *given, **named: work(self.device, *given, **named))


class GPU(CPU):
    """A backend on one device; the methods' contracts are those of protocol.TrainingBackend.

    open       gives the Device, or raises Failure
    failed     why it is not used any more, as a part of a sentence; None while it is
    too_large  why the last picture that did not fit on it did not, or ""

    What does not fit into the device's memory is drawn by the CPU, and the device goes on with the next picture.  Whatever else goes wrong
    on the device, the picture is drawn by the CPU, and so are all others from then on.  A line of the log says why.
    """

    def __init__(self, open: Callable[[], Device]) -> None:  # noqa: A002
        self.open, self.too_large = open, ""
        self.failed: str | None = None

    @cached_property
    def models(self) -> Models:
        """The device, and the models that stay on it."""
        return Models(self.open())

    @property
    def device(self) -> Device:
        return self.models.device

    def _or_else(self, work: Callable[[], Any], instead: Callable[[], Any]) -> Any:
        """The result of `work`, on the GPU, or that of `instead`, on the CPU."""
        if self.failed is None:
            try:
                return work()
            except TooLarge as failure:
                if not self.too_large:  # of a film one line is enough
                    logging.getLogger(__name__).warning("a picture does not fit on the GPU, so the CPU draws it: %s.", failure)
                self.too_large = str(failure)
            except Failure as failure:
                self.failed = str(failure)
                self.__dict__.pop("models", None)
                logging.getLogger(__name__).warning("the GPU fails, so the CPU goes on: %s.", failure)
        return instead()

    def numpy(self, array: Any) -> np.ndarray:
        if isinstance(array, Array | Split):
            return array.numpy()
        return self._or_else(array.numpy, array.instead) if isinstance(array, Bands) else array

    def draw(self, instances: list[ViewedInstance], camera: Camera, layout: Layout, probes: Collection[str],
             progress: Callable[[float], None], holdout: np.ndarray | None = None, wanted: np.ndarray | None = None) -> Any:
        again = cache(lambda: super(GPU, self).draw(instances, camera, layout, probes, progress, holdout, wanted))
        return self._or_else(lambda: draw(self.device, self.models, instances, camera, layout, probes, progress, holdout, again), again)

    def expose(self, exposure: Exposure, instances: list[ViewedInstance], camera: Camera, colours: bool, progress: Callable[[float], None],
               holdout: np.ndarray | None = None, objects: Sequence[tuple[str, int]] = (), by_pixel: bool = False) -> Exposed:
        given = exposure, instances, camera, colours
        return self._or_else(lambda: expose(self.device, self.models, *given, progress, holdout, objects, by_pixel),
                             lambda: super(GPU, self).expose(*given, progress, holdout, objects, by_pixel))

    def surface(self, triangles: np.ndarray, camera: Camera) -> Any:
        return self._or_else(lambda: surface(self.device, triangles, camera), lambda: super(GPU, self).surface(triangles, camera))

    def colour(self, buffers: Buffers, layout: Layout, camera: Camera) -> Any:
        if not isinstance(buffers, DeviceBuffers):
            return super().colour(buffers, layout, camera)
        again = cache(lambda: super(GPU, self).colour(buffers.again(), layout, camera))
        return self._or_else(lambda: colour(self.device, buffers, layout, camera, again), again)

    def measure_stages(self, instance: ViewedInstance, camera: Camera, repeat: int) -> tuple[dict[str, float], int]:
        return self._or_else(lambda: self._measure_stages(instance, camera, repeat),
                             lambda: super(GPU, self).measure_stages(instance, camera, repeat))

    def _measure_stages(self, instance: ViewedInstance, camera: Camera, repeat: int) -> tuple[dict[str, float], int]:
        layout, found, device = Layout([instance], depth=False), [self.models.packs(instance.model)], self.device
        times, splats = timed(
            repeat, device.wait, lambda: project(device, [instance], camera, layout, found), lambda splats: front_to_back(device, splats),
            lambda splats, order: blend_all(device, order, splats, camera, How(), lambda share: None))
        return times, 0 if splats is None else splats.drawn(device)

    # training: its arrays stay on the device, so what fails there ends the step

    def array(self, values: np.ndarray) -> Any:
        return as_rows(self.device, values)

    def zeros(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Any:
        return zero_rows(self.device, shape, dtype)

    def read(self, *arrays: Any) -> list[np.ndarray]:
        return self.device.read_all(arrays)

    def picture(self, rgb: np.ndarray, stored: np.ndarray | None) -> Any:
        return self.device.array(rgb) if stored is None else training.picture(self.device, stored)

    forward = _on_device(training.forward)
    compare = _on_device(training.compare)
    agreement = _on_device(training.agreement)
    over = _on_device(training.over)
    backward = _on_device(training.backward)
    begin_step = _on_device(steps.begin)
    end_step = _on_device(steps.end)

    def rows(self, seen: Any, frozen: int = 0) -> Any:
        if frozen:
            copy_in(self.device, self.device.zeros((frozen,)).buffer, 0, seen, 0, frozen)
        return seen

    count = _on_device(steps.count)
    steps_since = _on_device(steps.steps_since)
    motion_penalty = _on_device(steps.motion_penalty)
    anchor = _on_device(steps.anchor)
    mcmc_penalty = _on_device(steps.mcmc_penalty)
    mcmc_noise = _on_device(steps.mcmc_noise)
    adam = _on_device(steps.adam)


def named(part: str) -> GPU:
    """The backend on the adapter whose name holds a text; "": on the best.  Raises FastGSError where there is none."""
    return GPU(find(part).open)
