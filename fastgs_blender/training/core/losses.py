# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's motion regulariser, for every basis; the photometric loss is a kernel (kernels/protocol.py)."""
import numpy as np

from ...kernels.protocol import MotionNorm
from ...model.motion import Basis

READINGS = ("mean", "group", "printed")
SMOOTH = 1e-4
"""Extents below which a norm is rounded off, so that coefficients near zero are not pushed back and forth across it."""


def motion_norm(basis: Basis, extent: float, reading: str = "mean") -> MotionNorm:
    """The paper's L_M-reg = sum over terms i and axes of i^2 ||w||, in units of the scene, for a backend's motion_penalty().

    extent   the scene's size: coefficients are divided by it, so that lambda means the same in metres and in feet
    reading  what the norm is: 'mean', of each Gaussian's number, |w|, with the mean over the Gaussians; 'group', of the column of
             all Gaussians' numbers, its root mean square (the norm over sqrt(N), so that lambda does not depend on N).  The mean
             pulls every coefficient to zero with the same force, whatever its size; the group pulls in proportion to its share.
             'printed' is the group in the capture's own unit of length, for which motion_factor() undoes the root of N too.
    Below SMOOTH extents they are rounded off.  For other bases than Fourier see Basis.curvature().
    """
    assert reading in READINGS
    matrix = basis.curvature()
    diagonal = matrix.shape[0] == matrix.shape[1] and np.array_equal(matrix, np.diag(np.diag(matrix)))
    weights = np.repeat(np.diag(matrix) if diagonal else np.ones(len(matrix)), 3)
    kept = None if diagonal else matrix
    if reading == "printed":
        return MotionNorm(kept, weights, 1.0, SMOOTH * float(extent), "group")
    return MotionNorm(kept, weights, float(extent), SMOOTH, reading)


def motion_factor(reading: str, count: int) -> float:
    """What the value of a MotionNorm over `count` Gaussians is multiplied by to be this reading of eq. 8."""
    return float(np.sqrt(count)) if reading == "printed" else 1.0
