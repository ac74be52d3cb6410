# SPDX-License-Identifier: GPL-3.0-or-later
"""What training learns about each Gaussian on the screen: the measures that density control decides by."""
from __future__ import annotations

import numpy as np

from ...kernels.cpu.project_backward import observe
from ...util.threads import run


class Statistics:
    """Sums over views, one number per Gaussian of the current model, until a new one is begun.

    gradient  [N] float32  |d loss / d mean2d| in units of normalised device coordinates (pixels times half the image's size)
    absolute  [N] float32  the same of sums over pixels of absolute values (AbsGS)
    seen      [N] float32  views in which the Gaussian was drawn
    radius    [N] float32  largest radius on the screen, of the box in which alpha reaches the cut, over the image's longer side
    """

    def __init__(self, count: int):
        self.gradient, self.absolute, self.seen, self.radius = (np.zeros(count, np.float32) for _ in range(4))

    def observe(self, cloud, gradients, camera) -> None:
        """Add one view: a kernels.cpu.Cloud of one part and its RasterGradients."""
        rest = (cloud.source, gradients.geometry, gradients.absolute, cloud.shade, (camera.width, camera.height),
                self.gradient, self.absolute, self.seen, self.radius)
        run(lambda first, count: observe(first, first + count, *rest), cloud.runs[0])

    def add(self, other: Statistics) -> None:
        """Add what was seen in other views."""
        self.gradient += other.gradient
        self.absolute += other.absolute
        self.seen += other.seen
        np.maximum(self.radius, other.radius, out=self.radius)

    def take(self, rows) -> None:
        """Keep only these rows (indices or a mask)."""
        for name, array in self.state().items():
            setattr(self, name, array[rows])

    def state(self) -> dict[str, np.ndarray]:
        """The arrays by name."""
        return dict(vars(self))

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Continue from what state() gave."""
        for name in self.state():
            setattr(self, name, np.array(arrays[name], np.float32))
