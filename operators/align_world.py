# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts captures upright and to size in the scene.  Objects are moved; their files stay as they are."""
import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty
from mathutils import Vector

from ..fastgs_blender.cameras import upright
from ..fastgs_blender.util.errors import FastGSError
from ..fastgs_blender.util.rotations import transformed
from ..scene import arrays, objects
from ..scene.camera import OPENCV
from ..scene.cameras.subjects import capture_cameras
from ..scene.cameras.worlds import is_world, move, points, targets
from .action import Action, Need

LOWEST = 2.0
"""Percentile of a proxy's points, by height, that is taken for the floor."""


class _Align(Action):
    """Base class of the aligning operators."""

    needs = (Need(lambda context: context.mode in {'OBJECT', 'EDIT_MESH'}, "Go to Object Mode first"),
             Need(lambda context: any(is_world(obj) for obj in context.scene.objects), "Import a capture or a model first"))

    def motion(self, context, worlds):
        """The motion [4, 4] and the marks that go with it.  Raises FastGSError."""
        raise NotImplementedError

    def act(self, context):
        worlds = targets(context)
        for obj in worlds:
            objects.check_editable(obj, "moved")
        motion, marks = self.motion(context, worlds)
        move(context, worlds, marks, motion)


class FASTGS_OT_set_ground(_Align, bpy.types.Operator):
    """Turn captures upright, with their ground on the scene's floor"""

    bl_idname = "fastgs.set_ground"
    bl_label = "Set Ground"

    source: EnumProperty(
        name="From", description="How the ground is found",
        items=(
            ('POINTS', "Three Points", "Three selected objects, or three vertices of the proxy in Edit Mode, that lie on the ground", 0),
            ('CAMERAS', "Cameras", "The capture's cameras, held level; the floor is at the lowest splats, or at the lowest camera", 1),
        ), default='POINTS')

    def motion(self, context, worlds):
        eyes = [np.array(camera.matrix_world) @ OPENCV for camera in capture_cameras(context.scene)]
        for eye in eyes:
            eye[:3, :3] /= np.maximum(np.linalg.norm(eye[:3, :3], axis=0), 1e-30)
        if self.source == 'POINTS':
            found, marks = points(context, 3)
            above = np.mean([eye[:3, 3] for eye in eyes], axis=0) if eyes else self._middle(worlds)
            return upright.ground_from_points(found, above), marks
        if not eyes:
            raise FastGSError("there are no cameras of a capture in this scene; import them first (File > Import > Capture Cameras).")
        turned = upright.ground_from_cameras(eyes)
        places = self._places(worlds)
        known = len(places) > 0
        heights = (places if known else np.array([eye[:3, 3] for eye in eyes])) @ turned[2, :3]
        turned[2, 3] = -(np.percentile(heights, LOWEST) if known else heights.min())
        if not known:
            self.warn("There are no splats that show where the floor is, so the lowest camera now stands on it; set the ground again when "
                      "the model is there, or from three points.")
        return turned, []

    def _places(self, worlds) -> np.ndarray:
        """Points [n, 3] of the splats' proxies in the world."""
        return np.concatenate([np.zeros((0, 3)), *(
            transformed(arrays.points(obj.data), np.array(obj.matrix_world)) for obj in worlds if obj.type == 'MESH')])

    def _middle(self, worlds):
        corners = [obj.matrix_world @ Vector(c) for obj in worlds if obj.type == 'MESH' for c in obj.bound_box]
        return np.mean([list(c) for c in corners], axis=0) if corners else None


class FASTGS_OT_set_scale(_Align, bpy.types.Operator):
    """Bring captures to their real size: two marked points get the distance that was measured between them"""

    bl_idname = "fastgs.set_scale"
    bl_label = "Set Scale"

    distance: FloatProperty(
        name="Distance", subtype='DISTANCE', min=1e-6, default=1.0,
        description="Real distance of the two selected objects or cameras, or vertices of the proxy in Edit Mode")

    def invoke(self, context, event):
        return context.window_manager.invoke_props_dialog(self)

    def motion(self, context, worlds):
        (a, b), marks = points(context, 2, of_cameras=True)
        apart = np.linalg.norm(b - a)
        if apart < 1e-9:
            raise FastGSError("the two points are at the same place; choose two points far apart.")
        return np.diag([*[self.distance / apart] * 3, 1.0]), marks
