# SPDX-License-Identifier: GPL-3.0-or-later
"""A training step on the CPU: the picture of one view, its loss, and the backward pass to the model's parameters."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...rendering.instances import AS_TRAINED, Instance, ViewedInstance
from ...rendering.layout import Layout
from ...util.threads import run
from .. import asserts
from ..parameters import DECODER, model_of
from ..protocol import Comparison, ForwardPass
from .decoder import decode_backward, decode_features
from .loss import errors, photometric
from .project_backward import observe
from .rasterise import RasterGradients, RasterState, rasterise_backward, rasterise_forward
from .splats import ProjectedSplats, project_backward, project_instances

LEAST_MEAN = 1e-6
"""Mean difference of a picture below which its pixels' errors are taken over this, so that a perfect one has none."""


@dataclass(frozen=True, eq=False)
class View:
    """What forward() stores for backward(): the instance, its layout, its splats, the blended channels [h, w, C], and the rasteriser's
    state."""

    instance: ViewedInstance
    layout: Layout
    splats: ProjectedSplats
    channels: np.ndarray
    raster: RasterState


def forward(parameters: dict[str, np.ndarray], template: GaussianModel, camera: Camera, t: float, depth: bool = False,
          band: float = 0.0) -> ForwardPass:
    """TrainingBackend.forward()."""
    asserts.forward(parameters, template)
    instance = Instance(model_of(template, parameters), np.eye(4), t, AS_TRAINED).viewed(camera)
    layout = Layout([instance], depth, opaque=True)
    splats = project_instances([instance], camera, layout)
    picture, state = rasterise_forward(splats.order(), splats.geometry, splats.attributes, splats.channels, camera, band)
    channels, alpha = picture.channels, picture.alpha
    features = None
    if isinstance(instance.model.appearance, Features):
        features = channels[..., :9]
        rgb = decode_features(channels, alpha, instance, camera, layout.groups[0].decode)
    else:
        rgb = channels if channels.shape[2] == 3 else channels[..., :3]
    deep = None if layout.depth is None else channels[..., layout.depth]
    return ForwardPass(rgb, alpha, deep, View(instance, layout, splats, channels, state), features)


def compare(picture: ForwardPass, target: np.ndarray, weight: np.ndarray | None, background: np.ndarray | None, dssim: float,
            opaque_weight: float, share: float, least: np.ndarray | None = None) -> Comparison:
    """TrainingBackend.compare()."""
    asserts.compare(picture, target, weight, background, least)
    rgb, alpha, factor = _over(picture, background), picture.alpha, np.float32(share)
    if least is not None:
        target = np.where(least, np.maximum(target, rgb), target)
    loss, grad_rgb, l1, ssim = photometric(rgb, target, weight, float(dssim))
    if factor != 1:
        grad_rgb = grad_rgb * factor
    grad_alpha = None
    if opaque_weight:
        loss += opaque_weight * float((1 - alpha).mean(dtype=np.float64))
        grad_alpha = np.full(alpha.shape, -(factor * np.float32(opaque_weight) / np.float32(alpha.size)), np.float32)
    if background is not None:
        through = grad_rgb[..., 0] * background[0] + grad_rgb[..., 1] * background[1] + grad_rgb[..., 2] * background[2]
        grad_alpha = -through if grad_alpha is None else grad_alpha - through
    square, emphasis = errors(rgb, target, weight, 1 / max(l1, LEAST_MEAN))
    return Comparison(np.array([loss, l1, ssim, square]), grad_rgb, grad_alpha, emphasis)


def _over(picture: ForwardPass, background: np.ndarray | None) -> np.ndarray:
    """The picture [h, w, 3] over its background."""
    return picture.rgb if background is None else picture.rgb + (1 - picture.alpha)[..., None] * background


def over(picture: ForwardPass, background: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """TrainingBackend.over()."""
    asserts.over(picture, background)
    return _over(picture, background), picture.alpha


def agreement(picture: ForwardPass, target: np.ndarray, weight, least, background, gain, bias, sides, apart, solid, outlier) -> np.ndarray:
    """TrainingBackend.agreement()."""
    asserts.agreement(picture, target, weight, least, background, gain, bias, sides)
    rgb, clock = _over(picture, background), np.zeros(4)
    rest = target - rgb
    counts = np.where(picture.alpha > solid, np.float32(1), np.float32(0))
    if weight is not None:
        counts = counts * np.minimum(weight, 1)
    share = counts[..., None] / (1 + (rest / outlier) ** 2)
    if least is not None:
        share = np.where(least, np.float32(0), share)
    q = target * gain.astype(np.float32) + bias.astype(np.float32)
    colour = [values.sum((0, 1), dtype=np.float64) for values in (share, share * rgb, share * q, share * rgb * rgb, share * rgb * q)]
    if sides is not None:
        late, early = (_over(side, background) for side in sides)
        change = (late - early) / np.float32(apart)
        product = share * change
        clock[:] = [values.sum(dtype=np.float64) for values in (product * change, product * rest, share * rest * rest, share)]
    return np.concatenate([np.stack(colour, -1).ravel(), clock])


def backward(picture: ForwardPass, rgb, alpha=None, depth=None, *, into=None, statistics=None, emphasis=None, seen=None, detach_time=False):
    """TrainingBackend.backward()."""
    asserts.backward(picture, rgb, alpha, depth, into, statistics, emphasis, seen)
    view: View = picture.state
    camera, appearance = view.instance.camera, view.instance.model.appearance
    gradients = {}
    if isinstance(appearance, Features) and rgb is not None:
        way = view.layout.groups[0].decode
        channels, by_weight, w1, w2 = decode_backward(view.channels, picture.alpha, view.instance, camera, rgb, way)
        if by_weight is not None:
            alpha = by_weight if alpha is None else alpha + by_weight
        gradients = {"w1": w1, "w2": w2}
    elif rgb is not None and view.channels.shape[2] == 3 and depth is None:
        channels = rgb
    else:
        channels = np.zeros(view.channels.shape, np.float32)
        if rgb is not None:
            channels[..., :3] = rgb
    if isinstance(appearance, Features) and rgb is None:
        gradients = {name: np.zeros_like(getattr(appearance, name)) for name in DECODER}
    if depth is not None and view.layout.depth is not None:
        channels[..., view.layout.depth] += depth
    alpha = np.zeros(picture.alpha.shape, np.float32) if alpha is None else alpha
    splats = rasterise_backward(view.raster, channels, alpha, emphasis)
    if statistics is not None:
        add_view(statistics, view.splats, splats, camera)
    if seen is not None:
        seen[view.splats.source[view.splats.index]] = 1
    gradients = {**project_backward(view.instance, camera, view.layout, view.splats, splats, detach_time), **gradients}
    if into is None:
        return gradients
    for name, gradient in gradients.items():
        into[name] += gradient
    return into


def add_view(statistics, splats: ProjectedSplats, gradients: RasterGradients, camera: Camera) -> None:
    """Add one view of one instance to the statistics of density control (ScreenStatistics)."""
    rest = (splats.source, gradients.geometry, gradients.absolute, splats.attributes, (camera.width, camera.height),
            statistics.gradient, statistics.absolute, statistics.seen, statistics.radius)
    run(lambda first, count: observe(first, first + count, *rest), splats.runs[0])
