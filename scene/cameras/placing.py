# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives Blender's cameras the lens, the pose and the animation of the library's cameras."""
import bpy
import numpy as np
from mathutils import Quaternion

from ... import fastgs_blender as fg
from ...fastgs_blender.util.rotations import from_matrices, one_sign
from .. import camera as cameras
from . import keys as camera_keys


def new_camera(name: str, *collections: bpy.types.Collection, data: bpy.types.Camera | None = None) -> bpy.types.Object:
    """A new camera in collections."""
    camera = bpy.data.objects.new(name, data or bpy.data.cameras.new(name))
    for collection in collections:
        collection.objects.link(camera)
    return camera


def set_optics(data: bpy.types.Camera, camera: fg.Camera) -> None:
    """Give a Blender camera exactly these intrinsics; it remembers the picture size and pixel aspect that they hold for."""
    optics = cameras.optics_of(camera)
    data.type, data.lens_unit, data.sensor_fit = 'PERSP', 'MILLIMETERS', 'HORIZONTAL'
    for name in ("lens", "sensor_width", "shift_x", "shift_y"):
        setattr(data, name, getattr(optics, name))
    remembered = data.fastgs
    remembered.width, remembered.height = camera.width, camera.height
    remembered.pixel_aspect_x, remembered.pixel_aspect_y = optics.pixel_aspect_x, optics.pixel_aspect_y


def set_pose(obj: bpy.types.Object, camera: fg.Camera) -> None:
    """Stand where the library camera stands, within the parent."""
    pose = cameras.pose_of(camera)
    obj.rotation_mode = 'QUATERNION'
    obj.location = pose[:3, 3]
    obj.rotation_quaternion = Quaternion(from_matrices(pose[:3, :3]))


def animate(obj: bpy.types.Object, shots: list[fg.Camera], frames: np.ndarray) -> None:
    """Key poses, and whatever of the intrinsics changes, on these frames; between them the curves are smooth."""
    poses = np.array([cameras.pose_of(camera) for camera in shots])
    optics = [cameras.optics_of(camera) for camera in shots]
    obj.rotation_mode = 'QUATERNION'
    turns = one_sign(from_matrices(poses[:, :3, :3]))
    tracks = [(obj, "location", poses[:, :3, 3]), (obj, "rotation_quaternion", turns)]
    tracks += [(obj.data, name, np.array([getattr(o, name) for o in optics])[:, None]) for name in ("lens", "shift_x", "shift_y")]
    for owner, name, values in tracks:
        if len(frames) > 1 and (owner is obj or np.ptp(values) > 1e-7 * max(abs(values).max(), 1e-3)):
            camera_keys.write(owner, name, frames, values, np.gradient(values, frames, axis=0))


def use_render_size(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Look through a capture's camera at its own picture size."""
    own, render = obj.data.fastgs, scene.render
    scene.camera = obj
    render.resolution_x, render.resolution_y, render.resolution_percentage = own.width, own.height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = own.pixel_aspect_x, own.pixel_aspect_y
