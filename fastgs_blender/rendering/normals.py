# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth normals: which way the surface looks that a Gaussian is a part of.

A Gaussian's own shortest axis is noise where it is round, or where nothing in the pictures told its tilt.  Its neighbours' places tell
more.  So the normal is the direction in which all Gaussians around it, taken together, spread least: the smallest eigenvector of

    C = sum_j w_j (S_j + x_j x_j^T) - (sum_j w_j x_j) (sum_j w_j x_j)^T,    sum_j w_j = 1,

S_j their covariances, x_j their places.  A Gaussian that is alone keeps its own axis.  Where the object has a surface (Make Mesh), and this
about agrees, its normal counts instead: it was made from the depths that many views see.
"""
from __future__ import annotations

from typing import Any

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at
from ..util.kept import kept
from .instances import ViewedInstance
from .quantities import Quantity, Shown

REACH = 2.0
"""Up to which distance Gaussians count, in median lengths of the model's longest axes."""
AGREE = 0.7
"""Cosine between both normals from which on a surface's counts: elsewhere it is another sheet, or too coarse."""
FACE = 1.0
"""Edge of the cells in which a surface's normals are looked up, in square roots of its mean area of a face."""
LEAST = 1e-12
"""Weight of a Gaussian, at least, in squares of the reach."""


def smooth_normals(shown: Shown, backend: Any, rows: np.ndarray | None = None) -> np.ndarray:
    """Unit normals [M, 3] in the world, turned to the camera, of the Gaussians of an instance that its camera shows.

    backend  a loaded backend (util/backends.py)
    rows     which of the Gaussians they are; None: all.  The others are neighbours alone
    """
    instance, index = shown.instance, shown.index
    if not len(index):
        return np.zeros((0, 3))
    opacity, to_model = opacities_at(instance.model, instance.t, index), instance.camera_to_model
    opacity = opacity * (opacity >= instance.model.raster.alpha_cut)
    if len(instance.hidden):
        opacity = opacity * ~instance.hidden[index]
    towards = np.array([*-to_model[:3, 2], 0.0] if instance.camera.orthographic else to_model[:, 3])
    normal = backend.thinnest(shown.position, shown.axes, opacity, REACH * _length(instance.source), towards,
                              np.linalg.pinv(instance.placement[:3, :3]).T, rows)
    if instance.surface is None:
        return normal
    return _of_surface(instance.surface, shown.world if rows is None else np.take(shown.world, rows, 0), normal)


@kept
def _length(model: GaussianModel) -> float:
    """The median length of a model's longest axes."""
    a, b, c = model.scale.T  # NumPy takes ten times as long over short rows
    return float(np.exp(np.median(np.maximum(np.maximum(a, b), c))))


def normal(instances: list[ViewedInstance], backend: Any) -> Quantity:
    """The smooth normals of instances before their camera."""
    found = {}
    for instance in instances:
        seen = Shown.all_of(instance, backend)
        found[instance] = np.zeros((len(instance.model), 3))
        found[instance][seen.index] = smooth_normals(seen, backend)
    return Quantity(3, lambda shown: found[shown.instance][shown.index])


def thinnest(places: np.ndarray, axes: np.ndarray, opacity: np.ndarray, reach: float, towards: np.ndarray, turn: np.ndarray,
             rows: np.ndarray | None = None) -> np.ndarray:
    """PictureBackend.thinnest() in NumPy."""
    square, asked = np.einsum("ikn,jkn->nij", axes, axes), places if rows is None else places[rows]
    least, middle, most = np.sort(np.sqrt((axes * axes).sum(0)), 0)
    weights = np.maximum(opacity * (middle - least) * most / reach**2, LEAST)
    out = np.zeros((len(asked), 3))
    for p, place in enumerate(asked):
        away = places - place
        w = weights * np.maximum(1 - (away * away).sum(1) / reach**2, 0) ** 2
        w = w / w.sum()
        mean = w @ away
        moments = np.einsum("n,nij->ij", w, square + away[:, :, None] * away[:, None])
        axis = np.linalg.eigh(moments - np.outer(mean, mean))[1][:, 0]
        out[p] = turn @ axis * np.copysign(1, axis @ (towards[:3] - towards[3] * place))
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30)


def _of_surface(triangles: np.ndarray, places: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Normals [M, 3] at places [M, 3]: those of the triangles [F, 3, 3] nearby, as far as they about agree with the ones given."""
    a, b, c = triangles.astype(np.float64).transpose(1, 0, 2)
    area, middle = np.cross(b - a, c - a), (a + b + c) / 3
    cell = FACE * np.sqrt(np.linalg.norm(area, axis=1).mean() or 1.0)
    low = middle.min(0) - 2 * cell
    count = (np.ceil((middle.max(0) - low) / cell) + 3).astype(np.int64)
    inside = np.flatnonzero(((places > low + cell) & (places < low + (count - 2) * cell)).all(1))
    keys, weights = _corners((middle - low) / cell, count)
    cells, slot = np.unique(keys, return_inverse=True)
    total = np.stack([np.bincount(slot.ravel(), (weights * side).ravel(), len(cells)) for side in area.T], 1)
    keys, weights = _corners((places[inside] - low) / cell, count)
    slot = np.minimum(np.searchsorted(cells, keys), len(cells) - 1)
    there = np.where(cells[slot] == keys, weights, 0)
    mean = np.einsum("km,kmi->mi", there, total[slot])
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-30)
    cosine = np.einsum("mi,mi->m", mean, normal[inside])
    agreeing = np.abs(cosine) > AGREE  # a mesh looks outwards, a normal at the camera
    out = normal.copy()
    out[inside[agreeing]] = (mean * np.sign(cosine)[:, None])[agreeing]
    return out


def _corners(at: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers [8, P] of the grid's points around places [P, 3], in units of its cells, and how much of a place each has [8, P]."""
    first = np.floor(at).astype(np.int64)
    share, corner = at - first, np.array(list(np.ndindex(2, 2, 2)))[:, None]
    return (first + corner) @ np.array([count[1] * count[2], count[2], 1]), np.where(corner, share, 1 - share).prod(2)
