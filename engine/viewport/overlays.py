# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds which overlays Blender draws over a viewport's picture: grid, axes, bones, wires."""
import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d

CURSOR, ORIGIN = 24, 6
"""Radii of the 3D cursor and of an object's origin, in points."""
SWITCHES = ("show_overlays", "show_bones", "show_extras", "show_wireframes", "show_relationship_lines", "show_motion_paths", "show_floor")


def drawn(context) -> bool:
    """Whether a viewport shows overlays at all."""
    return context.space_data.overlay.show_overlays


def state(context) -> tuple:
    """The settings of a viewport that decide which overlays and surfaces it draws, as values that can be compared."""
    space, region = context.space_data, context.region_data
    shading = space.shading
    return (*(getattr(space.overlay, name) for name in SWITCHES), shading.type, shading.show_backface_culling, region.use_clip_planes,
            space.local_view is not None, space.use_local_collections, space.show_object_viewport_mesh,
            bpy.app.is_job_running('SHADER_COMPILATION'))


def floor(context) -> bool:
    """Whether the floor's grid or axes are drawn; straight views from a side have their grid behind everything."""
    overlay, view = context.space_data.overlay, context.region_data
    if view.view_perspective == 'ORTHO' and view.is_orthographic_side_view:
        return False
    return overlay.show_floor or overlay.show_axis_x or overlay.show_axis_y


def in_front(context, depsgraph) -> bool:
    """Whether bones or wires are drawn in front of everything; the window's depth does not hold them then."""
    overlay = context.space_data.overlay
    posing = context.mode == 'POSE' and overlay.show_xray_bone
    return posing or any(obj.show_in_front for obj in depsgraph.objects)


def marks(context) -> list[tuple[float, float, float]]:
    """The marks that Blender draws over everything: (x, y, radius) in the region's pixels."""
    overlay, scale = context.space_data.overlay, context.preferences.system.ui_scale
    wanted = []
    if overlay.show_cursor:
        wanted.append((context.scene.cursor.location, CURSOR))
    active = context.active_object
    if overlay.show_object_origins and active is not None:
        wanted.append((active.matrix_world.translation, ORIGIN))
    places = [(location_3d_to_region_2d(context.region, context.region_data, point), radius) for point, radius in wanted]
    return [(place.x, place.y, radius * scale) for place, radius in places if place is not None]
