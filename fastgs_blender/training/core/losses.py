# SPDX-License-Identifier: GPL-3.0-or-later
"""What training brings down: the difference of the pictures, and the paper's penalty of quick motion."""
from __future__ import annotations

import numpy as np
import torch

from ...kernels.cpu import loss as kernels
from ...kernels.cpu import penalty
from ...model.motion import Basis
from ...util.threads import ranges, run

READINGS = ("mean", "group")
SMOOTH = 1e-4
"""Extents below which a norm is rounded off, so that what rests does not tremble."""
ROWS = 16_384
"""Gaussians in one piece of work."""


class Known(torch.autograd.Function):
    """A number whose gradient by a tensor is known already."""

    @staticmethod
    def forward(ctx, tensor, value, gradient):
        ctx.save_for_backward(torch.from_numpy(gradient))
        return tensor.new_tensor(value)

    @staticmethod
    def backward(ctx, grad):
        return ctx.saved_tensors[0] * grad, None, None


def photometric(image: torch.Tensor, target, weight=None, dssim: float = 0.2) -> tuple[torch.Tensor, float, float]:
    """(1 - dssim) L1 + dssim (1 - SSIM) of pictures [h, w, 3]: (loss, L1, SSIM), the loss differentiable by the image.

    target [h, w, 3] and weight [h, w] (or None) are arrays or tensors without gradients; see kernels.loss.photometric for what
    the weight means.
    """
    weight = None if weight is None else _array(weight)
    value, gradient, l1, ssim = kernels.photometric(_array(image), _array(target), weight, float(dssim))
    return Known.apply(image, value, gradient), l1, ssim


def _array(values) -> np.ndarray:
    return values.detach().numpy() if isinstance(values, torch.Tensor) else np.asarray(values)


class MotionPenalty:
    """The paper's L_M-reg = sum over terms i and axes of i^2 ||w||, in units of the scene.

    extent   the scene's size: coefficients are divided by it, so that lambda means the same in metres and in feet
    reading  what the norm is: 'mean', of each Gaussian's number, |w|, with the mean over the Gaussians; 'group', of the column of
             all Gaussians' numbers, its root mean square (the norm over sqrt(N), so that lambda does not depend on N).  The mean
             pulls every coefficient to zero with the same force, whatever its size; the group pulls in proportion to its share.
    Below SMOOTH extents both are rounded off.  For other bases than Fourier see Basis.curvature().
    """

    def __init__(self, basis: Basis, extent: float, reading: str = "mean"):
        assert reading in READINGS
        self.extent, self.reading = float(extent), reading
        matrix = basis.curvature()
        self.matrix = None if matrix.shape[0] == matrix.shape[1] and np.array_equal(matrix, np.diag(np.diag(matrix))) else matrix
        self.weights = np.repeat(np.diag(matrix) if self.matrix is None else np.ones(len(matrix)), 3)

    def add(self, motion: np.ndarray, gradient: np.ndarray, scale: float = 1.0, times: np.ndarray | None = None) -> float:
        """L_M-reg of motion [N, K, 3] float32; scale * times * d L_M-reg / d motion is added to gradient [N, K, 3] float32.

        times [N] float32 or None (ones): the steps that each row's next move stands for.  A row that moves only in every third
        step, but then with three times the gradient, goes where it would have gone with a penalty in every step; 0: it does not
        move.  The value is that of all rows.
        """
        n = len(motion)
        if not n or not self.weights.any():
            return 0.0
        if self.matrix is None:
            return self._add(motion.reshape(n, -1), gradient.reshape(n, -1), scale, times)
        rows = np.ascontiguousarray(np.einsum("rk,nkd->nrd", self.matrix.astype(np.float32), motion)).reshape(n, -1)
        part = np.zeros_like(rows)
        value = self._add(rows, part, scale, times)
        gradient += np.einsum("rk,nrd->nkd", self.matrix.astype(np.float32), part.reshape(n, -1, 3))
        return value

    def _add(self, values, gradient, scale, times):
        n, columns = values.shape
        times = np.ones(n, np.float32) if times is None else np.ascontiguousarray(times, np.float32)
        pieces = [(sums, *piece) for sums, piece in zip(np.zeros((-(-n // ROWS), columns)), ranges(n, ROWS))]
        share, smooth = self.weights / (n * self.extent), SMOOTH * self.extent
        if self.reading == "mean":
            factor = (scale * share).astype(np.float32)
            run(lambda sums, a, b: penalty.magnitudes(a, b, values, smooth, factor, times, gradient, sums), pieces)
            return float(np.sum([sums for sums, _, _ in pieces], 0) @ share)
        run(lambda sums, a, b: penalty.squares(a, b, values, sums), pieces)
        norm = np.sqrt(np.sum([sums for sums, _, _ in pieces], 0) / n + smooth**2)
        factor = (scale * share / norm).astype(np.float32)
        run(lambda sums, a, b: penalty.scaled(a, b, values, factor, times, gradient), pieces)
        return float((norm - smooth) @ self.weights / self.extent)


def motion_penalty(motion: torch.Tensor, basis: Basis, extent: float, reading: str = "mean") -> torch.Tensor:
    """MotionPenalty as a differentiable function of motion [N, K, 3], all rows of it."""
    gradient = np.zeros(motion.shape, np.float32)
    return Known.apply(motion, MotionPenalty(basis, extent, reading).add(_array(motion), gradient), gradient)
