# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves: whole things, and not the walls that drift in training.

Gaussians of a trained wall drift, since nothing in the films holds them: each its own way, and by less than its size.  Those of a thing
that moves go the same way as their neighbours, by many times their size.  And things are whole: a ball that rolls and stops is of
Gaussians that show it rolling and others that show it lying.  So each Gaussian is what those say that hold it (Joins.held).
"""
import numpy as np

from ..model.gaussians import GaussianModel
from ..model.slicing import opacities_at
from ..rendering.filters import parting, values
from ..util.curve import hilbert_order
from .joins import joins

TIMES = 9
"""Moments of the clip at which velocities are compared."""
ROUNDS = 2
"""How often a Gaussian's velocity becomes the mean of its own and of its neighbours'."""
NOISE, SURE = 4.0, (0.05, 0.75)
"""What goes less than so many times as far as the Gaussians that do not move, in the median, stands still for sure; at least and at most
these shares of the stride from which on a Gaussian moves."""
PULL, REST = 0.03, 1e-4
"""How strongly a Gaussian is pulled to what it does itself, by the sum of what holds it; and everything to what is neither."""


def moving(model: GaussianModel) -> np.ndarray:
    """Which Gaussians [N] bool of a model belong to things that move."""
    from ..kernels.cpu.walk import potential  # it brings numba, which enabling the add-on must not

    stride = strides(model)
    far = parted(model, stride)
    goes = stride >= far
    if not goes.any() or goes.all():
        return goes
    side = goes - (stride < np.clip(NOISE * np.median(stride[~goes]), *np.multiply(SURE, far))).astype(np.float32)
    weight, degree = joins(model).held(len(model))
    ground = (PULL * np.abs(side) + REST) * degree
    return potential(joins(model).ends, weight, ground, PULL * side * degree, hilbert_order(model.position)) > 0


@np.errstate(all="ignore")
def strides(model: GaussianModel) -> np.ndarray:
    """How many times its size each Gaussian [N] goes in a second with what is around it: the mean while it is seen.

    The size is the largest standard deviation; what is smaller than half of the Gaussians counts as large as these.
    """
    from ..kernels.cpu.walk import gathered

    times = (np.arange(TIMES) + 0.5) / TIMES
    seen = np.stack([opacities_at(model, t) for t in times], 1).astype(np.float32)
    velocity = np.stack([model.basis.rate(model.motion, t, model.mu_tau) for t in times], 1)
    carried = np.concatenate([velocity * seen[..., None], seen[..., None]], 2).astype(np.float32)
    for _ in range(ROUNDS):
        carried = gathered(joins(model).ends, carried)
    speed = np.linalg.norm(carried[..., :3], axis=2) / np.maximum(carried[..., 3], 1e-12)
    mean = (seen * speed).sum(1) / np.maximum(seen.sum(1), 1e-12) / max(model.clip.duration, 1e-9)
    size = values(model, "SIZE")
    return mean / np.maximum(size, max(float(np.median(size)) if len(size) else 0.0, 1e-12))


def parted(model: GaussianModel, value: np.ndarray) -> float:
    """The speed or stride that parts what moves from what is still, by how large and how long each Gaussian is seen: specks of a trained
    model are the fastest of all."""
    size = values(model, "SIZE")
    seen = np.sqrt(values(model, "OPACITY") * values(model, "LIFETIME"))
    return parting(value, seen * np.minimum(size, np.percentile(size, 99)) if len(model) else None)
