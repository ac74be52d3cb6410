# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light of a picture comes from each Gaussian: what is seen, and how much of it."""
from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import RGB
from ..rendering.instances import Instance
from ..util.backends import load_backend

SIDE = 480
"""Most pixels of the longer side of the pictures by which it is told what is seen."""


def small(camera: Camera) -> Camera:
    """The camera of the whole image, at most SIDE pixels large."""
    size = min(1.0, SIDE / max(camera.width, camera.height))
    return camera.stretched(*(max(1, round(size * side)) for side in (camera.width, camera.height)))


class Light:
    """The light of instances that a camera sees together, by their Gaussians: one picture of them, for many strokes in it.

    camera  the camera of that picture, which is smaller
    """

    def __init__(self, instances: list[Instance], camera: Camera):
        self.camera = small(camera)
        self._drawn = load_backend("cpu").light([_plain(each).viewed(self.camera) for each in instances], self.camera)

    def of(self, mask: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Of each instance the light of its Gaussians in pixels, [N] float32 each: within a mask [h, w] (0..1) of the small picture, in
        the whole of it, and what it would be with nothing before them."""
        within = self._drawn.over(np.asarray(mask, np.float32)[..., None])
        return [(part[:, 0], *rest) for part, rest in zip(within, self._whole, strict=True)]

    @cached_property
    def _whole(self) -> list[tuple[np.ndarray, np.ndarray]]:
        whole = self._drawn.over(np.ones((self.camera.height, self.camera.width, 1), np.float32))
        return [(part[:, 0], alone) for part, alone in zip(whole, self._drawn.alone(), strict=True)]


def _plain(instance: Instance) -> Instance:
    """The instance in one colour, which costs less; its filters still go by its own."""
    model = instance.model
    plain = replace(model, features=np.full((len(model), 3), 0.5, np.float32), appearance=RGB())
    return replace(instance, model=plain, origin=instance.source)
