# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds where the picture of a camera lies in a 3D viewport that looks through it: left, bottom, right, top, 0..1."""
from .eye import WHOLE, frame_in


def picture(context, depsgraph):
    """The rectangle of the region that the final render shows: left, bottom, right, top in 0..1."""
    if context.region_data.view_perspective == 'CAMERA':
        return _camera_frame(context, depsgraph) or WHOLE
    return WHOLE


def border(context, depsgraph):
    """The part of the region to render: left, bottom, right, top, 0..1."""
    space, render = context.space_data, depsgraph.scene.render
    if context.region_data.view_perspective == 'CAMERA':
        frame_ = _camera_frame(context, depsgraph)
        if frame_ is None or not render.use_border:
            return WHOLE
        left, bottom, right, top = frame_
        return (left + render.border_min_x * (right - left), bottom + render.border_min_y * (top - bottom),
                left + render.border_max_x * (right - left), bottom + render.border_max_y * (top - bottom))
    if space.use_render_border:
        return space.render_border_min_x, space.render_border_min_y, space.render_border_max_x, space.render_border_max_y
    return WHOLE


def passepartout(context, depsgraph) -> dict:
    """How Blender darkens what lies outside the camera's picture."""
    space = context.space_data
    if context.region_data.view_perspective == 'CAMERA' and space.overlay.show_overlays:
        frame_ = _camera_frame(context, depsgraph)
        camera = space.camera if space.use_local_camera else depsgraph.scene.camera
        if frame_ is not None and camera.data.show_passepartout:
            return {"frame": frame_, "outside": 1 - camera.data.passepartout_alpha}
    return {}


def _camera_frame(context, depsgraph):
    """Where the camera's picture lies in a region that looks through it; None where that is no camera."""
    space, render = context.space_data, depsgraph.scene.render
    camera = space.camera if space.use_local_camera else depsgraph.scene.camera
    if camera is None or camera.type != 'CAMERA':
        return None
    width, height = render.resolution_x, render.resolution_y
    projection = camera.evaluated_get(depsgraph).calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y)
    return frame_in(context.region_data.window_matrix, projection)
