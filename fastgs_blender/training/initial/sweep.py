# SPDX-License-Identifier: GPL-3.0-or-later
"""Plane sweep: finds surfaces between the features, from one moment's pictures at a quarter of their size and their known poses.

It finds for every pixel of every picture the depth at which its neighbours show the same colours (Collins 1996; best half of the
neighbours, so that occlusion in some does not matter).  Where several pictures agree on a depth there is a surface.
"""
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...util import threads
from ...util.backends import load_backend
from .features import matrix
from .geometry import unproject

DEPTHS = 96
"""Planes, evenly spread in inverse depth."""
NEIGHBOURS = 4, 60.0
"""Pictures that each one is compared with, and degrees between their viewing directions, at most."""
LEAST_ANGLE = 4.0
"""Degrees between the viewing directions of neighbours at least."""
WINDOW = 2
"""Pixels to each side over which differences are averaged."""
ALIKE = 0.05
"""Largest mean difference of colours (0..1) at a surface."""
VAGUE = 1.3
"""Ratio of the depths about as good, above which there is nothing to tell where the surface is (smooth sky)."""
AGREE = 0.02
"""Largest difference of two pictures' depths of one place, as a share."""
OUTSIDE = 1.0
"""Difference where a neighbour's picture ends."""


@dataclass(frozen=True, eq=False)
class Depths:
    """The depths of one picture, all [h, w]: the depth with the least difference, cost, that difference, and range, between which depths it
    is about as small, as the ratio of the farthest to the nearest.

    Where the range leaves it open (VAGUE) the depth is the farthest of them: between smooth sky and the camera there is nothing.
    """

    depth: np.ndarray
    cost: np.ndarray
    range: np.ndarray


def swept(pictures: Sequence[tuple], near: float, far: float, count: int = DEPTHS, window: int = WINDOW,
          neighbours: tuple[int, float] = NEIGHBOURS) -> list[Depths | None]:
    """The depths of each picture (rgb [h, w, 3], camera, inside or None) of one moment, of so many; None for one without neighbours."""
    depths = 1 / np.linspace(1 / near, 1 / far, count)
    planes = np.stack([0 * depths, 0 * depths, 1 / depths], 1)
    return for_each(pictures, near, far, lambda k, others: _depths(differences(pictures[k], others, planes, window), depths), neighbours)


def for_each(pictures: Sequence[tuple], near: float, far: float, found: Callable[[int, list[tuple]], Depths | None],
             neighbours: tuple[int, float] = NEIGHBOURS) -> list[Depths | None]:
    """found(k, the pictures that the k-th is compared with) of each picture of a moment, in threads; None for one without neighbours."""
    most, widest = neighbours
    looking = np.array([camera.world_to_camera[2, :3] for _, camera, _ in pictures])
    centres = np.array([camera.centre for _, camera, _ in pictures])
    degrees = np.degrees(np.arccos(np.clip(looking @ looking.T, -1, 1)))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)

    def one(k: int) -> Depths | None:
        # Parallel cameras beside each other see a place at an angle too.
        angle = np.maximum(degrees[k], np.degrees(apart[k] / np.sqrt(near * far)))
        usable = (angle >= LEAST_ANGLE) & (degrees[k] <= widest) & (apart[k] > 0)
        others = [i for i in np.lexsort((apart[k], degrees[k])) if usable[i]][:most]
        return found(k, [pictures[i] for i in others]) if others else None

    return threads.run(one, [(k,) for k in range(len(pictures))])


def differences(picture: tuple, others: Sequence[tuple], planes: np.ndarray, window: int = WINDOW) -> np.ndarray:
    """Differences of colour [D, h, w] between a picture and the better half of the others, were its surface on each plane [D, 3], by which
    the pixel (u, v) has the inverse depth plane @ (u, v, 1)."""
    image, camera, _ = picture
    views = []
    for other, its, _ in others:
        between = its.world_to_camera @ np.linalg.inv(camera.world_to_camera)
        views.append((other, matrix(its) @ between[:3, :3] @ np.linalg.inv(matrix(camera)), matrix(its) @ between[:3, 3]))
    return load_backend("cpu").sweep(image, views, planes, OUTSIDE, window)


def _depths(cost: np.ndarray, depths: np.ndarray) -> Depths:
    best = cost.argmin(0)
    least = np.take_along_axis(cost, best[None], 0)[0]
    # Between planes: the bottom of the parabola through three of them.
    inner = np.clip(best, 1, len(depths) - 2)
    low, middle, high = (np.take_along_axis(cost, (inner + step)[None], 0)[0] for step in (-1, 0, 1))
    bend = low - 2 * middle + high
    offset = np.where((bend > 1e-6) & (inner == best), np.clip(0.5 * (low - high) / np.maximum(bend, 1e-6), -0.5, 0.5), 0)
    inverse = np.interp(best + offset, np.arange(len(depths)), 1 / depths)
    good = cost <= least + 0.01
    farthest = depths[len(depths) - 1 - good[::-1].argmax(0)]
    ratio = farthest / depths[good.argmax(0)]
    return Depths(np.where(ratio < VAGUE, 1 / inverse, farthest), least, ratio)


def surfaces(pictures: Sequence[tuple], found: list[Depths | None], witnesses: int = 3,
             alike: float = ALIKE) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each picture, points [P, 3] and colours [P, 3] where neighbours differ by less than `alike`, and so many pictures have the same
    depth, itself included (all, where there are fewer)."""
    clouds = []
    others_needed = min(witnesses - 1, sum(depths is not None for depths in found) - 1)
    for k, ((image, camera, inside), depths) in enumerate(zip(pictures, found)):
        if depths is None:
            clouds.append((np.zeros((0, 3)), np.zeros((0, 3))))
            continue
        row, column = np.nonzero((depths.cost < alike) & (depths.range < VAGUE) & (True if inside is None else inside > 0.5))
        places = np.stack([column, row], 1) + 0.5
        points = unproject(camera, places, depths.depth[row, column])
        colours, votes = image[row, column], np.zeros((2, len(points)), np.int64)
        for i, ((shown, other, _), its) in enumerate(zip(pictures, found)):
            if i != k and its is not None:
                load_backend("cpu").vote(points, colours, other, shown, its.depth, its.cost, AGREE, np.inf, 0.0, *votes)
        good = votes[0] >= max(others_needed, 1)
        clouds.append((points[good], colours[good]))
    return clouds

