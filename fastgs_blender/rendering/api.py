# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
from __future__ import annotations

import importlib
import logging
import warnings
from functools import cache, reduce

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError, LossWarning
from .instances import LIMIT, Instance, ObjectSettings, ViewedInstance
from .layout import Layout
from .passes import PASSES, Blended

BACKENDS = {"cpu": "..kernels.cpu.backend", "reference": ".oracle"}
"""Module of each backend: draw(instances, camera, layout, median, progress) and decode_features(...)."""


DECODER_LIMIT = 1e12
"""Weights of a decoder beyond which its colours may not fit into float32."""


def render(model: GaussianModel | list, camera: Camera, t: float = 0.0, passes=("rgb", "alpha"), backend: str = "auto",
           progress=None) -> dict[str, np.ndarray]:
    """Render 4D Gaussians at time t (any real number; frame f of a clip is t = f / frame_count).

    model     one model, or a list of instances, sorted and blended together: instances.Instance, or (model, placement [4, 4] in the
              world, t), which a fourth member may crop (crops.Crop boxes, or instances.ObjectSettings)
    passes    rgb           [h, w, 3]  premultiplied, in the model's own colour space
              alpha         [h, w]
              depth         [h, w]  expected depth along the view axis, inf where alpha is 0
              median_depth  [h, w]  depth where transmittance falls to a half (the last splat's where it does not), else inf
    backend   "cpu" (numba), "reference" (NumPy, slow), "auto"
    progress  called with 0..1 between pieces of work; what it raises cancels the render and passes through

    Returns float32 arrays, the top row first, of the camera's window.  Same inputs, same bytes, for any number of threads.
    """
    unknown = [p for p in passes if p not in PASSES]
    if unknown:
        raise FastGSError(f"the pass {unknown[0]!r} is unknown; there are {', '.join(PASSES)}.")
    entries = [PASSES[name] for name in passes]
    needs = {part for entry in entries for part in entry.needs}
    kernels = _backend(backend)
    progress = progress or (lambda fraction: None)
    instances = _instances(model, camera, t)
    blended = _blended(kernels, instances, camera, needs, progress) if instances else None
    out = {}
    for entry in entries:
        if blended is None:
            size = camera.window[3], camera.window[2]
            image = np.full(size if entry.channels == 1 else (*size, entry.channels), entry.empty)
        else:
            image = entry.image(blended)
        out[entry.name] = np.ascontiguousarray(image, np.float32)
    progress(1.0)
    return out


def _blended(kernels, instances, camera, needs, progress) -> Blended:
    """The instances drawn by a backend: what the passes that were asked for are computed from."""
    layout = Layout(instances, depth="depth" in needs)
    buffers = kernels.draw(instances, camera, layout, "median" in needs, progress)
    rgb = reduce(np.add, (_colour(group, buffers, camera, kernels) for group in layout.groups)) if "rgb" in needs else None
    depth = None if layout.depth is None else buffers.channels[..., layout.depth]
    return Blended(rgb, buffers.alpha, depth, buffers.median)


def _colour(group, buffers, camera, kernels):
    """The premultiplied colour [h, w, 3] of a group of channels."""
    if group.instance is None:
        return buffers.channels[..., group.offset:group.offset + 3]
    weight = buffers.alpha if group.weight is None else buffers.channels[..., group.weight]
    return kernels.decode_features(buffers.channels[..., group.offset:group.offset + 9], weight, group.instance, camera)


def _instances(model, camera, t) -> list[ViewedInstance]:
    """What render() was given, as instances before the camera; those that cannot be computed with, or are empty, are left out."""
    found = [Instance(model, np.eye(4), t)] if isinstance(model, GaussianModel) else [_instance(each) for each in model]
    viewed = [instance.viewed(camera) for instance in found if len(instance.model)]
    for instance in viewed:
        if not instance.in_range:
            warnings.warn(LossWarning(f"a model is not drawn: its placement before the camera has numbers beyond {LIMIT:g}."), stacklevel=3)
        look = instance.model.appearance
        if isinstance(look, Features) and max(np.abs(look.w1).max(), np.abs(look.w2).max()) > DECODER_LIMIT:
            text = f"a model's decoder has weights beyond {DECODER_LIMIT:g}: colours that float32 cannot hold are black."
            warnings.warn(LossWarning(text), stacklevel=3)
    return [instance for instance in viewed if instance.in_range]


def _instance(given) -> Instance:
    """The Instance of (model, placement [4, 4], t), perhaps with boxes or ObjectSettings as a fourth member."""
    if isinstance(given, Instance):
        return given
    model, placement, t, *rest = given
    settings = rest[0] if rest else ObjectSettings()
    return Instance(model, placement, t, settings if isinstance(settings, ObjectSettings) else ObjectSettings(settings))


@cache
def _backend(name: str):
    if name == "auto":
        try:
            return _backend("cpu")
        except ImportError:
            logging.getLogger(__package__).warning("numba is not installed: rendering with NumPy, which is slow.")
            return _backend("reference")
    if name not in BACKENDS:
        raise FastGSError(f"the backend {name!r} is unknown; there are auto, {', '.join(BACKENDS)}.")
    return importlib.import_module(BACKENDS[name], __package__)
