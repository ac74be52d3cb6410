# SPDX-License-Identifier: GPL-3.0-or-later
"""Hides Gaussians of a splat object under a brush, and shows them again; the object holds the mask, so that undo and files have it."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.masks import pack_mask, unpack_mask
from ..fastgs_blender.selecting.shapes import Shape, under
from . import objects, snapshot


def mask_of(obj) -> np.ndarray:
    """Which of an object's Gaussians [N] are hidden by hand."""
    return unpack_mask(obj.fastgs.mask, len(objects.load_one_model(obj, "hidden by hand")))


def set_mask(obj, bits: np.ndarray) -> None:
    """Hide these Gaussians [N] of an object, and no others by hand."""
    obj.fastgs.mask = pack_mask(bits)


def brush(obj, depsgraph, camera: fg.Camera, shape: Shape, hide: bool = True) -> int:
    """Hide what an original object shows under a shape of the camera's picture, or show what was hidden there; returns how many."""
    bits = mask_of(obj)
    found = [(item, instance) for item, instance in snapshot.take(depsgraph, rendered=False).pairs()[0] if item.name == obj.name]
    for _, instance in found:
        settings = instance.settings if hide else replace(instance.settings, mask="")
        bits[under(replace(instance, settings=settings).viewed(camera), camera, shape)] = hide
    count = int(np.count_nonzero(bits != mask_of(obj)))
    if count:
        set_mask(obj, bits)
    return count
