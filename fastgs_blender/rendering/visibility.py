# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists the Gaussians that a camera can see, front to back.  Viewports compute this on the CPU while the GPU draws."""
import numpy as np

from ..cameras.camera import Camera
from ..model.slicing import positions_at
from ..util.backends import load_backend
from .crops import crop_share
from .instances import ViewedInstance


def order(instances: list[ViewedInstance], camera: Camera, share: float = 1.0, backend: str = "auto",
          standing: dict | None = None) -> np.ndarray:
    """Indices [V] int32 of the Gaussians that a camera shows, the nearest first, counted through all instances in their order.

    Left out is what cannot touch a pixel: by temporal opacity, before the near plane, off the picture, cropped.
    share     of these, for a picture in a hurry: about so many of them, those with the most opacity times area in the picture, by depths
              of 16 bits.  1: all of them, exactly
    backend   "cpu" (numba, all threads), "reference" (NumPy), "auto"; all give the same
    standing  from one such picture to the next: what no move of the camera changes is kept in it, for these instances
    """
    return load_backend(backend).front_to_back(instances, camera, share, standing)


def crop_shares(instances: list[ViewedInstance], order: np.ndarray) -> np.ndarray | None:
    """What soft crops leave of the opacity of Gaussians that order() has listed: [V] float32, 0..1; None where no crop is soft."""
    if not any(crop.soft > 0 for instance in instances for crop in instance.settings.crops):
        return None
    share, done = np.ones(len(order), np.float32), 0
    for instance in instances:
        model, own = instance.model, np.flatnonzero((order >= done) & (order < done + len(instance.model)))
        if any(crop.soft > 0 for crop in instance.settings.crops):
            at = order[own].astype(np.int64) - done
            share[own] = crop_share(instance.settings.crops, positions_at(model, instance.t, at))
        done += len(model)
    return share
