# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen statistics: sums of each Gaussian's gradients, views and radii in the pictures, from which density control decides."""
from __future__ import annotations

from typing import Any

import numpy as np

NAMES = ("gradient", "absolute", "seen", "radius")


class Statistics:
    """Sums over views, one number for each Gaussian of the current model, until a new one is begun; arrays of a backend.

    gradient  [N] float32  |d loss / d mean2d| in units of normalised device coordinates (pixels times half the image's size)
    absolute  [N] float32  the same of sums over pixels of absolute values (AbsGS), each times the pixel's emphasis, the root of its
                           error over the picture's mean.  Slopes of absolute differences are as long where a picture is nearly right
                           as where all is wrong
    seen      [N] float32  views in which the Gaussian was drawn
    radius    [N] float32  largest radius on the screen, of the box in which alpha reaches the cut, over the image's longer side
    """

    def __init__(self, gradient: Any, absolute: Any, seen: Any, radius: Any) -> None:
        self.gradient, self.absolute, self.seen, self.radius = gradient, absolute, seen, radius

    @classmethod
    def empty(cls, backend: Any, count: int) -> Statistics:
        """Nothing seen yet of `count` Gaussians."""
        return cls(*(backend.zeros((count,)) for _ in NAMES))

    @classmethod
    def restored(cls, backend: Any, arrays: dict[str, np.ndarray]) -> Statistics:
        """What state() gave, on a backend."""
        return cls(*(backend.array(np.array(arrays[name], np.float32)) for name in NAMES))

    def state(self, backend: Any) -> dict[str, np.ndarray]:
        """The arrays by name, as NumPy arrays."""
        return {name: backend.numpy(getattr(self, name)) for name in NAMES}

    def on_host(self, backend: Any) -> Statistics:
        """The same in NumPy arrays."""
        return Statistics(**self.state(backend))

    def add(self, other: Statistics) -> None:
        """Add what was seen in other views; both in NumPy arrays."""
        self.gradient += other.gradient
        self.absolute += other.absolute
        self.seen += other.seen
        np.maximum(self.radius, other.radius, out=self.radius)

    def take(self, rows: np.ndarray) -> None:
        """Keep only these rows (indices or a mask); in NumPy arrays."""
        for name in NAMES:
            setattr(self, name, getattr(self, name)[rows])
