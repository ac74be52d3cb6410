# SPDX-License-Identifier: GPL-3.0-or-later
"""Separates a model's subject from its surroundings: the backdrop, stray Gaussians far outside, and the room around it."""
from collections.abc import Sequence

import numpy as np

from ..util.rotations import to_matrices
from .gaussians import GaussianModel
from .slicing import positions_at
from .surroundings import Viewpoint

SPREAD = 3.5
"""The subject reaches up to so many median distances from its middle."""
HARDLY = 0.02
"""A ball that holds a smaller share of all positions lies beside what was filmed: cameras that look nearly the same way do not tell how
far away that is."""
FEW = 20
"""Of fewer positions none can be told to be a stray."""
CHUNK = 65_536
"""Gaussians whose places are computed at once."""


def inside_backdrop(model: GaussianModel) -> np.ndarray:
    """Indices [M] of the Gaussians that rest inside a model's backdrop; all where it has none."""
    backdrop = model.surroundings.backdrop
    return np.arange(len(model)) if backdrop is None else np.flatnonzero(backdrop.distance(model.position) <= 1)


def without_backdrop(model: GaussianModel) -> GaussianModel:
    """The model of these Gaussians; the model itself where it has no backdrop."""
    return model if model.surroundings.backdrop is None else model.take(inside_backdrop(model))


def is_subject(position: np.ndarray) -> np.ndarray:
    """Which positions [M, 3] are part of the subject rather than strays or a far background: [M] bool."""
    if len(position) < FEW:
        return np.ones(len(position), bool)
    middle = np.median(position, axis=0)
    away = np.linalg.norm(position - middle, axis=1)
    return away <= SPREAD * np.median(away)


def focus_sphere(cameras: Sequence[Viewpoint]) -> tuple[np.ndarray, float] | None:
    """Centre [3] and radius of the ball that cameras of a capture look at; None where they do not say what they look at.

    It lies where they look, and is the largest that half of them have whole in their pictures: people frame their subject, and what
    reaches out of the pictures on all sides is the room around it.
    """
    cameras = [camera for camera in cameras if camera.distance > 0]
    if not cameras:
        return None
    eyes, turns = np.array([camera.position for camera in cameras]), to_matrices(np.array([camera.rotation for camera in cameras]))
    centre = np.median(eyes + turns[:, :, 2] * np.array([[camera.distance] for camera in cameras]), axis=0)
    edges = np.array([((c.fx, 0, c.cx), (-c.fx, 0, c.width - c.cx), (0, c.fy, c.cy), (0, -c.fy, c.height - c.cy)) for c in cameras])
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)  # [E, 4, 3]: normals, inwards, of the planes through a picture's edges
    inside = np.einsum("nek,njk,nj->ne", edges, turns, centre - eyes).min(1)
    radius = float(np.median(inside))
    return (centre, radius) if radius > 0 else None


def in_ball(position: np.ndarray, ball: tuple[np.ndarray, float] | None) -> np.ndarray:
    """Which positions [M, 3] lie in focus_sphere()'s ball: [M] bool; all where there is none, or hardly any of them does."""
    if ball is not None:
        inside = np.linalg.norm(position - ball[0], axis=1) <= ball[1]
        if inside.sum() > len(position) * HARDLY:
            return inside
    return np.ones(len(position), bool)


def middle(model: GaussianModel) -> np.ndarray:
    """The middle [3] of a model's subject; the origin where it has no Gaussians."""
    place = without_backdrop(model).position
    place = place[in_ball(place, focus_sphere(model.surroundings.cameras))]
    return np.median(place[is_subject(place)], axis=0).astype(np.float64) if len(place) else np.zeros(3)


def bounds(model: GaussianModel) -> tuple[list[float] | None, list[float] | None]:
    """Lowest and highest centre [3] at the quarters of the clip; None for a model without (finite) Gaussians."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, len(model), CHUNK):
        part = model.take(slice(start, start + CHUNK))
        for t in (0, 0.25, 0.5, 0.75, 1) if model.basis.terms else (0,):
            centre = positions_at(part, t)
            centre = centre[np.isfinite(centre).all(1)]
            low, high = np.minimum(low, centre.min(0, initial=np.inf)), np.maximum(high, centre.max(0, initial=-np.inf))
    return (low.tolist(), high.tolist()) if np.isfinite(low).all() else (None, None)
