# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Gaussians are at a time, how they are turned, and their axes."""
from __future__ import annotations

import math

import numpy as np

from ...util.threads import portions, run
from .. import asserts
from .jit import kernel
from .project import _axes, _moved3, _moved4, _quaternion
from .splats import plain, weights_at


def posed(instance, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """PictureBackend.posed()."""
    asserts.posed(index)
    model, t = instance.model, instance.t
    place, turn, axes = np.empty((3, len(index))), np.empty((4, len(index))), np.empty((3, 3, len(index)))
    arrays = tuple(plain(a) for a in (model.position, model.rotation, model.scale, model.motion, model.rotation_motion, model.mu_tau))
    rest = index, arrays, (t, weights_at(model.basis, t), weights_at(model.rotation_basis, t)), place, turn, axes
    run(lambda first, last: pose(first, last, *rest), portions(len(index)))
    return place.T, turn.T, axes


@kernel
def pose(first, last, index, arrays, times, place, turn, axes):
    """The places [3, M], unit quaternions [4, M] and axes [3, 3, M] of those of the Gaussians index [M] from first to last.

    arrays  position, rotation, scale, motion, rotation_motion, mu_tau of the model
    times   (t, (index, weights, centred) of the motion, the same of the rotation)
    """
    position, rotation, scale, motion, rotation_motion, mu_tau = arrays
    t, (m_index, m_weights, m_centred), (r_index, r_weights, r_centred) = times
    for k in range(first, last):
        n = index[k]
        delta = t - np.float64(mu_tau[n])
        x, y, z = _moved3(motion, n, m_index, m_weights, m_centred, delta)
        place[0, k], place[1, k], place[2, k] = x + position[n, 0], y + position[n, 1], z + position[n, 2]
        turned = _moved4(rotation_motion, n, r_index, r_weights, r_centred, delta)
        w, x, y, z, _ = _quaternion(rotation, n, turned)
        turn[0, k], turn[1, k], turn[2, k], turn[3, k] = w, x, y, z
        for column, axis in enumerate(_axes(w, x, y, z)):
            size = math.exp(scale[n, column])
            axes[0, column, k], axes[1, column, k], axes[2, column, k] = axis[0] * size, axis[1] * size, axis[2] * size
