# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that each Gaussian gives to a picture: the sums of its blending weights over pixels.

Blending is linear in the channels, so that these are the picture's gradients by them (raster_backward.py).
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...rendering.layout import Layout
from . import raster
from .jit import announce
from .rasterise import RasterState, rasterise_backward, rasterise_forward
from .splats import ProjectedSplats, project_instances


@dataclass(frozen=True, eq=False)
class Light:
    """SelectingBackend.light()."""

    splats: ProjectedSplats
    state: RasterState
    sizes: tuple[int, ...]

    def over(self, masks: np.ndarray) -> list[np.ndarray]:
        """protocol.Light.over()."""
        channels = self.splats.channels
        wanted = np.zeros((*masks.shape[:2], channels), np.float32)
        wanted[..., :masks.shape[2]] = masks
        sums = rasterise_backward(self.state, wanted, np.zeros(masks.shape[:2], np.float32)).channels
        return self._by_instance(lambda rows: sums[rows, :masks.shape[2]], (masks.shape[2],))

    def alone(self) -> list[np.ndarray]:
        """protocol.Light.alone()."""
        def area(rows):
            geometry, attributes = self.splats.geometry[rows], self.splats.attributes[rows]
            opacity, cut = (np.exp2(attributes[:, k].astype(np.float64)) for k in (raster.LOG2_OPACITY, raster.LOG2_CUT))
            spread = math.pi / math.log(2) / np.abs(geometry[:, raster.L11] * geometry[:, raster.L22])
            return np.maximum(np.minimum(opacity, attributes[:, raster.ALPHA_MAX]) - cut, 0) * spread

        return self._by_instance(area, ())

    def _by_instance(self, values, shape: tuple[int, ...]) -> list[np.ndarray]:
        """Numbers of rows of splats as those of each instance's Gaussians; 0 for those that are not drawn."""
        found = []
        for size, pieces in zip(self.sizes, self.splats.runs, strict=True):
            out = np.zeros((size, *shape), np.float32)
            for first, number in pieces:
                rows = slice(first, first + number)
                out[self.splats.source[rows]] = values(rows)
            found.append(out)
        return found


def light(instances, camera) -> Light:
    """SelectingBackend.light()."""
    announce()
    splats = project_instances(instances, camera, Layout(instances, False))
    _, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels, camera)
    return Light(splats, state, tuple(len(instance.model) for instance in instances))
