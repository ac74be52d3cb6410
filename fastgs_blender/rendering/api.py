# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
from __future__ import annotations

import importlib
import logging
import warnings
from functools import cache, reduce

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError, LossWarning
from .instances import LIMIT, Instance, ObjectSettings, ViewedInstance
from .layout import Layout

PASSES = {"rgb": 3, "alpha": 1, "depth": 1, "median_depth": 1}
"""The passes and their channels."""

BACKENDS = {"cpu": "..kernels.cpu.backend", "reference": ".oracle"}
"""Module of each backend: draw(instances, camera, layout, median, progress) and decode_features(...)."""


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
    module = _backend(backend)
    progress = progress or (lambda fraction: None)
    instances = _instances(model, camera, t)
    layout = Layout(instances, depth="depth" in passes)
    _, _, width, height = camera.window
    if instances:
        buffers = module.draw(instances, camera, layout, "median_depth" in passes, progress)
        alpha = buffers.alpha
    else:
        alpha = np.zeros((height, width), np.float32)
    out = {}
    for name in passes:
        if not instances:
            shape = (height, width, 3) if name == "rgb" else (height, width)
            image = np.full(shape, np.inf if "depth" in name else 0.0)
        elif name == "rgb":
            image = reduce(np.add, (_decoded(group, buffers, camera, module) for group in layout.groups))
        elif name == "alpha":
            image = alpha
        elif name == "depth":
            total = buffers.channels[..., layout.depth]
            image = np.divide(total, alpha, out=np.full(alpha.shape, np.inf, total.dtype), where=alpha > 0)
        else:
            image = buffers.median
        out[name] = np.ascontiguousarray(image, np.float32)
    progress(1.0)
    return out


def _decoded(group, buffers, camera, module):
    if group.instance is None:
        return buffers.channels[..., group.offset:group.offset + 3]
    weight = buffers.alpha if group.weight is None else buffers.channels[..., group.weight]
    return module.decode_features(buffers.channels[..., group.offset:group.offset + 9], weight, group.instance, camera)


def _instances(model, camera, t) -> list[ViewedInstance]:
    """What render() was given, as instances before the camera; those that cannot be computed with, or are empty, are left out."""
    found = [Instance(model, np.eye(4), t)] if isinstance(model, GaussianModel) else [_instance(each) for each in model]
    viewed = [instance.viewed(camera) for instance in found if len(instance.model)]
    for instance in viewed:
        if not instance.in_range:
            warnings.warn(LossWarning(f"a model is not drawn: its placement before the camera has numbers beyond {LIMIT:g}."), stacklevel=3)
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
