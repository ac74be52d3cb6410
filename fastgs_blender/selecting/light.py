# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of the light of a picture comes from each Gaussian: what is seen, and how much of it."""
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import RGB
from ..rendering.instances import Instance
from ..util.backends import load_backend

SIDE = 480
"""Most pixels of the longer side of the pictures by which it is told what is seen."""


def small(camera: Camera, side: int = SIDE) -> Camera:
    """The camera of the whole image, whose longer side has at most `side` pixels."""
    size = min(1.0, side / max(camera.width, camera.height))
    return camera.stretched(*(max(1, round(size * length)) for length in (camera.width, camera.height)))


class Light:
    """The light of instances that a camera sees together, by their Gaussians: one picture of them, for many strokes in it.

    camera  the camera of that picture, which is smaller
    """

    def __init__(self, instances: Sequence[Instance], camera: Camera):
        self.camera = small(camera)
        self._drawn = load_backend("cpu").light([_plain(each).viewed(self.camera) for each in instances], self.camera)

    def within(self, mask: np.ndarray) -> list[np.ndarray]:
        """Of each instance the light of its Gaussians within a mask [h, w] (0..1) of the small picture, in its pixels: [N] float32."""
        return [part[:, 0] for part in self._drawn.over(np.asarray(mask, np.float32)[..., None])]

    @cached_property
    def whole(self) -> list[np.ndarray]:
        """The same in the whole of the picture."""
        return self.within(np.ones((self.camera.height, self.camera.width)))

    @cached_property
    def alone(self) -> list[np.ndarray]:
        """What it would be with nothing before them, and no edge of the picture."""
        return self._drawn.alone()


def _plain(instance: Instance) -> Instance:
    """The instance in one colour, which costs less; its filters still go by its own."""
    model = instance.model
    plain = replace(model, features=np.full((len(model), 3), 0.5, np.float32), appearance=RGB())
    return replace(instance, model=plain, origin=instance.source)
