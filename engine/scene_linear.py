# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders instances, of one colour space or of two, to one scene-linear picture: final frames and the CPU's viewport use it."""
from dataclasses import replace

import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.rendering.exposure import Exposure
from ..fastgs_blender.rendering.instances import Instance
from ..fastgs_blender.rendering.passes import DEFAULTS, PASSES, PassSettings
from ..fastgs_blender.util.backends import load_backend
from ..scene import colour


def render(instances: list[Instance], camera: fg.Camera, working: np.ndarray, passes=(),
           progress=lambda fraction: None, settings: PassSettings = DEFAULTS,
           exposure: Exposure | None = None, holdout: np.ndarray | None = None, backend: str = "auto") -> dict[str, np.ndarray]:
    """fastgs_blender.render() with "rgb" as premultiplied scene-linear light.

    working   [3, 3] from linear Rec.709 to the primaries of the picture, see colour.rec709_to_working()
    passes    of the library's table; "rgb" and "alpha" are always there, and so is "holdout" with a holdout
    progress  called with 0..1; what it raises cancels the render
    settings, exposure, holdout, backend  as the library takes them; the film is transparent, for Blender puts something behind
    Returns float32 arrays of the camera's window, the top row first.  Raises FastGSError as the library does.
    """
    passes = tuple(dict.fromkeys(("rgb", "alpha", *([] if holdout is None else ["holdout"]), *passes)))
    options = {"settings": replace(settings, film="transparent"), "exposure": exposure, "holdout": holdout, "backend": backend}
    colours = [name for name in passes if PASSES[name].colour]
    spaces = {instance.model.colour_space for instance in instances}
    if len(spaces) < 2:
        images = fg.render(instances, camera, passes=passes, progress=progress, **options)
        return images | {name: colour.scene_linear(images[name], images["alpha"], spaces != {"linear"}, working) for name in colours}
    if settings.light is not None:
        instances = settings.light.lit(instances, camera, load_backend(backend))
        options["settings"] = replace(options["settings"], light=None)
    # Splats add up: rgb = sum of weight x colour.  So each space's share of the picture, and of the weight, is rendered
    # with the other's splats in black, and is decoded by itself.
    encoded = fg.render(_painted(instances, "linear", 0), camera, passes=colours, progress=lambda f: progress(f / 3), **options)
    weight = fg.render(_painted(_painted(instances, "srgb", 1), "linear", 0), camera, passes=("rgb",),
                       progress=lambda f: progress((1 + f) / 3), **options)["rgb"][..., 0]
    images = fg.render(_painted(instances, "srgb", 0), camera, passes=passes, progress=lambda f: progress((2 + f) / 3), **options)
    return images | {name: colour.scene_linear(encoded[name], weight, True, working)
                     + colour.scene_linear(images[name], images["alpha"], False, working) for name in colours}


def _painted(instances, space: str, value: float):
    """The same splats, those of models in one colour space all in one grey."""
    def paint(model):
        if model.colour_space != space:
            return model
        return replace(model, appearance=fg.RGB(), features=np.full((len(model), 3), value, np.float32))

    return [replace(instance, model=paint(instance.model), origin=instance.source) for instance in instances]
