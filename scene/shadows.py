# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the lamps whose light splats take from the scene's meshes, and these, for the passes of shadows."""
import numpy as np

from ..fastgs_blender.rendering.passes import LAMPS, SHADOWS
from ..fastgs_blender.rendering.shadow import Light, Shadow
from ..fastgs_blender.util.errors import FastGSError
from . import holdout

PASSES = [entry.blender for entry in SHADOWS]
"""Blender's names of the passes, in the order of the lamps."""
KINDS = ('SUN', 'SPOT', 'AREA')
"""Types of lights that cast the shadows of splats."""


def is_lamp(obj) -> bool:
    """Whether splats can take the light of an object."""
    return obj.type == 'LIGHT' and obj.data.type in KINDS


def lamps(scene) -> list:
    """The lamps of a scene, evaluated or not, whose light splats take from meshes, in the order of their passes."""
    return chosen(scene)[:LAMPS]


def chosen(scene) -> list:
    """The lamps that are to have a splat shadow, of which the first LAMPS get one."""
    return sorted((obj for obj in scene.objects if is_lamp(obj) and obj.fastgs.splat_shadow), key=lambda obj: obj.name_full)


def shadows_of(depsgraph) -> tuple[Shadow, ...]:
    """The shadows that the scene asks for, as the depsgraph has evaluated it; none without meshes.

    Raises FastGSError where the transform of a lamp holds no numbers.
    """
    scene = depsgraph.scene
    found = lamps(scene)
    meshes = holdout.triangles(depsgraph) if found else None
    if meshes is None:
        return ()
    size = scene.render.resolution_percentage / 100 * max(scene.render.resolution_x, scene.render.resolution_y)
    return tuple(Shadow(_placed(lamp.evaluated_get(depsgraph), scene.fastgs.shadow_samples), meshes, scene.fastgs.shadow_bias,
                        int(np.clip(size, 256, 2048)), lamp.name_full) for lamp in found)


def _placed(obj, samples: int) -> Light:
    """The library's light for an evaluated lamp where it stands."""
    matrix = np.array(obj.matrix_world, np.float64)
    if not np.isfinite(matrix).all():
        raise FastGSError(f'the light "{obj.name}" has a transform that holds no finite numbers; clear its location and rotation, or those '
                          "of its parents.")
    return light_of(obj.data, matrix, samples)


def area_of(data, matrix: np.ndarray) -> float:
    """The area of a lamp's surface at a place [4, 4]; of a sun, the solid angle of its disc."""
    if data.type == 'SUN':
        return np.pi * np.sin(min(data.angle, np.pi) / 2) ** 2
    if data.type != 'AREA':
        return 4 * np.pi * data.shadow_soft_size**2
    height = data.size_y if data.shape in ('RECTANGLE', 'ELLIPSE') else data.size
    round_ = np.pi / 4 if data.shape in ('DISK', 'ELLIPSE') else 1.0
    return data.size * height * round_ * np.linalg.norm(np.cross(matrix[:3, 0], matrix[:3, 1]))


def light_of(data, matrix: np.ndarray, samples: int) -> Light:
    """The library's light for a lamp's data at a place [4, 4]: its place, direction and size, as Cycles reads them."""
    x, y, z = (matrix[:3, i] for i in range(3))
    if data.type == 'SUN':
        return Light.sun(z / max(np.linalg.norm(z), 1e-30), data.angle, samples)
    if data.type == 'AREA':
        height = data.size_y if data.shape in ('RECTANGLE', 'ELLIPSE') else data.size
        shape = Light.disc if data.shape in ('DISK', 'ELLIPSE') else Light.rectangle
        return shape(matrix[:3, 3], x * data.size / 2, y * height / 2, samples)
    radius = data.shadow_soft_size
    if data.type == 'POINT':
        return Light.ball(matrix[:3, 3], radius, samples if radius > 0 else 1)
    x, y = (radius * axis / max(np.linalg.norm(axis), 1e-30) for axis in (x, y))
    return Light.disc(matrix[:3, 3], x, y, samples if radius > 0 else 1)
