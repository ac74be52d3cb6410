# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
from __future__ import annotations

import importlib
import logging
from functools import cache, reduce

import numpy as np

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from .scene import Layout, Part, Placed

PASSES = {"rgb": 3, "alpha": 1, "depth": 1, "median_depth": 1}
"""The passes and their channels."""

BACKENDS = {"cpu": "..kernels.cpu.backend", "reference": ".oracle"}
"""Module of each backend: draw(parts, camera, layout, median, progress) and decode_features(...)."""


def render(model: GaussianModel | list, camera: Camera, t: float = 0.0, passes=("rgb", "alpha"), backend: str = "auto",
           progress=None) -> dict[str, np.ndarray]:
    """Render 4D Gaussians at time t (any real number; frame f of a clip is t = f / frame_count).

    model     one model, or a list of (model, 4 x 4 placement in the world, t), sorted and blended as one cloud; a fourth member
              may hold boxes that crop it (crops.py)
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
    parts = [part for part in _parts(model, camera, t) if len(part.model)]
    layout = Layout(parts, depth="depth" in passes)
    _, _, width, height = camera.window
    if parts:
        buffers = module.draw(parts, camera, layout, "median_depth" in passes, progress)
        alpha = buffers.alpha
    else:
        alpha = np.zeros((height, width), np.float32)
    out = {}
    for name in passes:
        if not parts:
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
    if group.part is None:
        return buffers.channels[..., group.offset:group.offset + 3]
    weight = buffers.alpha if group.weight is None else buffers.channels[..., group.weight]
    return module.decode_features(buffers.channels[..., group.offset:group.offset + 9], weight, group.part, camera)


def _parts(model, camera, t) -> list[Part]:
    if isinstance(model, GaussianModel):
        model = [(model, np.eye(4), t)]
    parts = []
    for item, placement, time, crops in (Placed(*each) for each in model):
        placement = np.array(placement, np.float64)
        if placement.shape != (4, 4) or not np.isfinite(placement).all():
            raise FastGSError("a model's placement must be a 4 x 4 matrix of finite numbers.")
        if not np.isfinite(time):
            raise FastGSError(f"the time of a model must be a finite number, not {time!r}.")
        parts.append(Part(item, placement, float(time), camera.world_to_camera, tuple(crops)))
    return parts


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
