# SPDX-License-Identifier: GPL-3.0-or-later
"""render(): slice, project, rasterise, decode.  The one call that everything uses."""
from __future__ import annotations

import warnings

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.sequence import Sequence, Source
from ..util.backends import load_backend
from ..util.errors import FastGSError, LossWarning
from .instances import LIMIT, Instance, ObjectSettings, ViewedInstance
from .layout import Layout
from .passes import PASSES, Blended

DECODER_LIMIT = 1e12
"""Weights of a decoder beyond which its colours may not fit into float32."""


def render(model: Source | list, camera: Camera, t: float = 0.0, passes=("rgb", "alpha"), backend: str = "auto",
           progress=None) -> dict[str, np.ndarray]:
    """Render 4D Gaussians at time t (any real number; frame f of a clip is t = f / frame_count).

    model     one source (a model or a sequence), or a list of instances, sorted and blended together: instances.Instance, or (source,
              placement [4, 4] in the world, t), which a fourth member may crop (crops.Crop boxes, or instances.ObjectSettings)
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
    kernels = load_backend(backend)
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


def _blended(backend, instances, camera, needs, progress) -> Blended:
    """The instances drawn by a backend: what the passes that were asked for are computed from."""
    layout = Layout(instances, depth="depth" in needs)
    buffers = backend.draw(instances, camera, layout, "median" in needs, progress)
    rgb = backend.numpy(backend.colour(buffers, layout, camera)) if "rgb" in needs else None
    depth, median = (None if array is None else backend.numpy(array) for array in (buffers.depth, buffers.median))
    return Blended(rgb, backend.numpy(buffers.alpha), depth, median)


def _instances(model, camera, t) -> list[ViewedInstance]:
    """What render() was given, as instances before the camera; those that cannot be computed with, or are empty, are left out."""
    alone = isinstance(model, (GaussianModel, Sequence))
    found = [_instance((model, np.eye(4), t))] if alone else [_instance(each) for each in model]
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
    source, placement, t, *rest = given
    model, t = source.moment(t)
    settings = rest[0] if rest else ObjectSettings()
    return Instance(model, placement, t, settings if isinstance(settings, ObjectSettings) else ObjectSettings(settings))
