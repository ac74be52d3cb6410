# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows captures in 3D views: from where the file's author wants, from where cameras filmed or seem to have, or framed as they are."""
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Euler, Matrix, Quaternion, Vector

from ... import fastgs_blender as fg
from ...fastgs_blender.cameras.opening import middle_camera
from ...fastgs_blender.cameras.viewpoints import camera_of, viewpoint_of
from ...fastgs_blender.model.filmed_from import filmed_from
from ...fastgs_blender.model.surroundings import Surroundings, Viewpoint
from .. import camera as cameras
from .. import objects
from . import placing, space, subjects

SENSOR = 72.0
"""Width in millimetres of a 3D view's longer side, for the focal length that it is set to."""
USUAL_TURN = Euler((1.1093, 0.0, 0.8149)).to_quaternion()
"""How Blender's startup file looks at the world."""


@dataclass(frozen=True)
class Look:
    """How a 3D view looks: the turn of its camera, the place that it turns around, and how far away that is."""

    rotation: Quaternion
    location: Vector
    distance: float

    @property
    def eye(self) -> Matrix:
        """Where its camera stands, in the world."""
        return Matrix.LocRotScale(self.location + self.rotation @ Vector((0, 0, self.distance)), self.rotation, None)


def surroundings_of(obj: bpy.types.Object) -> Surroundings:
    """What an object's file knows of its surroundings.  Raises FastGSError where it cannot be read."""
    return objects.load_model(objects.abspath(obj)).surroundings


def show(context, splats: list[bpy.types.Object]) -> int:
    """Show objects in all 3D views of the window that look through no camera; returns in how many."""
    found = 0
    for area, view in views(context):
        if view.view_perspective == 'CAMERA':
            continue
        look, known = look_at(splats, min(half_sides(area)), view.view_rotation)
        if known:
            view.view_perspective = 'PERSP'
        view.view_rotation, view.view_location, view.view_distance = look.rotation, look.location, look.distance
        found += 1
        area.tag_redraw()
    return found


def views(context) -> list[tuple[bpy.types.Area, bpy.types.RegionView3D]]:
    """The 3D views of the context's window; none without one."""
    areas = context.window.screen.areas if context.window else ()
    return [(area, area.spaces.active.region_3d) for area in areas if area.type == 'VIEW_3D']


def eye_of(space_, view) -> Matrix:
    """Where a 3D view looks from, in the world; also before it is drawn, unless it is locked to something."""
    if space_.lock_object or space_.lock_cursor:
        return view.view_matrix.inverted()
    return Look(view.view_rotation, view.view_location, view.view_distance).eye


def eyes(context) -> list[Vector]:
    """From where the window's 3D views look."""
    camera = context.scene.camera
    return [camera.matrix_world.translation.copy() if view.view_perspective == 'CAMERA' and camera
            else eye_of(area.spaces.active, view).translation for area, view in views(context)]


def look_at(splats: list[bpy.types.Object], half: float, turn: Quaternion = USUAL_TURN) -> tuple[Look, bool]:
    """How objects are looked at, and whether a file says so, which then means a perspective view.

    half  tangent of half the angle that the view's shorter side shows; turn: the view's rotation, which stays where nothing is known
    """
    middle, radius = subjects.middle_and_radius(splats)
    fit = radius / np.sin(np.arctan(half))
    known = _known(splats[0]) if len(splats) == 1 else None
    if known is None:
        return (_estimated(splats[0], fit) if len(splats) == 1 else None) or Look(turn.copy(), middle, fit), False
    camera, distance, wanted = known
    pose = Matrix(cameras.pose_of(camera).tolist())
    forward = pose.to_3x3() @ Vector((0, 0, -1))
    if not distance:
        distance = max((middle - pose.translation).dot(forward), radius)
    near = distance if wanted else min(distance, fit)
    return Look(pose.to_quaternion(), pose.translation + distance * forward, near), True


def _known(splat) -> tuple[fg.Camera, float, bool]:
    """The viewpoint that a file knows: (camera in the world, distance of its subject, whether the file's author chose it); None where it
    knows none."""
    around = surroundings_of(splat)
    if around.view is None and not around.cameras:
        return None
    world = space.world_matrix(splat, "")
    viewpoint = around.view or around.cameras[middle_camera(around.cameras, world[2][:3])]
    try:
        camera = space.out_of(camera_of(viewpoint), world)
    except fg.FastGSError:  # it is stretched
        return None
    return camera, viewpoint.distance * world.median_scale, around.view is not None


def _estimated(splat, fit: float) -> Look | None:
    """The look of somebody who stands where the Gaussians' shapes say that cameras stood, or nearer so that a subject seen whole from `fit`
    away is large; None where they say nothing."""
    world = space.world_matrix(splat, "")
    model, t = objects.source_of(splat).moment(0.5)
    found = filmed_from(model, t, np.array(world[2][:3]) / max(Vector(world[2][:3]).length, 1e-30))
    if found is None:
        return None
    eye, middle = (world @ Vector(place) for place in found)
    return Look((middle - eye).to_track_quat('-Z', 'Y'), middle, min((middle - eye).length, fit))


def half_sides(area) -> np.ndarray:
    """Half the width and half the height [2] of what a 3D view shows at the distance 1; of one that looks through a camera, too much."""
    region = next(region for region in area.regions if region.type == 'WINDOW')
    sides = np.maximum([region.width, region.height], 1)
    return SENSOR / 2 / area.spaces.active.lens * sides / max(sides)


def look_through(context, splat: bpy.types.Object, index: int | None = None) -> bpy.types.Object:
    """Make a camera where a camera of the capture stood, the scene's camera, and let all 3D views of the window look through it.

    index  of the file's cameras; None: the one in their middle
    Raises FastGSError where the file knows no cameras, or its object is stretched.
    """
    viewpoints = surroundings_of(splat).cameras
    if not viewpoints:
        raise fg.FastGSError(f"{objects.abspath(splat)}: the file does not say where cameras of its capture stood; import the capture's "
                             "cameras, or store them in the file with fastgs annotate.")
    world = space.world_matrix(splat, "")
    viewpoint = viewpoints[middle_camera(viewpoints, world[2][:3]) if index is None else min(index, len(viewpoints) - 1)]
    camera = space.out_of(camera_of(viewpoint), world)
    obj = placing.new_camera(viewpoint.name or "Capture Camera", *splat.users_collection)
    placing.set_optics(obj.data, camera)
    placing.set_pose(obj, camera)
    obj.data.fastgs.view = viewpoint.name or "camera"
    context.scene.camera = obj
    for area, view in views(context):
        view.view_perspective = 'CAMERA'
        area.tag_redraw()
    return obj


def viewpoint_of_view(context, splat: bpy.types.Object) -> Viewpoint:
    """How a 3D view looks at a splat object now, as its file can keep it.  Raises FastGSError where the object is stretched."""
    area, view = context.area, context.space_data.region_3d
    region = next(region for region in area.regions if region.type == 'WINDOW')
    pixels = context.space_data.lens / SENSOR * max(region.width, region.height)
    pose, distance = eye_of(context.space_data, view), view.view_distance
    if view.view_perspective == 'CAMERA':
        pose, distance = view.view_matrix.inverted(), 0.0
    camera = fg.Camera(region.width, region.height, pixels, pixels, region.width / 2, region.height / 2,
                       np.linalg.inv(np.array(pose, np.float64) @ cameras.OPENCV))
    world = space.world_matrix(splat, "")
    return viewpoint_of(space.into(camera, world), "", distance / max(world.median_scale, 1e-30))
