# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry of a capture: the positions of its cameras, the box around the filmed scene, its ground plan, and shared fields of view."""
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..cameras.camera import Camera
from ..training.initial.geometry import depth_range
from ..util.errors import FastGSError
from .samples import Inspection

LEAST_POINTS = 40
CELLS = 32
"""Cells across a picture in which cameras are counted."""
NEAREST = 6
PLAN = {"RFU": ([1, 0, 0], [0, 1, 0], [0, 0, 1]), "RDF": ([1, 0, 0], [0, 0, 1], [0, -1, 0]), "RUB": ([1, 0, 0], [0, 0, -1], [0, 1, 0])}
"""Right, forward and up of the worlds that GaussianModel knows."""


@dataclass(eq=False)
class Space:
    """Cameras by view, those that are trained on, and points [P, 3] on surfaces, as far as any are known."""

    cameras: dict[str, Camera]
    training: list[str]
    points: np.ndarray
    focus: np.ndarray
    range: tuple[float, float]
    axes: str

    @cached_property
    def known(self) -> bool:
        """Whether enough points are known to say how far away surfaces are."""
        return len(self.points) >= LEAST_POINTS

    @cached_property
    def middle(self) -> np.ndarray:
        """The middle [3] of the filmed scene."""
        return np.median(self.points, 0) if self.known else self.focus

    def angle(self, a: str, b: str) -> float:
        """Degrees between two cameras, seen from what the first one films: the median over its picture."""
        return float(np.median(self.angles(a, b)))

    def angles(self, a: str, b: str) -> np.ndarray:
        """Degrees [rows, columns] between two cameras at each place that the first one sees."""
        places = self.surfaces(a)
        one, other = places - self.cameras[a].centre, places - self.cameras[b].centre
        size = np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1)
        return np.degrees(np.arccos(np.clip((one * other).sum(-1) / np.maximum(size, 1e-12), -1, 1)))

    def nearest(self, view: str) -> tuple[str, float]:
        """The training camera nearest to a view by its angle, another one, and that angle in degrees."""
        return min(((other, self.angle(view, other)) for other in self.training if other != view), key=lambda pair: pair[1])

    def depths(self, view: str, places: np.ndarray) -> np.ndarray:
        """How far away [M] the surfaces behind pixels [M, 2] are, by the nearest known points; the middle's depth without any."""
        camera = self.cameras[view]
        flat = max(float((camera.world_to_camera @ [*self.middle, 1])[2]), 1e-6)
        if not self.known:
            return np.full(len(places), flat)
        local = camera.local(self.points)
        pixels, seen = camera.pixels(local), self.within(view, self.points)
        if seen.sum() < NEAREST:
            return np.full(len(places), flat)
        pixels, depth = pixels[seen], local[seen, 2]
        away = ((places[:, None] - pixels) ** 2).sum(-1)
        near = np.argpartition(away, NEAREST - 1, axis=1)[:, :NEAREST]
        return np.median(depth[near], axis=1)

    def counts(self, view: str) -> np.ndarray:
        """How many training cameras [rows, columns] see what a view sees, itself included if it is one."""
        world = self.surfaces(view)
        return self.seen(world.reshape(-1, 3), without=view).reshape(world.shape[:2]) + (view in self.training)

    def apart(self, view: str) -> np.ndarray:
        """Degrees [rows, columns] at what a view sees between it and the nearest other training camera that has it in its picture; inf
        where none has."""
        world = self.surfaces(view)
        least = np.full(world.shape[:2], np.inf)
        for other in self.training:
            if other != view:
                seen = self.within(other, world.reshape(-1, 3)).reshape(least.shape)
                least = np.where(seen, np.minimum(least, self.angles(view, other)), least)
        return least

    def surfaces(self, view: str) -> np.ndarray:
        """The places [rows, columns, 3] that a view sees, at as many cells of its picture; remembered."""
        if view not in self._surfaces:
            self._surfaces[view] = self._unprojected(view)
        return self._surfaces[view]

    @cached_property
    def _surfaces(self) -> dict[str, np.ndarray]:
        return {}

    def _unprojected(self, view: str) -> np.ndarray:
        camera = self.cameras[view]
        columns, rows = CELLS, max(2, round(CELLS * camera.height / camera.width))
        x, y = np.meshgrid((np.arange(columns) + 0.5) / columns * camera.width, (np.arange(rows) + 0.5) / rows * camera.height)
        places = np.stack([x.ravel(), y.ravel()], 1)
        depth = self.depths(view, places)
        local = np.stack([(places[:, 0] - camera.cx) / camera.fx * depth, (places[:, 1] - camera.cy) / camera.fy * depth, depth], 1)
        return ((local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]).reshape(rows, columns, 3)

    def within(self, view: str, xyz: np.ndarray) -> np.ndarray:
        """Which of the points [P, 3] a view has in its picture."""
        camera = self.cameras[view]
        pixels = camera.pixels(camera.local(xyz))
        return np.isfinite(pixels).all(1) & (pixels > 0).all(1) & (pixels < (camera.width, camera.height)).all(1)

    def seen(self, xyz: np.ndarray, without: str = "") -> np.ndarray:
        """How many training cameras [P] have points [P, 3] in their pictures."""
        total = np.zeros(len(xyz), int)
        for view in self.training:
            total += self.within(view, xyz) if view != without else 0
        return total

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The low and the high corner [3] of the filmed scene, in its ground plan: right, forward, up."""
        if self.known:
            inside = self.planned(self.points)
            low, high = np.percentile(inside, (3, 97), axis=0)
            pad = 0.1 * (high - low) + 1e-6
            return low - pad, high + pad
        middle, reach = self.planned(self.middle[None])[0], 0.4 * self.range[0] / 0.3
        return middle - reach, middle + reach

    def planned(self, xyz: np.ndarray) -> np.ndarray:
        """World points [P, 3] as right, forward, up."""
        return xyz @ np.array(PLAN[self.axes], float).T

    def world(self, plan: np.ndarray) -> np.ndarray:
        """The inverse of planned()."""
        return plan @ np.array(PLAN[self.axes], float)


def space_of(inspection: Inspection) -> Space:
    """The space of a capture with poses; points are of features on which cameras agree (without those that are off), or the layout's."""
    capture = inspection.capture
    middle = {view: samples[len(samples) // 2].shot.camera for view, samples in inspection.samples.items()}
    cameras = {view: camera for view, camera in middle.items() if camera is not None}
    try:
        points = inspection.matches.good_points(inspection.judged.wrong)
    except FastGSError:  # without pycolmap
        points = np.zeros((0, 3))
    if len(points) < LEAST_POINTS and capture.points is not None:
        step = max(1, len(capture.points) // 4000)
        points = np.asarray(capture.points.xyz[::step], np.float64)
    return Space(cameras, inspection.training, points, capture.focus, depth_range(capture), capture.axes if capture.axes in PLAN else "RDF")
