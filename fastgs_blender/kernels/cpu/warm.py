# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the kernels that pictures usually need, before the first picture: python -m fastgs_blender.kernels.cpu.warm.

Its works are what aside.py's processes do, too.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import RGB, Appearance, Features
from ...model.gaussians import GaussianModel
from ...rendering.api import render
from ...rendering.instances import Instance, ObjectSettings
from ...rendering.lamps import Lamp
from ...rendering.passes import PassSettings
from ...rendering.relight import SceneLight
from ...rendering.shadow import Light
from ...rendering.visibility import order
from .. import made
from . import aside, cache
from .backend import BACKEND
from .light import light

PASSES = (("rgb", "alpha"), ("rgb", "alpha", "depth"), ("rgb", "alpha", "median_depth"))


def _camera() -> Camera:
    return Camera(16, 16, 16, 16, 8, 8, np.eye(4))


def _specks(look: Appearance) -> GaussianModel:
    return GaussianModel(position=np.diag([0.1, 0.2, 2.0]) + [0, 0, 1], rotation=np.eye(4)[:3], scale=np.full((3, 3), -2),
                         opacity=np.ones(3), features=np.ones((3, look.width)), appearance=look)


def compile_all(progress: Callable[[float], None] = lambda fraction: None) -> None:
    """Render a few specks with every kind of colour and every common set of passes; at the end the cache counts as filled.

    What a first picture needs comes first, so that nobody waits for the rest.
    """
    camera, models = _camera(), [_specks(look) for look in (RGB(), Features())]
    jobs: list[dict[str, Any]] = [{"model": model, "passes": passes} for passes in PASSES for model in models]
    jobs.append({"model": models[0], "settings": PassSettings(sorting="pixel")})
    instance = Instance(models[0], np.eye(4), 0.0).viewed(camera)
    for i, job in enumerate(jobs):
        render(camera=camera, backend="cpu", **job)
        if i == 0:
            order([instance], camera)
            cache.mark(cache.FIRST)
        progress((i + 1) / len(jobs))
    render(models[0], camera, backend="cpu", holdout=np.eye(3)[None])
    above = np.array([[[0.1, -9, 0.5], [0.1, 9, 0.5], [9, 0, 0.5]]], np.float32)
    sun = SceneLight((Lamp(Light.sun((0, 0, -1)), np.ones(3)),), above)
    look = ObjectSettings(lamp_light=1.0, shadows=1.0)
    for model in models:
        render([Instance(model, np.eye(4), 0.0, look)], camera, backend="cpu", settings=PassSettings(light=sun))
    light([instance], camera).over(np.ones((16, 16, 1), np.float32))
    cache.mark(cache.COMPLETE)


def _picture(look: Appearance) -> None:
    """Aside: a picture of colours, or of features, whose rasteriser is another."""
    aside.end_with_parent()
    render(_specks(look), _camera(), backend="cpu")


def _step() -> None:
    """Aside: a step of training with the usual decoder."""
    aside.end_with_parent()
    made.steps(BACKEND, made.made_model(made.made_decoder(), 3, 0.0), _camera())(1)


WORK = {"all": compile_all, "picture": lambda: _picture(RGB()), "features": lambda: _picture(Features()), "step": _step}
"""What a process may be started for, see aside.command()."""


if __name__ == "__main__":
    compile_all()
