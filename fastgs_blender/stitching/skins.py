# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on the solid surfaces of a model at one moment, and cells in which their neighbours are found.

Trainings lay the Gaussians of one wall differently: here are many small ones, there a few large ones.  So their centres are not compared.
Each Gaussian gets points on its disk, as many as its area needs, and the points of a cell become one with the surface's normal there.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.framing import inside_backdrop, is_subject
from ..model.gaussians import GaussianModel
from ..model.slicing import slice_model
from ..rendering.crops import kept_by
from ..rendering.filters import base_colours
from ..rendering.instances import Instance
from ..util.errors import FastGSError
from ..util.rotations import to_matrices, transformed

SOLID = 0.3
"""Opacity from which on a Gaussian is part of a surface."""
ROUND = 1.2
"""Radius of a Gaussian's disk on which its points lie, in standard deviations."""
POINTS = 120_000
"""About so many points are laid on a model's surfaces."""
LARGEST = 40.0
"""The most points of one Gaussian."""
STRAY = 0.25
"""Largest share of all that a Gaussian's length may be of the model's size; larger ones are haze."""


def skin(instance: Instance) -> np.ndarray:
    """Points on the surfaces that an instance shows at its time: [P, 6] float64, places in the world and colours.

    Backdrop, strays, and what its crops, filters and masks hide are left out.  Each channel of the colours has the mean 0 and the standard
    deviation 1, so that captures of other exposures compare.  The same instance gives the same points.  Raises FastGSError where nothing
    solid is left.
    """
    model: GaussianModel = instance.model
    now = slice_model(model, instance.t)
    keep = (now.opacity >= SOLID) & np.isfinite(now.position).all(1) & np.isin(now.index, inside_backdrop(model))
    if len(instance.hidden):
        keep &= ~instance.hidden[now.index]
    if instance.settings.crops:
        keep &= kept_by(instance.settings.crops, now.position)
    rows = np.flatnonzero(keep)
    rows = rows[is_subject(now.position[rows])] if len(rows) else rows
    if len(rows) < 50:
        raise FastGSError(f'{_named(instance)} has hardly any solid surface at this moment; choose another frame, or pick three pairs.')
    place, lengths = now.position[rows], now.scale[rows]
    size = float(np.linalg.norm(np.ptp(place, axis=0)))
    order = np.argsort(lengths, 1)
    _, middle, long = np.take_along_axis(lengths, order, 1).T
    fine = long < STRAY * size
    place, order, middle, long, rows = place[fine], order[fine], middle[fine], long[fine], rows[fine]
    area = middle * long
    count = np.minimum(area / max(float(np.minimum(area, LARGEST * np.median(area)).sum()), 1e-30) * POINTS, LARGEST)
    ends = np.floor(np.cumsum(count) + 0.5).astype(int)
    which = np.repeat(np.arange(len(rows)), np.diff(ends, prepend=0))
    k = np.arange(len(which))  # an even spread of places on disks: golden angle, and radii of the plastic number's sequence
    turn, radius = 2.399963229728653 * k, ROUND * np.sqrt((k * 0.7548776662466927) % 1)
    axes = to_matrices(now.rotation[rows[which]])
    first = np.take_along_axis(axes, order[which, None, 2:3], 2)[..., 0]
    second = np.take_along_axis(axes, order[which, None, 1:2], 2)[..., 0]
    along, across = (length[which] * radius * wave(turn) for length, wave in ((long, np.cos), (middle, np.sin)))
    points = place[which] + first * along[:, None] + second * across[:, None]
    matrix = instance.placement
    colour = np.nan_to_num(base_colours(model.take(now.index[rows])).astype(np.float64))[which]
    colour = (colour - colour.mean(0)) / np.maximum(colour.std(0), 0.02)
    return np.concatenate([transformed(points, matrix), np.clip(colour, -3, 3)], 1)


def moved(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Points [P, 3 or more], the first three columns moved by a matrix [4, 4]."""
    return np.concatenate([transformed(points[:, :3], motion), points[:, 3:]], 1)


def _named(instance: Instance) -> str:
    return f'"{instance.name}"' if instance.name else "a model"


@dataclass(frozen=True, eq=False)
class Cells:
    """The points of a surface in cubes of one edge: each cube's points are one.

    edge    of the cubes
    keys    [C] int64, numbers of the cubes that hold points, ascending
    place   [C, 3] the means of their points
    colour  [C, 3] and of their colours
    normal  [C, 3] unit normals of the points in and around each cube, of either side
    flat    [C] how flat these lie, 0..1
    """

    edge: float
    keys: np.ndarray
    place: np.ndarray
    colour: np.ndarray
    normal: np.ndarray
    flat: np.ndarray

    @staticmethod
    def of(points: np.ndarray, edge: float) -> Cells:
        """The cells of points [P, 6], see skin()."""
        from ..kernels.cpu.cells import OFFSET, add_around  # it brings numba, which enabling the add-on must not

        points, colours = points[:, :3], points[:, 3:]
        x, y, z = np.clip(np.floor(points / edge).T, 3 - OFFSET, OFFSET - 3).astype(np.int64) + OFFSET
        keys, inverse, count = np.unique((x << 42) | (y << 21) | z, return_inverse=True, return_counts=True)
        middle = points.mean(0)
        way = points - middle
        square = np.stack([way[:, i] * way[:, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], 1)
        sums = np.stack([np.bincount(inverse, column, len(keys)) for column in (*way.T, *square.T)], 1)
        place = sums[:, :3] / count[:, None] + middle
        total = np.concatenate([count[:, None].astype(float), sums], 1)
        near = np.zeros_like(total)
        add_around(keys, place, edge, total, near)
        mean = near[:, 1:4] / near[:, :1]
        spread = near[:, 4:] / near[:, :1] - np.stack(
            [mean[:, i] * mean[:, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], 1)
        colour = np.stack([np.bincount(inverse, column, len(keys)) for column in colours.T], 1) / count[:, None]
        values, vectors = np.linalg.eigh(spread[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3))
        values = np.sqrt(np.maximum(values, 0))
        return Cells(edge, keys, place, colour, vectors[:, :, 0], 1 - values[:, 0] / np.maximum(values[:, 1], 1e-12 * edge))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For points [Q, 3] the cells [Q] whose places are nearest, and their distances [Q]; inf where no cell around has points."""
        from ..kernels.cpu.cells import nearest_places

        found, away = np.empty(len(points), np.int64), np.empty(len(points))
        nearest_places(self.keys, self.place, self.edge, np.ascontiguousarray(points), found, away)
        return found, away
