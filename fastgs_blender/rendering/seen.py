# SPDX-License-Identifier: GPL-3.0-or-later
"""Which share of lamps' light comes past the meshes to the points of surfaces that pixels show.

Most pixels beside a shadow's edge lie in full light or in full shadow.  So where there are many, each one first asks a quarter of what
there is to ask, and its neighbours the other quarters.  Where all answers of a pixel and of those around it are the same, they are taken
for the rest.
"""
from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ..cameras.camera import Camera
from ..util.threads import joined, product, several, taken
from .lamps import Lamp
from .ways import Sides, Ways

WITHIN = np.array([[0.125, -0.375], [0.375, 0.125], [-0.125, 0.375], [-0.375, -0.125]])
"""Places in a pixel that a lamp is looked at from, all its points together, in pixels from its middle: no two in one row or column."""
LEAST = np.float32(1e-30)
"""Light that is none."""
FEW = 30_000
"""Pixels up to which each asks everything at once: to ask twice takes longer."""
QUARTERS = 4
"""Parts of what a lamp is asked: one for each pixel of a square of 2 x 2."""


@dataclass(frozen=True, eq=False)
class Seen:
    """P pixels, each of which shows a surface.

    eye     the camera
    pixels  rows and columns [P] of its window
    plane   [3, P] the surface's depth in the middle of the image, and by how much it grows for a pixel to the right and down
    normal  [3, P] in the world
    """

    eye: Camera
    pixels: tuple[np.ndarray, ...]
    plane: np.ndarray
    normal: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels[0])

    def points(self, right: float = 0.0, down: float = 0.0) -> np.ndarray:
        """The points of the surfaces in the world, so many pixels right and down of the pixels' middles: [3, P]."""
        eye, to_world = self.eye, np.linalg.pinv(self.eye.world_to_camera)[:3].tolist()
        left, top = (first + 0.5 - size / 2 for first, size in zip(eye.window, (eye.width, eye.height)))

        def piece(first: int, last: int) -> tuple[np.ndarray]:
            x, y = self.pixels[1][first:last] + (left + right), self.pixels[0][first:last] + (top + down)
            z, z_right, z_down = self.plane[:, first:last]
            depth = z + z_right * x + z_down * y
            spread = 1.0 if eye.orthographic else depth
            x, y = (x + (eye.width / 2 - eye.cx)) / eye.fx * spread, (y + (eye.height / 2 - eye.cy)) / eye.fy * spread
            return np.stack([a * x + b * y + c * depth + d for a, b, c, d in to_world]),

        return joined(piece, len(self))[0]

    @cached_property
    def places(self) -> list[np.ndarray]:
        """The points [3, P] at each of the places WITHIN the pixels."""
        return [self.points(*place) for place in WITHIN.tolist()]

    def faces(self, lamps: Sequence[Lamp]) -> np.ndarray:
        """Which of the surfaces any point of a lamp lies before: [P]."""
        before, position = np.zeros(len(self), bool), self.points()
        behind = np.einsum("kp,kp->p", self.normal, position)
        for lamp in lamps:
            before |= product(lamp.light.points, self.normal).max(0) > (0 if lamp.light.parallel else behind)
        return before

    def quarter(self) -> np.ndarray:
        """Which pixel of its square of 2 x 2 each one is [P]; the squares of a window are those of the whole picture."""
        rows, columns = self._of_image()
        return 2 * (rows % 2) + columns % 2

    def around(self, *masks: np.ndarray) -> np.ndarray:
        """For each of these [P]: whether it is true of any pixel of a pixel's square, or of one of the squares around it [P]."""
        rows, columns = (axis // 2 for axis in self._of_image())
        rows, columns = rows - (rows.min() - 1), columns - (columns.min() - 1)
        width = int(columns.max()) + 2
        sheet, at = np.zeros((len(masks), int(rows.max()) + 2, width), bool), rows * width + columns
        for mask, flat in zip(masks, sheet.reshape(len(masks), -1), strict=True):
            flat[at[mask]] = True
        sheet[:, 1:-1] |= sheet[:, 2:] | sheet[:, :-2]
        sheet[:, :, 1:-1] |= sheet[:, :, 2:] | sheet[:, :, :-2]
        return sheet.reshape(len(masks), -1)[:, at]

    def _of_image(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the image [P]."""
        return self.pixels[0] + self.eye.window[1], self.pixels[1] + self.eye.window[0]


class _Question(NamedTuple):
    """What pixels ask a lamp: the number of its point, how bright that is for this question, at which of the places WITHIN the pixels, and
    at how many places the point is asked."""

    number: int
    bright: float
    place: int
    places: int


def past_meshes(light: Any, count: int, seen: Seen, backend: Any) -> tuple[np.ndarray, np.ndarray]:
    """For each of `count` levels of lamps, which share of their light comes past the meshes to the pixels, and of how many points of the
    lamp, as if each were as bright: [P, L] each.

    light  SceneLight
    """
    scene, middle, quarter = Ways(backend, [], light.meshes, moments=light.moments), seen.points(), seen.quarter()
    total = np.zeros((3, count, len(seen)), np.float32)
    for lamp, level in zip(light.lamps, light.levels, strict=True):
        reach = 0.0 if lamp.light.parallel else 2 * float(np.abs(seen.places[0] - middle).max())
        sides = scene.of_lamp(lamp.name, light.clear.get(lamp.name)).sides(lamp.light, middle, reach)
        sums, all_ = total[:, level], list(_questions(lamp))
        ask = partial(_ask, sums, seen, middle, lamp, sides, light)
        if len(all_) < QUARTERS or len(seen) < FEW or light.levels.count(level) > 1:
            ask([(each, np.arange(len(seen))) for each in all_])
            continue
        first = np.arange(len(all_)) * QUARTERS // len(all_)
        ask([(each, np.flatnonzero(quarter == number)) for each, number in zip(all_, first, strict=True)])
        free, left, _ = sums
        some, none = seen.around(left > 0, left < free)
        unsure = some & none
        sums *= np.where(unsure, np.float32(1), np.float32(QUARTERS))
        ask([(each, np.flatnonzero(unsure & (quarter != number))) for each, number in zip(all_, first, strict=True)])
    free, left, squares = total
    return (left / np.maximum(free, LEAST)).T, np.where(free > 0, (free / np.maximum(squares, LEAST)) * free, 0).T


def _questions(lamp: Lamp) -> Iterator[_Question]:
    """All that each pixel asks a lamp, or may ask."""
    bright = np.abs(lamp.colour).sum(1)
    for number in np.flatnonzero(bright).tolist():
        each = min(max(round(len(WITHIN) * bright[number] / bright.sum()), 1), len(WITHIN))
        for k in range(each):
            yield _Question(number, bright[number] / each, (number * each + k) % len(WITHIN), each)


def _ask(sums: np.ndarray, seen: Seen, middle: np.ndarray, lamp: Lamp, sides: Sides, light: Any,
         asked: list[tuple[_Question, np.ndarray]]) -> None:
    """Add what pixels are told to the sums [3, P] of the light that is sent to them, of what arrives, and of squares.

    asked  questions, and which pixels ask them [R]
    """
    groups = [list(group) for _, group in groupby((each for each in asked if len(each[1])), lambda each: each[0].number)]
    answers = several(partial(_told, seen, middle, lamp, sides, light), [(group,) for group in groups])
    for group, answer in zip(groups, answers, strict=True):
        ends = np.cumsum([len(rows) for _, rows in group])[:-1]
        for (question, rows), share, open_ in zip(group, *(np.split(each, ends) for each in answer), strict=True):
            for row, value in zip(sums, (share, share * open_, question.places * share**2), strict=True):
                row[rows] += value


def _told(seen: Seen, middle: np.ndarray, lamp: Lamp, sides: Sides, light: Any,
          asked: list[tuple[_Question, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """What those who ask a point of a lamp are told, one question after the other: how much light arrives with nothing in the way, and
    which share of it comes past the meshes."""
    (question, rows), *others = asked
    points, normal, bright = seen.places[question.place], seen.normal, np.full(len(rows), question.bright, np.float32)
    if others or len(rows) < len(seen):
        points = np.concatenate([np.take(seen.places[each.place], rows, 1) for each, rows in asked], 1)
        bright = np.concatenate([np.full(len(rows), each.bright, np.float32) for each, rows in asked])
        middle, normal = taken((middle, normal), np.concatenate([rows for _, rows in asked]), -1)
    share, = joined(lambda a, b: (lamp.share(question.number, middle[:, a:b], normal[:, a:b]).astype(np.float32),), points.shape[1])
    share *= bright
    lit, open_ = np.flatnonzero(share), np.ones(len(share), np.float32)
    if 2 * len(lit) > len(share):  # a part costs as much as to ask for a few more
        return share, sides.past(question.number, points[:, None], light.size, light.bias)[0]
    open_[lit] = sides.past(question.number, np.take(points, lit, 1)[:, None], light.size, light.bias)[0]
    return share, open_
