# SPDX-License-Identifier: GPL-3.0-or-later
"""match_grade(): the looks that give one capture the colours of another, by the surfaces that both of them show.

Both are looked at from the same places.  Where they show the same surface, their colours are compared, as they are seen.
"""
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.poses import look_at
from ..model.filmed_from import directions
from ..rendering.api import render
from ..rendering.colour import linear_to_srgb, srgb_to_linear
from ..rendering.instances import Instance, ObjectSettings
from ..rendering.looks import graded, look_numbers
from ..util.errors import FastGSError
from .skins import Cells, skin

VIEWS = 10
"""Places to look from, all around what both show."""
PIXELS = 128
"""Width and height of a picture."""
SOLID = 0.9
"""Opacity of pixels that are compared."""
TOGETHER = 0.02
"""Depths that differ by less, by the size of what is looked at, are of one surface."""
FEWEST = 300
"""Pixels that are needed."""
ROUNDS = 3
"""Times that the pictures are made with the looks found so far: colours are changed before they are blended."""
LOOKS = ("exposure", "contrast", "saturation", "hue", "tint")
"""What is changed.  A gamma does what a contrast and an exposure do together."""
PRIOR = np.array([0.02, 0.1, 0.05, 0.2, 0.05, 0.05])
"""How strongly each number is held where colours do not tell it: a grey wall knows no hue."""
ODD = 0.06
"""Difference of a colour from which on a pixel counts less: it shows what the other capture has not, such as a shadow."""


@dataclass(frozen=True, eq=False)
class Grade:
    """Looks that give one capture the colours of another.

    looks          exposure, contrast, saturation, hue, tint: of an ObjectSettings; gamma is 1
    before, after  mean difference of the colours, sRGB 0..1, of what both show
    pixels         that were compared

    Example:
        grade = fg.match_grade(fg.Instance(model, np.eye(4), 0.0), fg.Instance(model, np.eye(4), 0.0))
        print(grade.looks, grade.before, grade.after)
    """

    looks: dict[str, Any]
    before: float
    after: float
    pixels: int


def match_grade(moving: Instance, fixed: Instance, progress: Callable[[float], Any] | None = None) -> Grade:
    """The looks that give the first capture the colours that the second has, its looks included, where they show the same surfaces.

    They must be aligned.  What lamps do to either is left out.  progress: called with 0..1 between pieces of work; what it raises passes.
    Raises FastGSError where too little is shown by both.

    Example:
        grade = fg.match_grade(fg.Instance(model, np.eye(4), 0.0), fg.Instance(model, np.eye(4), 0.0, fg.ObjectSettings(exposure=1.0)))
    """
    progress = progress or (lambda share: None)
    plain = {"captured_light": 1.0, "lamp_light": 0.0, "shadows": 0.0, "opacity": 1.0}
    neutral: dict[str, Any] = {"exposure": 0.0, "contrast": 1.0, "gamma": 1.0, "saturation": 1.0, "hue": 0.0, "tint": (1.0, 1.0, 1.0)}
    fixed, moving = _looking(fixed, plain), _looking(moving, plain)
    cameras = _cameras(moving, fixed)
    progress(0.1)
    aims, depths = zip(*(_seen(fixed, camera) for camera in cameras))
    progress(0.3)
    first, places = zip(*(_seen(moving, camera) for camera in cameras))
    size = _width(cameras[0])
    both = [np.abs(a - b) < TOGETHER * size for a, b in zip(places, depths)]
    pixels = int(sum(mask.sum() for mask in both))
    if pixels < FEWEST:
        raise FastGSError("the two captures show too little together for their colours to be compared; align them first.")

    def of(pictures: Any) -> np.ndarray:
        return np.concatenate([picture[mask] for picture, mask in zip(pictures, both)])

    target, before = of(aims), of(first)
    source = of([_seen(_looking(moving, neutral), camera)[0] for camera in cameras])
    aim, best = target.copy(), (np.inf, dict(neutral))
    for number in range(ROUNDS):
        looks = _fitted(source, aim, moving.model.colour_space)
        shown = of([_seen(_looking(moving, looks), camera)[0] for camera in cameras])
        left = _difference(shown, target)
        if left < best[0]:
            best = left, looks
        aim = aim + 0.7 * np.median(target - shown, axis=0)
        progress(0.5 + 0.5 * (number + 1) / ROUNDS)
    was = _difference(before, target)
    if best[0] >= was:
        best = was, {name: getattr(moving.settings, name) for name in neutral}
    return Grade({name: best[1][name] for name in (*LOOKS, "gamma")}, was, best[0], pixels)


def _looking(instance: Instance, looks: dict[str, Any]) -> Instance:
    """The instance with other looks."""
    return replace(instance, settings=replace(instance.settings, **looks))


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(np.clip(one, 0, 1) - np.clip(other, 0, 1)).mean())


def _cameras(moving: Instance, fixed: Instance) -> list[Camera]:
    """Cameras all around the surfaces that both show, and from amid them."""
    a, b = skin(moving)[:, :3], skin(fixed)[:, :3]
    size = min(float(np.linalg.norm(np.ptp(points, axis=0))) for points in (a, b))
    wide = Cells.of(np.concatenate([b, np.zeros_like(b)], 1), 0.04 * size)
    shared = a[np.isfinite(wide.nearest(a)[1])]
    if len(shared) < 50:
        raise FastGSError("the two captures do not overlap, so that their colours cannot be compared; align them first.")
    low, high = np.percentile(shared, 2, axis=0), np.percentile(shared, 98, axis=0)
    middle, width = (low + high) / 2, float(np.linalg.norm(high - low))
    found = []
    for k, way in enumerate(directions(VIEWS)):
        inside = k % 2  # rooms are seen from within
        up = (0.0, 0.0, 1.0) if abs(way[2]) < 0.9 else (1.0, 0.0, 0.0)
        eye = middle + way * width * (0.02 if inside else 1.1)
        pose = look_at(eye, middle if not inside else eye + way, up)
        focal = PIXELS * (0.5 if inside else 1.05)
        found.append(Camera(PIXELS, PIXELS, focal, focal, PIXELS / 2, PIXELS / 2, pose, near=1e-3 * width))
    return found


def _width(camera: Camera) -> float:
    return float(camera.near / 1e-3)


def _seen(instance: Instance, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The sRGB colours [h, w, 3] that an instance shows, and their depths [h, w]: NaN where it is not solid."""
    found = render([instance], camera, passes=["rgb", "alpha", "median_depth"])
    alpha = found["alpha"]
    colour = found["rgb"] / np.maximum(alpha, 1e-6)[..., None]
    if instance.model.colour_space == "linear":
        colour = linear_to_srgb(colour)
    depth = np.where((alpha >= SOLID) & np.isfinite(found["median_depth"]), found["median_depth"], np.nan)
    return colour.astype(np.float64), depth


def _fitted(source: np.ndarray, target: np.ndarray, colour_space: str) -> dict[str, Any]:
    """The looks that bring colours [M, 3], sRGB, to others: robust least squares of their differences as seen."""
    some = slice(None, None, max(len(source) // 6000, 1))
    x, y = np.clip(source[some], 0, None), target[some]
    x = srgb_to_linear(x) if colour_space == "linear" else x
    numbers = np.zeros(6)
    bright = [max(float(np.median(srgb_to_linear(np.clip(colours, 0, 1)))), 1e-4) for colours in (source, y)]
    numbers[0] = np.log2(bright[1] / bright[0])

    def shown(p: np.ndarray) -> np.ndarray:
        colour = graded(x, look_numbers(ObjectSettings(**_looks(p)), colour_space))
        return linear_to_srgb(colour) if colour_space == "linear" else colour

    def cost(p: np.ndarray) -> float:
        off = ((shown(p) - y) ** 2).sum(1)
        return float((off / (off + ODD**2)).mean() * ODD**2 + 1e-3 * ((PRIOR * p)[1:] ** 2).sum())

    damping, least = 1e-3, cost(numbers)
    for _ in range(60):
        now = shown(numbers)
        off = now - y
        weight = (ODD**2 / ((off**2).sum(1) + ODD**2)) ** 2
        slopes = np.stack([(shown(numbers + step) - now) / 1e-4 for step in 1e-4 * np.eye(6)], -1)
        total = np.einsum("n,nci,ncj->ij", weight, slopes, slopes) / len(x) + 1e-3 * np.diag(PRIOR**2)
        wanted = -np.einsum("n,nci,nc->i", weight, slopes, off) / len(x) - 1e-3 * PRIOR**2 * numbers
        wanted[0] += 1e-3 * PRIOR[0] ** 2 * numbers[0]
        tried = numbers + np.linalg.solve(total + damping * np.diag(np.diag(total) + 1e-9), wanted)
        tried = np.clip(tried, [-8, -1.5, -1.5, -np.pi, -2, -2], [8, 1.5, 1.5, np.pi, 2, 2])
        if (value := cost(tried)) < least:
            done, numbers, damping = least - value < 1e-9, tried, damping / 3
            least = value
            if done:
                break
        else:
            damping *= 4
            if damping > 1e6:
                break
    return _looks(numbers)


def _looks(p: np.ndarray) -> dict[str, Any]:
    """The looks of six numbers: exposure, ln of contrast and of saturation, hue, ln of red and of blue by green; the largest tint is 1."""
    tint = np.exp([p[4], 0.0, p[5]])
    return {"exposure": float(p[0] + np.log2(tint.max())), "contrast": float(np.exp(p[1])), "gamma": 1.0, "saturation": float(np.exp(p[2])),
            "hue": float(p[3]), "tint": tuple((tint / tint.max()).tolist())}
