# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a surface from depth pictures: a volume is carved by what all views see as empty, and its skin is drawn onto the depths.

Carving keeps thin sheets, which an average over views from both sides would dissolve: a point is empty where some views see it before
their surface (as in Gaussian Opacity Fields, Yu et al. 2024).  Its skin lies a share of a voxel too far out, so that sheets have an inside.
Then each vertex goes where the views that it faces see the surface, on average.
"""
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..rendering.lookup import between_pixels
from ..util.backends import load_backend
from .nets import surface_net
from .quads import Mesh, normals
from .views import Subject, View

AGREE = 3
"""Views that must see a point as empty."""
REACH = 3.0
"""Voxels before and behind a surface within which distances are told."""
THICK = 0.7
"""Voxels by which the skin lies outside of the surface at first,"""
HAIR = 0.2
"""and at last where it is the skin of a sheet, so that both of its sides do not coincide."""
SHEET = 2.0
"""Voxels below the skin: if it is empty there again, it is the skin of a sheet."""
ROUNDS = 3
FACING = 0.25
"""Cosine between a vertex' normal and the direction to a view below which the view does not count for the vertex."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Quads [Q, 4] on vertices [V, 3], with colours [V, 3] in the model's colour space, and how many views face each vertex [V]."""

    vertices: np.ndarray
    quads: np.ndarray
    colours: np.ndarray
    seen: np.ndarray

    def take(self, keep: np.ndarray) -> "Surface":
        """What is left of it where vertices [V] are kept: the quads of which all are."""
        quads = self.quads[keep[self.quads].all(1)]
        used = np.unique(quads)
        return Surface(self.vertices[used], np.searchsorted(used, quads), self.colours[used], self.seen[used])


def carved(subject: Subject, views: list[View], detail: int, smoothing: int, least: float, progress: Callable[[float], Any]) -> Surface:
    """The surface of what the views see.

    detail     voxels along the subject's longest side
    smoothing  how often the way to the depths is averaged with the neighbours'
    least      share of the area that a piece must have to stay
    """
    voxel = subject.size / detail
    low = subject.low - 2.5 * voxel
    shape = tuple(int(n) for n in np.ceil((subject.high + 2.5 * voxel - low) / voxel).astype(int) + 1)
    depths, slopes = np.stack([view.depth for view in views]), np.stack([view.slope for view in views])
    poses = np.stack([view.pose for view in views])
    volume = load_backend("cpu").carve(depths, slopes, poses, low, voxel, shape, REACH * voxel, AGREE, progress)
    volume[[0, -1]] = volume[:, [0, -1]] = volume[:, :, [0, -1]] = REACH * voxel
    place, quads = surface_net(volume - np.float32(THICK * voxel))
    surface = Surface(low + voxel * place, quads, np.zeros_like(place), np.zeros(len(place)))
    piece = Mesh.of(quads, len(place)).pieces()
    surface = surface.take((np.bincount(piece, minlength=len(piece)) >= least * len(piece))[piece])
    deep = (surface.vertices - SHEET * voxel * normals(surface.vertices, surface.quads) - low) / voxel
    below = volume[tuple(np.clip(np.rint(deep).astype(int), 0, np.array(shape) - 1).T)]
    return _drawn(surface, views, voxel, smoothing, np.where(below > 0, HAIR * voxel, 0))


def _drawn(surface: Surface, views: list[View], voxel: float, smoothing: int, hair: np.ndarray) -> Surface:
    """The surface with its vertices where the views see it, or farther outside by `hair` [V]."""
    mesh, x = Mesh.of(surface.quads, len(surface.vertices)), surface.vertices
    for i in range(ROUNDS):
        normal = mesh.normals(x)
        away, seen, colour = _seen_from(x, normal, views, voxel, i == ROUNDS - 1)
        away = np.where(seen > 0, away, -THICK * voxel if i == 0 else 0)
        away = mesh.smoothed(away, smoothing)
        x = x + (away + (hair if i == ROUNDS - 1 else 0))[:, None] * normal
        if i < ROUNDS - 1:
            shift = mesh.smoothed(x) - x
            x = x + shift - (shift * normal).sum(1, keepdims=True) * normal
    return replace(surface, vertices=x, colours=_filled(colour, seen, mesh), seen=seen)


def _seen_from(x: np.ndarray, normal: np.ndarray, views: list[View], voxel: float,
               coloured: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(how far behind each vertex the surface lies, along its normal and negative [V]; by how many views [V]; colours [V, 3])."""
    total, weights, count, sharpness = np.zeros((4, len(x)))
    colour = np.zeros((len(x), 3))
    for view in views:
        towards = -view.camera.world_to_camera[2, :3]
        cosine = normal @ towards
        rows = np.flatnonzero(cosine > FACING)
        column, row, depth = (x[rows] @ view.pose[:, :3].T + view.pose[:, 3]).T
        with np.errstate(invalid="ignore"):
            d = (between_pixels(view.depth, column - 0.5, row - 0.5) - depth) * between_pixels(view.slope, column - 0.5, row - 0.5)
            near = np.abs(d) < 1.5 * voxel
        rows, d = rows[near], d[near]
        weight = cosine[rows] ** 2
        total[rows] -= weight * d
        weights[rows] += weight
        count[rows] += 1
        if coloured:
            sharp = weight[:, None] ** 2  # as seen from straight before it
            colour[rows] += sharp * between_pixels(view.rgb, column[near] - 0.5, row[near] - 0.5)
            sharpness[rows] += sharp[:, 0]
    return total / np.maximum(weights, 1e-9), count, colour / np.maximum(sharpness, 1e-9)[:, None]


def _filled(colour: np.ndarray, seen: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Colours [V, 3], where no view faces a vertex those of its neighbours."""
    known = seen > 0
    while not known.all():
        both = mesh.smoothed(np.c_[colour * known[:, None], known], share=1.0)
        new = ~known & (both[:, 3] > 0)
        if not new.any():
            break
        colour = np.where(new[:, None], both[:, :3] / np.maximum(both[:, 3:], 1e-9), colour)
        known = known | new
    return colour
