# SPDX-License-Identifier: GPL-3.0-or-later
"""The world that a file's cameras are placed in: that of a splat object, or their own, turned upright."""
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from ... import fastgs_blender as fg
from ...fastgs_blender.util.errors import FastGSError
from .. import model_space, objects

ITEMS = (
    ('AUTO', "Splat Object", "The world of the active splat object's model, or of the scene's only one; upright where there is none", 0),
    ('WORLD', "File's Own", "The file's own axes, turned to Blender's", 1),
)


def splat_of(context, space: str) -> bpy.types.Object | None:
    """The splat object whose world is meant."""
    if space != 'AUTO':
        return None
    active = context.object
    if active is not None and objects.is_splat(active):
        return active
    found = [obj for obj in context.scene.objects if objects.is_splat(obj)]
    return found[0] if len(found) == 1 else None


def world_matrix(splat: bpy.types.Object | None, axes: str) -> Matrix:
    """From the file's world to Blender's."""
    return Matrix(model_space.placement(splat).tolist()) if splat else objects.axes_matrix(axes)


def axes_of(splat: bpy.types.Object | None, axes: str) -> str:
    """The axes that a file written for this splat object has; `axes` are those of its format."""
    if splat is None:
        return axes
    return objects.load_model(objects.abspath(splat)).axes


def into(camera: fg.Camera, world: Matrix) -> fg.Camera:
    """A camera of Blender's world as it stands in the file's world.  Raises FastGSError where that world is stretched."""
    return _moved(camera, np.array(world, np.float64))


def out_of(camera: fg.Camera, world: Matrix) -> fg.Camera:
    """A camera of the file's world as it stands in Blender's; the inverse of into()."""
    return _moved(camera, np.linalg.inv(np.array(world, np.float64)))


def _moved(camera, matrix) -> fg.Camera:
    """A camera of the world that `matrix` [4, 4] leads to, in the world that it leads from."""
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    scale = lengths.mean()
    turn = matrix[:3, :3] / max(scale, 1e-30)
    if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-4 or np.linalg.det(turn) < 0:
        raise FastGSError("the splat object is stretched or mirrored, which cameras cannot be; give it the same scale along all axes.")
    pose = camera.world_to_camera @ matrix
    pose[:3] /= scale
    u, _, v = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ v
    return replace(camera, world_to_camera=pose, window=None)
