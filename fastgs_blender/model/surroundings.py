# SPDX-License-Identifier: GPL-3.0-or-later
"""Surroundings: what a file knows about the place around its Gaussians, so that viewers show the subject, from a good side, at once."""
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np

from ..util import rotations
from ..util.arguments import finite, shown
from ..util.errors import FastGSError

FARTHEST = 1e15
"""Largest coordinate, length or focal length."""
LARGEST_SIDE = 65_536
"""Pixels of the longer side of a picture."""
MOST_CAMERAS = 64
"""Cameras that a file keeps of its capture."""
WITHIN = 0.8
"""Share of the backdrop's radius up to which a camera stands inside: nearer to the backdrop its large Gaussians are fog."""


@dataclass(frozen=True)
class Backdrop:
    """Sky and far walls: the Gaussians whose constant position lies outside of this sphere in the model's space.

    centre  (x, y, z)
    radius  positive

    Example:
        import dataclasses

        backdrop = fg.Backdrop(centre=(0, 0, 1), radius=25)
        model = dataclasses.replace(model, surroundings=fg.Surroundings(backdrop))
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", _numbers(self.centre, 3, "centre of the backdrop"))
        object.__setattr__(self, "radius", _positive(self.radius, "radius of the backdrop"))

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Distances [...] of places [..., 3] from the centre, as a share of the radius."""
        return np.linalg.norm(np.asarray(position, np.float64) - self.centre, axis=-1) / self.radius


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """A place to look from, in the model's space, with OpenCV axes (x right, y down, z forward); cameras/viewpoints.py makes it a Camera.

    width, height   size of the picture in pixels
    fx, fy, cx, cy  focal lengths and principal point in pixels
    position        the camera's centre
    rotation        camera to world, a quaternion w x y z
    distance        how far away that is which is looked at, along z; 0: not known
    name            of the camera in its capture

    Example:
        view = fg.Viewpoint(width=640, height=360, fx=500, fy=500, cx=320, cy=180, position=(0, 0, -4), distance=4)
    """

    width: int = 1
    height: int = 1
    fx: float = 1.0
    fy: float = 1.0
    cx: float = 0.5
    cy: float = 0.5
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    distance: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        for key in ("width", "height"):
            value = getattr(self, key)
            if not isinstance(value, Integral) or not 1 <= int(value) <= LARGEST_SIDE:
                raise FastGSError(f"a viewpoint's {key} must be from 1 to {LARGEST_SIDE} pixels, not {value!r:.40}.")
            set_(self, key, int(value))
        for key in ("fx", "fy"):
            set_(self, key, _positive(getattr(self, key), f"{key} of a viewpoint"))
        for key in ("cx", "cy", "distance"):
            set_(self, key, _numbers((getattr(self, key),), 1, f"{key} of a viewpoint")[0])
        set_(self, "position", _numbers(self.position, 3, "position of a viewpoint"))
        set_(self, "rotation", _numbers(self.rotation, 4, "rotation of a viewpoint"))
        if self.distance < 0 or abs(np.linalg.norm(self.rotation) - 1) > 1e-3 or not isinstance(self.name, str):
            raise FastGSError("a viewpoint needs a rotation that is a unit quaternion, a distance from 0 on and a text as its name.")


@dataclass(frozen=True)
class Surroundings:
    """Facts that a file stores beside the Gaussians: the cameras of the capture, the backdrop, a good view.

    backdrop  None: no Gaussian is known to belong to one
    cameras   where cameras of the capture stood, at most 64 (MOST_CAMERAS)
    view      where the file's author wants it to be looked at first, or None

    Example:
        import dataclasses

        view = fg.Viewpoint(width=640, height=360, fx=500, fy=500, cx=320, cy=180, position=(0, 0, -4), distance=4)
        model = dataclasses.replace(model, surroundings=fg.Surroundings(model.surroundings.backdrop, model.surroundings.cameras, view))
    """

    backdrop: Backdrop | None = None
    cameras: tuple[Viewpoint, ...] = ()
    view: Viewpoint | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.cameras, Iterable):
            raise FastGSError(f"the cameras of a capture are given as Viewpoints, not as {shown(self.cameras)}.")
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if len(self.cameras) > MOST_CAMERAS:
            raise FastGSError(f"a model's file keeps at most {MOST_CAMERAS} cameras of its capture, not {len(self.cameras)}.")

    def moved(self, place: np.ndarray) -> Surroundings:
        """The surroundings of a model that a matrix [4, 4] moves; without what a stretch or a mirror leaves no sense to."""
        place = np.asarray(place, np.float64)
        if self == Surroundings() or np.array_equal(place, np.eye(4)):
            return self
        size = float(np.cbrt(abs(np.linalg.det(place[:3, :3]))))
        turn = place[:3, :3] / max(size, 1e-30)
        if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-5:
            return Surroundings()
        backdrop = self.backdrop and Backdrop(_moved(place, self.backdrop.centre), self.backdrop.radius * size)
        if np.linalg.det(turn) < 0:
            return Surroundings(backdrop)
        own = rotations.from_matrices(turn)

        def one(view: Viewpoint) -> Viewpoint:
            w, x, y, z = rotations.unit(rotations.multiply(own, np.array(view.rotation)))
            rotation = float(w), float(x), float(y), float(z)
            return replace(view, position=_moved(place, view.position), rotation=rotation, distance=view.distance * size)

        return Surroundings(backdrop, tuple(map(one, self.cameras)), self.view and one(self.view))


def together(parts: list[Surroundings]) -> Surroundings:
    """The surroundings of several models of one capture: evenly chosen cameras, the first good view, and the smallest of the backdrops
    inside which all cameras stand; none where a camera would see none of it."""
    cameras = list(dict.fromkeys(camera for part in parts for camera in part.cameras))
    backdrops = sorted((part.backdrop for part in parts if part.backdrop is not None), key=lambda backdrop: backdrop.radius)
    holding = (each for each in backdrops if all(each.distance(np.array(camera.position)) < WITHIN for camera in cameras))
    view = next((part.view for part in parts if part.view is not None), None)
    return Surroundings(next(holding, None), evenly(cameras), view)


def evenly(cameras: list) -> tuple:
    """All viewpoints, or MOST_CAMERAS of them at even intervals."""
    if len(cameras) <= MOST_CAMERAS:
        return tuple(cameras)
    return tuple(cameras[k] for k in np.linspace(0, len(cameras) - 1, MOST_CAMERAS).round().astype(int))


def _moved(place: np.ndarray, point: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = place[:3, :3] @ np.array(point) + place[:3, 3]
    return float(x), float(y), float(z)


def _numbers(values: Sequence[Any], count: int, what: str) -> tuple[float, ...]:
    good = isinstance(values, Iterable) and len(values) == count and all(finite(v) and abs(float(v)) <= FARTHEST for v in values)
    if not good:
        raise FastGSError(f"the {what} must be {count} finite number{'s' if count > 1 else ''}.")
    return tuple(float(v) for v in values)


def _positive(value: object, what: str) -> float:
    number = _numbers((value,), 1, what)[0]
    if not number > 0:
        raise FastGSError(f"the {what} must be positive, not {number:g}.")
    return number
