# SPDX-License-Identifier: GPL-3.0-or-later
"""Carries the vertices of a surface by the motion of the Gaussians around them.

A vertex x is bound to the Gaussians that weigh most around it.  Its place at a time t is a sum of theirs,

    x(t) = sum_i w_i mu_i(t) + r n(t),    sum_i w_i = 1,    sum_i w_i mu_i(t_0) + r n(t_0) = x,

whose weights reproduce every affine motion of the Gaussians exactly (moving least squares).  What they do not reach, across the surface,
follows the surface's normal n(t).  Gaussians that fade hand over: a vertex is bound anew to others that live, where it is.
"""
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at, quaternions_at
from ..util import rotations
from ..util.backends import load_backend
from .quads import Mesh

NEIGHBOURS = 32
"""Gaussians to which a vertex is bound at most."""
REACHES = (4.0, 12.0)
"""Distances in voxels within which they are looked for; the second where the first has none."""
RIDGE = 0.02
"""Share of the squared reach that is added to the Gaussians' spread: directions in which they hardly spread count as unknown."""
FAINT = 0.05
"""Opacity below which a Gaussian carries nothing."""
SMOOTH = 6
"""How often the places that Gaussians give are averaged with the neighbours': single ones stray, where a capture has no texture."""
HALF = 0.5
"""Share of its Gaussians' opacity below which a vertex is bound anew."""
TORN = 4.0
"""A face with a side that is so many times as long as at first, and longer than a voxel, is torn."""


@dataclass(frozen=True, eq=False)
class Binding:
    """To which Gaussians vertices are bound [V, k], with which weights [V, k], their opacities then [V, k] (0: none), and how far beside
    their sum each vertex lies [V, 3]."""

    number: np.ndarray
    weight: np.ndarray
    opacity: np.ndarray
    beside: np.ndarray

    def copy(self) -> "Binding":
        """Another one that can be changed."""
        return Binding(**{name: array.copy() for name, array in vars(self).items()})

    def take(self, other: "Binding", rows: np.ndarray) -> None:
        """Replace the bindings of some vertices."""
        for name in vars(self):
            getattr(self, name)[rows] = getattr(other, name)

    def at(self, place: np.ndarray) -> np.ndarray:
        """The vertices [V, 3] where the Gaussians are at places [N, 3]."""
        return self.beside + load_backend("cpu").weighted_sums(place, self.number, self.weight)

    def support(self, opacity: np.ndarray) -> np.ndarray:
        """The share [V] of the opacity at binding that is left where the Gaussians' are now [N]."""
        return load_backend("cpu").support(opacity, self.number, self.weight, self.opacity)


def places(model: GaussianModel, t: float, wanted: np.ndarray, out: np.ndarray) -> None:
    """Write into out [N, 3] where the Gaussians that are wanted [N] are at a time."""
    weights = np.atleast_2d(model.basis.weights(t - model.mu_tau.astype(np.float64) if model.basis.centred else float(t)))
    load_backend("cpu").places(model.position, model.motion, weights, wanted, out)


def bind(model: GaussianModel, t: float, x: np.ndarray, normal: np.ndarray, voxel: float, opacity: np.ndarray) -> Binding:
    """The binding of vertices [V, 3] with normals at a time, by Gaussians of these opacities [N]."""
    lives, place = opacity > FAINT, np.empty((len(model), 3))
    places(model, t, lives, place)
    alive = np.flatnonzero(lives)
    place = place[alive]
    margin = REACHES[-1] * voxel
    near = ((place > x.min(0) - margin) & (place < x.max(0) + margin)).all(1)
    alive, place = alive[near], place[near]
    turn = rotations.to_matrices(rotations.unit(quaternions_at(model, t, alive)))
    axis = np.take_along_axis(turn, model.scale[alive].argmin(1)[:, None, None], 2)[..., 0]
    number, weight = np.full((len(x), NEIGHBOURS), -1), np.zeros((len(x), NEIGHBOURS))
    reaches = np.full(len(x), REACHES[0] * voxel)
    for reach in REACHES:
        rows = np.flatnonzero((number >= 0).sum(1) < 4)
        if len(rows) and len(alive):
            reaches[rows] = reach * voxel
            found = load_backend("cpu").around(x[rows], normal[rows], place, axis, opacity[alive], reach * voxel, NEIGHBOURS)
            number[rows], weight[rows] = found
    if not len(alive):
        alive, place = np.zeros(1, int), np.zeros((1, 3))
    number = np.maximum(number, 0)
    weight = load_backend("cpu").affine_weights(x, place, number, weight, reaches, RIDGE)
    beside, number = x - load_backend("cpu").weighted_sums(place, number, weight), alive[number]
    return Binding(number, weight, np.where(weight != 0, opacity[number], 0), beside)


@dataclass(frozen=True, eq=False)
class Paths:
    """Places [S, V, 3] float32 of vertices at times [S]."""

    times: np.ndarray
    places: np.ndarray


def carry(model: GaussianModel, t: float, x: np.ndarray, quads: np.ndarray, voxel: float, times: np.ndarray, limit: float,
          progress: Callable[[float], Any]) -> Paths:
    """The paths of a surface's vertices [V, 3] at times [S] around t, as far as no more than a share `limit` of its area tears."""
    mesh, used = Mesh.of(quads, len(x)), np.zeros(len(model), bool)
    longest = TORN * np.maximum(mesh.sides(x), 0.5 * voxel)
    found: dict[int, np.ndarray] = {}
    middle, place = int(np.searchsorted(times, t)), np.zeros((len(model), 3))
    first = bind(model, t, x, mesh.normals(x), voxel, opacities_at(model, t))
    base = mesh.smoothed(x, SMOOTH)
    normal = mesh.normals(base)
    height = ((x - base) * normal).sum(1)
    rest = x - base - height[:, None] * normal
    for steps in (range(middle, len(times)), range(middle - 1, -1, -1)):
        last, raw, towards, binding = t, x, normal, first.copy()
        for step in steps:
            opacity = opacities_at(model, times[step])
            rows = np.flatnonzero(binding.support(opacity) < HALF)
            if len(rows):
                lives = np.minimum(opacity, opacities_at(model, last))
                binding.take(bind(model, last, raw[rows], towards[rows], voxel, lives), rows)
            used[:] = False
            used[binding.number] = True
            places(model, times[step], used, place)
            raw, last = binding.at(place), times[step]
            base = mesh.smoothed(raw, SMOOTH)
            towards = mesh.normals(base)
            now = base + rest + height[:, None] * towards
            areas = mesh.areas(now)
            if areas[(mesh.sides(now) > longest).any(1)].sum() > limit * areas.sum():
                break
            found[step] = now.astype(np.float32)
            progress(len(found) / len(times))
    kept = sorted(found)
    return Paths(times[kept], np.stack([found[step] for step in kept]))
