# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the lamp whose light splats take from the scene's meshes, and these, for the pass of shadows."""
from __future__ import annotations

import numpy as np

from ..fastgs_blender.rendering.shadow import Light, Shadow
from ..fastgs_blender.util.errors import FastGSError
from . import holdout

LAMPS = ('SUN', 'SPOT', 'AREA')
"""Types of lights that cast the shadows of splats."""


def is_lamp(obj) -> bool:
    """Whether an object can be chosen as the light."""
    return obj.type == 'LIGHT' and obj.data.type in LAMPS


def shadow_of(depsgraph) -> Shadow | None:
    """The shadow that the scene asks for, as the depsgraph has evaluated it; None without a light or without meshes.

    Raises FastGSError where the chosen light is not one of LAMPS, or where its transform holds no numbers.
    """
    settings = depsgraph.scene.fastgs
    if settings.shadow_light is None:
        return None
    meshes = holdout.triangles(depsgraph)
    if meshes is None:
        return None
    render, lamp = depsgraph.scene.render, settings.shadow_light.evaluated_get(depsgraph)
    size = render.resolution_percentage / 100 * max(render.resolution_x, render.resolution_y)
    return Shadow(light_of(lamp, settings.shadow_samples), meshes, settings.shadow_bias, int(np.clip(size, 256, 2048)))


def light_of(obj, samples: int) -> Light:
    """The library's light for an evaluated lamp: its place, direction and size, as Cycles reads them."""
    if not is_lamp(obj):
        raise FastGSError(f'"{obj.name}" casts no shadows of splats; choose a sun, a spot or an area light under Splat Shadows.')
    matrix, data = np.array(obj.matrix_world, np.float64), obj.data
    if not np.isfinite(matrix).all():
        raise FastGSError(f'the light "{obj.name}" has a transform that holds no finite numbers; clear its location and rotation, or those '
                          "of its parents.")
    x, y, z = (matrix[:3, i] for i in range(3))
    if data.type == 'SUN':
        return Light.sun(z / max(np.linalg.norm(z), 1e-30), data.angle, samples)
    if data.type == 'SPOT':
        radius = data.shadow_soft_size
        x, y = (radius * axis / max(np.linalg.norm(axis), 1e-30) for axis in (x, y))
        return Light.disc(matrix[:3, 3], x, y, samples if radius > 0 else 1)
    height = data.size_y if data.shape in ('RECTANGLE', 'ELLIPSE') else data.size
    shape = Light.disc if data.shape in ('DISK', 'ELLIPSE') else Light.rectangle
    return shape(matrix[:3, 3], x * data.size / 2, y * height / 2, samples)
