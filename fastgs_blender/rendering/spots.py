# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians as spots that light falls on.  Spots come last in arrays: NumPy is several times as fast on long rows."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util.threads import taken
from .exposure import PLASTIC
from .instances import ObjectSettings

FAINT, SLIGHT = 0.02, 0.1
"""Shares of a pixel below which a Gaussian asks a quarter and a half of a lamp's points."""
MANY = 16
"""Points of a lamp from which on not all Gaussians ask all of them."""
LEAST = 1e-30
"""Square of a standard deviation, at least."""


@dataclass(frozen=True, eq=False)
class Spots:
    """P spots.

    position, normal  [3, P] in the world; unit normals, turned to the camera, smooth (normals.py)
    axes              [3, 3, P] as columns, each as long as its standard deviation
    index, owner      [P] their numbers in their models, and which of the settings are theirs
    shares            [P] the largest share that each has of a pixel of the picture
    settings          ObjectSettings of the instances
    """

    position: np.ndarray
    normal: np.ndarray
    axes: np.ndarray
    index: np.ndarray
    owner: np.ndarray
    shares: np.ndarray
    settings: tuple[ObjectSettings, ...]

    @classmethod
    def of(cls, surfaces: Sequence[Any]) -> Spots:
        """The Gaussians of all surfaces (relight.py)."""
        first, *others = surfaces
        position, normal, axes, index, shares = (
            np.concatenate([getattr(each, name) for each in surfaces], -1) if others else getattr(first, name)
            for name in ("position", "normal", "axes", "index", "shares"))
        owner = np.repeat(np.arange(len(surfaces)), [len(each.index) for each in surfaces])
        return cls(position, normal, axes, index, owner, shares, tuple(each.instance.settings for each in surfaces))

    def __len__(self) -> int:
        return self.position.shape[1]

    def sizes(self) -> np.ndarray:
        """How far from each spot's position its places lie at most: [P]."""
        return np.sqrt((self.axes * self.axes).sum(0).max(0))

    def part(self, rows: np.ndarray) -> Spots:
        """Some of the spots, in an order."""
        if len(rows) == len(self):
            return self
        position, normal, axes = taken((self.position, self.normal, self.axes), rows, -1)
        return Spots(position, normal, axes, self.index[rows], self.owner[rows], self.shares[rows], self.settings)

    def asking(self, count: int) -> list[tuple[range, np.ndarray]]:
        """Which spots ask which of a lamp's `count` points: runs of these, and the spots of each.

        Those that make little of every pixel ask a half or a quarter of the points, neighbours other ones.  Its points are in an order in
        which each such run is spread all over the lamp (shadow.Light).
        """
        if count < MANY:
            return [(range(count), np.arange(len(self)))]
        ends = np.arange(5) * count // 4
        quarter, faint, rest = self.index % 4, self.shares < FAINT, self.shares >= SLIGHT
        return [(range(*ends[k:k + 2]), np.flatnonzero(rest | np.where(faint, quarter == k, quarter // 2 == k // 2))) for k in range(4)]

    def lit_by(self, lamp: str) -> np.ndarray:
        """Which spots a lamp of that name lights [P] bool."""
        return np.array([lamp not in each.unlit_by for each in self.settings])[self.owner]


def evenly(numbers: np.ndarray) -> np.ndarray:
    """Places [S, 2] in a circle of the radius 1: those of these numbers [S] of a sequence that fills it evenly (Roberts' R2)."""
    radius, turn = np.sqrt(numbers / PLASTIC % 1), 2 * np.pi * (numbers / PLASTIC**2 % 1)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], 1)


def spread(position: np.ndarray, axes: np.ndarray, place: np.ndarray, parallel: bool, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """PictureBackend.spread() in NumPy."""
    squares = np.maximum((axes * axes).sum(0), LEAST)
    towards = place[:, None] - (0 if parallel else position)
    along = (((towards[:, None] * axes).sum(0) / squares) ** 2).sum(0)
    second, longest = np.take_along_axis(axes, squares.argsort(0)[None, 1:], 1).transpose(1, 0, 2)
    places = position[:, None] + within[:, :1] * second[:, None] + within[:, 1:] * longest[:, None]
    return np.sqrt((towards * towards).sum(0) / np.maximum(along, LEAST)), places
