# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that torch can differentiate, for research with torch: a backend's forward and backward passes as an autograd function.

    from fastgs_blender.differentiable import render
    picture = render({name: torch.from_numpy(array).requires_grad_() ...}, model, camera, t=0.25)
    loss = (picture.rgb - target).abs().mean()
    loss.backward()

Nothing else in the library imports this module; training does without torch.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .cameras.camera import Camera
from .kernels.protocol import ScreenStatistics
from .model.gaussians import GaussianModel
from .util.backends import load_backend


@dataclass(frozen=True, eq=False)
class Rendered:
    """A differentiable picture: rgb [h, w, 3] premultiplied, alpha [h, w], depth [h, w] premultiplied (sum of w z) or None."""

    rgb: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor | None


class _Picture(torch.autograd.Function):
    """The parameters -> rgb [h, w, 3], alpha [h, w], depth [h, w] (or empty)."""

    @staticmethod
    def forward(ctx, names, call, statistics, detach_time, *tensors):
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        backend = load_backend("cpu")
        ctx.names, ctx.statistics, ctx.detach_time = names, statistics, detach_time
        ctx.picture = backend.splat({name: tensor.detach().numpy() for name, tensor in zip(names, tensors)}, *call)
        depth = np.empty(0, np.float32) if ctx.picture.depth is None else ctx.picture.depth
        return tuple(torch.from_numpy(np.array(backend.numpy(array))) for array in (ctx.picture.rgb, ctx.picture.alpha, depth))

    @staticmethod
    def backward(ctx, rgb, alpha, depth):
        _ = ctx.saved_tensors  # raises where a parameter was changed since
        backend = load_backend("cpu")
        rgb, alpha, depth = (None if grad is None else backend.array(grad.numpy()) for grad in (rgb, alpha, depth))
        gradients = backend.backward(ctx.picture, rgb, alpha, depth if ctx.picture.depth is not None else None,
                                     statistics=ctx.statistics, detach_time=ctx.detach_time)
        return None, None, None, None, *(torch.from_numpy(np.array(backend.numpy(gradients[name]))) if needed else None
                                         for name, needed in zip(ctx.names, ctx.needs_input_grad[4:]))


def render(parameters: dict[str, torch.Tensor], template: GaussianModel, camera: Camera, t: float, depth: bool = False,
           statistics: ScreenStatistics | None = None, detach_time: bool = False, band: float = 0.0) -> Rendered:
    """What fastgs_blender.render() gives for the same model, pixel for pixel, and differentiable.

    parameters   float32 tensors on the CPU: all of GaussianModel.arrays, and w1 [6, 12], w2 [3, 6] of a decoder.  Their memory is
                 read in place and must not change before the backward pass
    template     a model of the same kinds; its arrays are ignored
    statistics   filled by the backward pass (training.core.statistics.Statistics)
    detach_time  mu_tau's gradient comes through the temporal opacity alone, as STG trains
    band         alpha fades in over this width above the cut: for checks of the gradients
    """
    rgb, alpha, deep = _Picture.apply(tuple(parameters), (template, camera, float(t), depth, float(band)), statistics, detach_time,
                                      *parameters.values())
    return Rendered(rgb, alpha, deep if depth else None)
