# SPDX-License-Identifier: GPL-3.0-or-later
"""Tells from which side the subject of a camera move was filmed, as a range of angles around it."""
from typing import NamedTuple

import numpy as np
from mathutils import Vector

from ...fastgs_blender.model.filmed_from import filmed_from
from ...fastgs_blender.util.errors import FastGSError
from .. import objects
from . import space
from .framing import surroundings_of

ALL_AROUND = np.radians(135)
"""Where no gap between neighbouring cameras is wider, a subject was filmed from all around."""
BESIDE = np.radians(15)
"""So far beside the outermost cameras what they filmed is still seen well."""
GUESSED = np.radians(45)
"""The same beside the place where the cameras seem to have stood."""


class Side(NamedTuple):
    """Angles around z, from `first` counter-clockwise over `width` radians."""

    first: float
    width: float

    def beyond(self, angles: np.ndarray) -> np.ndarray:
        """By how much angles [M] lie outside of it: [M] radians, 0 within."""
        past = (angles - self.first) % (2 * np.pi)
        return np.where(past <= self.width + 1e-9, 0.0, np.minimum(past - self.width, 2 * np.pi - past))


def filmed_side(splat, centre: Vector) -> Side | None:
    """From where a splat object was filmed, around a centre in the world; None: from all around, or nothing tells."""
    try:
        world, cameras = space.world_matrix(splat, ""), surroundings_of(splat).cameras
        if cameras:
            return _around([world @ Vector(camera.position) - centre for camera in cameras], BESIDE)
        model, t = objects.source_of(splat).moment(0.5)
    except FastGSError:  # the move itself needs no file
        return None
    up = Vector(world[2][:3])
    found = filmed_from(model, t, np.array(up) / max(up.length, 1e-30))
    return None if found is None else _around([world @ Vector(found[0]) - centre], GUESSED)


def _around(places: list[Vector], beside: float) -> Side | None:
    angles = np.sort([np.arctan2(place.y, place.x) for place in places if place.xy.length > 1e-6 * max(place.length, 1e-30)])
    if not len(angles):
        return None
    gaps = np.diff(np.r_[angles, angles[0] + 2 * np.pi])
    widest = int(gaps.argmax())
    if gaps[widest] <= ALL_AROUND:
        return None
    return Side(float(angles[(widest + 1) % len(angles)] - beside), float(2 * np.pi - gaps[widest] + 2 * beside))
