# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes cameras that see what a 3D view shows."""
from typing import NamedTuple

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import framing
from .placing import new_camera
from .subjects import USUAL_LENS, USUAL_SENSOR

MARGIN = 1.05
"""How much farther away than the scene's nearest corner the camera of an orthographic view stands at least."""


class Shown(NamedTuple):
    """What a 3D view shows: where it looks from, half its width and height [2] at the distance 1, the distance of what it turns around."""

    eye: Matrix
    half: np.ndarray
    distance: float
    orthographic: bool = False
    near: float = 0.01
    far: float = 1000.0


def take_shape(render, area) -> None:
    """Give the scene's picture the shape of an area's view.  Its longer side keeps its number of pixels; both are even, as films want."""
    half = framing.half_sides(area)
    longest = max(render.resolution_x, render.resolution_y)
    render.resolution_x, render.resolution_y = (max(2 * round(side * longest / max(half) / 2), 4) for side in half)
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def camera_from_view(context, area, view) -> bpy.types.Object:
    """A new camera that sees all that a view shows; where the picture's shape is another, it sees more at two sides.

    view  the RegionView3D of the area.  One that looks through a camera gets a copy of it, without its animation.
    The camera becomes the scene's.
    """
    space = area.spaces.active
    through = (space.camera if space.use_local_camera else context.scene.camera) if view.view_perspective == 'CAMERA' else None
    if through is not None and through.type == 'CAMERA':
        data = through.data.copy()
        data.animation_data_clear()
        camera = new_camera("Camera", context.collection, data=data)
        camera.matrix_world = through.matrix_world.copy()
    else:
        camera = new_camera("Camera", context.collection)
        _see(context, camera, _shown(area, view))
    context.scene.camera = camera
    if space.use_local_camera:
        space.camera = camera
    return camera


def stand_in_view(context, splats: list[bpy.types.Object], camera: bpy.types.Object | None = None) -> bpy.types.Object:
    """Let a camera, None: a new one, see what the window's largest 3D view shows, and objects from near and far; it becomes the scene's.

    A view through a camera, and a window without views, show objects as an import would.  Returns the camera.
    """
    scene = context.scene
    area, view = max(framing.views(context), key=lambda each: each[0].width * each[0].height, default=(None, None))
    if area is None:
        sides = np.array([scene.render.resolution_x, scene.render.resolution_y], np.float64)
        shown = Shown(Matrix(), framing.SENSOR / 2 / USUAL_LENS * sides / sides.max(), 1.0)
    else:
        shown = _shown(area, view)
    if area is None or view.view_perspective == 'CAMERA':
        look = framing.look_at(splats, min(shown.half))[0]
        shown = shown._replace(eye=look.eye, distance=look.distance, orthographic=False)
    if camera is None:
        camera = new_camera("Camera", scene.collection)
    _see(context, camera, shown._replace(near=min(shown.near, shown.distance / 100), far=max(shown.far, 100 * shown.distance)))
    scene.camera = camera
    return camera


def _shown(area, view) -> Shown:
    space = area.spaces.active
    return Shown(framing.eye_of(space, view), framing.half_sides(area), view.view_distance, view.view_perspective == 'ORTHO',
                 space.clip_start, space.clip_end)


def _see(context, camera: bpy.types.Object, shown: Shown) -> None:
    """Let a camera see all that a view shows."""
    data, matrix, half = camera.data, shown.eye, _longer_half(context.scene.render, shown.half)
    data.sensor_fit, data.shift_x, data.shift_y = 'AUTO', 0.0, 0.0
    data.sensor_width = max(USUAL_SENSOR, 2 * half)  # Blender's shortest lens is 1 mm
    data.lens = data.sensor_width / 2 / half
    data.clip_start, data.clip_end = shown.near, shown.far
    data.type = 'ORTHO' if shown.orthographic else 'PERSP'
    if shown.orthographic:
        data.ortho_scale = 2 * shown.distance * half
        matrix = matrix @ Matrix.Translation((0, 0, _back(context.view_layer, matrix)))
    camera.matrix_world = matrix


def _longer_half(render, half: np.ndarray) -> float:
    """Half of the longer side of a picture of the scene's shape that holds a rectangle of these half sides."""
    sides = np.array([render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y])
    return float((half * sides.max() / sides).max())


def _back(layer, matrix: Matrix) -> float:
    """How far back a camera must go so that nothing lies behind it: orthographic views show that too."""
    into = matrix.inverted()
    corners = [(into @ obj.matrix_world @ Vector(corner)).z for obj in layer.objects if obj.visible_get() and obj.type != 'CAMERA'
               for corner in obj.bound_box]
    return MARGIN * max([0.0, *corners])
