# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth pictures of a model at one moment, from all around its subject or from the side that was filmed, from which a surface is made."""
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.parallel import parallel_camera
from ..model.filmed_from import directions
from ..model.framing import focus_sphere, in_ball, inside_backdrop, is_subject
from ..model.gaussians import GaussianModel
from ..model.slicing import freeze, slice_model
from ..rendering.api import render
from ..util.errors import FastGSError

VIEWS = 48
"""Directions from which the subject is looked at."""
FINE = 1000
"""Directions among which those of one side are chosen,"""
BESIDE = 0.866
"""and the cosine of the largest angle between them and a camera, 30 degrees: what cameras see at a flat angle is told from there."""
UNFACED = 0.14
"""Share of all directions that no camera faces, from which on a subject counts as filmed from one side: cameras on a level arc of 130
degrees leave so many, and those of a ring that look down by 46 degrees."""
FINER = 1.5
"""Pixels to each voxel's edge."""
FEWEST = 160
"""Pixels of a picture's side at least: in fewer, depths are too rough to be a surface."""
SOLID = 0.5
"""Opacity of a pixel from which something is there."""
FAINT = 0.1
"""Opacity below which nothing is there; the depth of pixels between the two is unknown,"""
MIXED = 3.0
"""and so is that of pixels whose mean depth and median depth differ by more pixels: two surfaces show in them."""
STEEP = 0.15
"""Cosine between a pixel's ray and the surface's normal below which its depth is not used."""


@dataclass(frozen=True, eq=False)
class View:
    """One picture: its orthographic camera, depth [h, w] (inf: nothing; NaN: unknown), the cosine between the ray and the surface's normal
    [h, w], and colours [h, w, 3] in the model's colour space."""

    camera: Camera
    depth: np.ndarray
    slope: np.ndarray
    rgb: np.ndarray

    @property
    def pose(self) -> np.ndarray:
        """[3, 4] from the world to pixels and depth."""
        c = self.camera
        return np.array([[c.fx, 0, 0, c.cx], [0, c.fy, 0, c.cy], [0, 0, 1, 0]]) @ c.world_to_camera


@dataclass(frozen=True, eq=False)
class Subject:
    """The Gaussians of which a surface is made, at which moment, and the box [3] low, [3] high that holds them."""

    model: GaussianModel
    t: float
    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> float:
        """The longest side of the box."""
        return float((self.high - self.low).max())

    def camera(self, direction: np.ndarray, pixels: int) -> Camera:
        """An orthographic camera of pixels x pixels that looks at the whole box from a direction, a unit vector [3]."""
        return parallel_camera(direction, self.low, self.high, pixels)


def subject_of(model: GaussianModel, t: float) -> Subject:
    """What of a model becomes a surface: what its cameras look at, without backdrop and strays.  Raises FastGSError where nothing is."""
    now = slice_model(model, t)
    seen = now.opacity >= FAINT
    place, index = now.position[seen], now.index[seen]
    wanted = np.isin(index, inside_backdrop(model)) & in_ball(place, focus_sphere(model.surroundings.cameras)) & is_subject(place)
    if not wanted.any():
        raise FastGSError("nothing is there of which a surface could be made; choose another frame.")
    spread = 2 * np.exp(model.scale[index].max(1))[wanted, None]
    low, high = np.percentile(place[wanted] - spread, 0.2, axis=0), np.percentile(place[wanted] + spread, 99.8, axis=0)
    return Subject(model.take(np.sort(index[wanted])), t, low, high)


def filmed_side(model: GaussianModel, subject: Subject) -> np.ndarray | None:
    """Unit vectors [D, 3] from a subject to about where the cameras stood; None if that was all around it, or is not known."""
    if not model.surroundings.cameras:
        return None
    eyes = np.array([camera.position for camera in model.surroundings.cameras]) - (subject.low + subject.high) / 2
    eyes /= np.maximum(np.linalg.norm(eyes, axis=1, keepdims=True), 1e-30)
    cosine = (directions(FINE) @ eyes.T).max(1)
    if (cosine <= 0).mean() < UNFACED:
        return None
    near = directions(FINE)[cosine > BESIDE]
    return near[np.unique(np.linspace(0, len(near) - 1, VIEWS).astype(int))]


def render_views(subject: Subject, towards: np.ndarray, detail: int, progress: Callable[[float], Any]) -> list[View]:
    """The subject from directions [D, 3]; detail: voxels along the box's longest side."""
    pixels = max(int(np.ceil(float(np.linalg.norm(subject.high - subject.low)) / subject.size * detail * FINER)), FEWEST)
    found, still = [], freeze(subject.model, subject.t)
    for direction in towards:
        found.append(_view(still, subject.camera(direction, pixels)))
        progress(len(found) / len(towards))
    return found


def _view(still: GaussianModel, camera: Camera) -> View:
    """What a camera sees of a model that stands still."""
    passes = render(still, camera, passes=["rgb", "alpha", "depth", "median_depth"])
    depth, alpha = passes["depth"].astype(np.float64), passes["alpha"]
    pixel = 1 / camera.fx
    with np.errstate(invalid="ignore"):
        mixed = ~(np.abs(depth - passes["median_depth"]) <= MIXED * pixel)
        depth = np.where(alpha >= SOLID, np.where(mixed, np.nan, depth), np.where(alpha > FAINT, np.nan, np.inf))
        down, right = np.gradient(np.where(np.isinf(depth), np.nan, depth))
        slope = pixel / np.sqrt(pixel**2 + down**2 + right**2)
    depth[np.isfinite(depth) & ~(slope > STEEP)] = np.nan
    slope = np.where(np.isinf(depth), 1, np.nan_to_num(slope))
    return View(camera, depth.astype(np.float32), slope.astype(np.float32), passes["rgb"] / np.maximum(alpha, 1e-6)[..., None])
