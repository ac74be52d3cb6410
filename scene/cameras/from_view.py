# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes cameras that see what a 3D view shows."""
from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

from .framing import half_sides

USUAL_SENSOR = 36.0
MARGIN = 1.05
"""How much farther away than the scene's nearest corner the camera of an orthographic view stands at least."""


def eye_of(space, view) -> Matrix:
    """Where a 3D view looks from, in the world; also before it is drawn, unless it is locked to something."""
    if space.lock_object or space.lock_cursor:
        return view.view_matrix.inverted()
    return Matrix.Translation(view.view_location) @ view.view_rotation.to_matrix().to_4x4() @ Matrix.Translation((0, 0, view.view_distance))


def take_shape(render, area) -> None:
    """Give the scene's picture the shape of an area's view.  Its longer side keeps its number of pixels; both are even, as films want."""
    half = half_sides(area)
    longest = max(render.resolution_x, render.resolution_y)
    render.resolution_x, render.resolution_y = (max(2 * round(side * longest / max(half) / 2), 4) for side in half)
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def camera_from_view(context, area, view) -> bpy.types.Object:
    """A new camera that sees all that a view shows; where the picture's shape is another, it sees more at two sides.

    view  the RegionView3D of the area.  One that looks through a camera gets a copy of it, without its animation.
    The camera becomes the scene's.
    """
    scene, space = context.scene, area.spaces.active
    seen = (space.camera if space.use_local_camera else scene.camera) if view.view_perspective == 'CAMERA' else None
    if seen is not None and seen.type == 'CAMERA':
        data, matrix = seen.data.copy(), seen.matrix_world.copy()
        data.animation_data_clear()
    else:
        data, matrix = bpy.data.cameras.new("Camera"), eye_of(space, view)
        longer_half = _longer_half(scene.render, half_sides(area))
        data.sensor_width = USUAL_SENSOR * max(1.0, 2 * longer_half / USUAL_SENSOR)  # Blender's shortest lens is 1 mm
        data.lens = data.sensor_width / 2 / longer_half
        data.clip_start, data.clip_end = space.clip_start, space.clip_end
        if view.view_perspective == 'ORTHO':
            data.type, data.ortho_scale = 'ORTHO', 2 * view.view_distance * longer_half
            matrix = matrix @ Matrix.Translation((0, 0, _back(context.view_layer, matrix)))
    camera = bpy.data.objects.new("Camera", data)
    context.collection.objects.link(camera)
    camera.matrix_world = matrix
    scene.camera = camera
    if space.use_local_camera:
        space.camera = camera
    return camera


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
