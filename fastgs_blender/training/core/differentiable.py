# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that torch can differentiate: the kernels that render, and their backward passes, as autograd functions."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...cameras.camera import Camera
from ...kernels.cpu import backend as cpu
from ...kernels.cpu.jit import announce
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...rendering.instances import Instance, ViewedInstance
from ...rendering.layout import Layout
from .model import DECODER, with_arrays
from .statistics import Statistics


@dataclass(frozen=True, eq=False)
class Rendered:
    """A differentiable picture: rgb [h, w, 3] premultiplied, alpha [h, w], depth [h, w] premultiplied (sum of w z) or None.

    seen: int32, the Gaussians that were drawn
    """

    rgb: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor | None
    seen: np.ndarray


@dataclass(eq=False)
class View:
    """One model at one time before one camera, and what the forward pass leaves for the backward pass.

    band  width over which alpha fades in above the cut: 0 but for checks of the gradients (kernels/raster.py)
    """

    part: ViewedInstance
    camera: Camera
    layout: Layout
    statistics: Statistics | None
    detach_time: bool
    band: float
    cloud: cpu.Cloud | None = None
    drawn: cpu.Drawn | None = None


class Splat(torch.autograd.Function):
    """Project and rasterise: the model's arrays -> channels [h, w, C], alpha [h, w], depth [h, w] (or empty)."""

    @staticmethod
    def forward(ctx, view: View, *arrays):
        ctx.set_materialize_grads(False)
        ctx.view = view
        ctx.save_for_backward(*arrays)
        view.cloud = cloud = cpu.project_parts([view.part], view.camera, view.layout)
        buffers, view.drawn = cpu.rasterise_forward(cloud.order(), cloud.geometry, cloud.shade, cloud.channels, view.camera, view.band)
        depth = np.empty(0, np.float32) if view.layout.depth is None else buffers.channels[..., view.layout.depth].copy()
        return torch.from_numpy(buffers.channels), torch.from_numpy(buffers.alpha), torch.from_numpy(depth)

    @staticmethod
    def backward(ctx, grad_channels, grad_alpha, grad_depth):
        view: View = ctx.view
        _ = ctx.saved_tensors  # raises where a parameter was changed since
        _, _, width, height = view.camera.window
        channels = np.zeros((height, width, view.cloud.channels), np.float32) if grad_channels is None else grad_channels.numpy()
        alpha = np.zeros((height, width), np.float32) if grad_alpha is None else grad_alpha.numpy()
        if view.layout.depth is not None and grad_depth is not None:
            channels = channels.copy()  # torch's own
            channels[..., view.layout.depth] += grad_depth.numpy()
        splats = cpu.rasterise_backward(view.drawn, channels, alpha)
        if view.statistics is not None:
            view.statistics.observe(view.cloud, splats, view.camera)
        gradients = cpu.project_backward(view.part, view.camera, view.layout, view.cloud, splats, view.detach_time)
        return None, *(torch.from_numpy(g) if needed else None for g, needed in zip(gradients.values(), ctx.needs_input_grad[1:]))


class Decode(torch.autograd.Function):
    """Blended features [h, w, C >= 9], their weight [h, w] and the decoder's matrices -> premultiplied colour [h, w, 3]."""

    @staticmethod
    def forward(ctx, view: View, features, weight, w1, w2):
        ctx.view = view
        ctx.save_for_backward(features, weight, w1, w2)
        return torch.from_numpy(cpu.decode_features(features.numpy(), weight.numpy(), view.part, view.camera))

    @staticmethod
    def backward(ctx, grad):
        features, weight, _, _ = (tensor.detach().numpy() for tensor in ctx.saved_tensors)
        gradients = cpu.decode_backward(features, weight, ctx.view.part, ctx.view.camera, grad.numpy())
        return None, *(torch.from_numpy(g) for g in gradients)


def render(parameters: dict[str, torch.Tensor], template: GaussianModel, camera: Camera, t: float, depth: bool = False,
           statistics: Statistics | None = None, detach_time: bool = False, band: float = 0.0) -> Rendered:
    """What rendering.render() gives for the same model, pixel for pixel, and differentiable.

    parameters   float32 tensors on the CPU: all of GaussianModel.arrays, and w1, w2 of a decoder.  Their memory is read in place
                 and must not change before the backward pass
    template     a model of the same kinds; its arrays are ignored
    statistics   filled by the backward pass
    detach_time  mu_tau's gradient comes through the temporal opacity alone, as STG trains
    band         alpha fades in over this width above the cut: for checks of the gradients
    """
    announce()
    model = with_arrays(template, {name: tensor.detach().numpy() for name, tensor in parameters.items()})
    part = Instance(model, np.eye(4), float(t)).viewed(camera)
    view = View(part, camera, Layout([part], depth), statistics, detach_time, float(band))
    channels, alpha, deep = Splat.apply(view, *(parameters[name] for name in model.arrays))
    if isinstance(model.appearance, Features):
        rgb = Decode.apply(view, channels, alpha, *(parameters[name] for name in DECODER))
    else:
        rgb = channels if channels.shape[2] == 3 else channels[..., :3]
    return Rendered(rgb, alpha, deep if depth else None, view.cloud.source[view.cloud.index])
