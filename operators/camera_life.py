# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for bullet time, cameras that follow a region, handheld shake, and keys from the 3D view."""
import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty
from mathutils import Matrix, Vector

from ..fastgs_blender.cameras import moves
from ..fastgs_blender.util.errors import FastGSError
from ..scene import speeds
from ..scene.cameras import keys as camera_keys
from ..scene.cameras.framing import eye_of
from ..scene.cameras.subjects import subject_of, target_camera
from ..scene.cameras.tracking import region_track
from .action import IN_VIEW, SPLATS, Action
from .camera_moves import CAMERA


class FASTGS_OT_bullet_time(Action, bpy.types.Operator):
    """Slow the active capture down, or freeze it, while cameras go on moving"""

    bl_idname = "fastgs.bullet_time"
    bl_label = "Bullet Time"
    needs = (SPLATS,)

    start: IntProperty(name="First Frame", description="Scene frame on which the capture begins to slow down", default=1)
    length: IntProperty(name="Frames", description="How long the slow part lasts, ramps included", min=2, default=48)
    speed: FloatProperty(
        name="Speed", description="Speed of the capture in the slow part; 0 freezes it", subtype='FACTOR', min=0.0, max=1.0, default=0.0)
    ramp: IntProperty(name="Ramp", description="Frames over which it slows down, and speeds up again", min=0, default=6)

    def act(self, context):
        obj, scene = context.object, context.scene
        self.fill(start=scene.frame_current)
        settings = obj.fastgs
        path = "fastgs.offset"
        for name, title in ((path, "Time Shift"), (speeds.PATH, "Speed")):
            if camera_keys.is_animated(obj, name):
                raise FastGSError(f'"{obj.name}" has an animated {title} already; delete its keys and drivers first '
                                  "(Object Properties > 4D Gaussians > Time).")
        rate = settings.fps * scene.render.fps_base / scene.render.fps if settings.fps else 1.0
        lost = settings.speed * rate * (1 - self.speed)  # capture frames that each slow frame of the scene takes away
        ramp = min(self.ramp, self.length / 2)
        begin, end = float(self.start), float(self.start + self.length)
        # the speed changes linearly on the ramps, so the offset is a parabola there, which a Bezier segment holds exactly
        keys = [(begin, 0.0, 0.0), (begin + ramp, -lost * ramp / 2, -lost)] if ramp else [(begin, 0.0, -lost)]
        if end - ramp > begin + ramp + 1e-3:
            keys.append((end - ramp, -lost * (end - begin - 1.5 * ramp), -lost))
        if ramp:
            keys.append((end, -lost * (end - begin - ramp), 0.0))
        frames, values, slopes = (np.array(column) for column in zip(*keys))
        # before the first key and after the last the offset holds, so the capture runs at its own speed
        camera_keys.write(obj, path, frames, (settings.offset + values)[:, None], slopes[:, None])
        scene.frame_set(scene.frame_current)


class FASTGS_OT_follow_region(Action, bpy.types.Operator):
    """Let the camera follow the Gaussians around the 3D cursor"""

    bl_idname = "fastgs.follow_region"
    bl_label = "Follow Region"
    needs = (SPLATS,)

    radius: FloatProperty(
        name="Radius", description="Gaussians this near to the 3D cursor on the current frame are followed; 0 chooses by the object's size",
        subtype='DISTANCE', min=0.0, default=0.0)
    how: EnumProperty(
        name="Camera", description="How the camera follows the region",
        items=(('LOOK', "Look At It", "The camera turns towards the region", 0),
               ('MOVE', "Move With It", "The camera keeps its distance and its direction", 1),
               ('NONE', "Nothing", "Only make the empty that follows the region", 2)), default='LOOK')
    smooth: FloatProperty(name="Smooth", description="Frames over which the motion is averaged", min=0.0, soft_max=20.0, default=2.0)
    frame_start: IntProperty(name="First Frame", description="Frame with the first key", default=1)
    frame_end: IntProperty(name="Last Frame", description="Frame with the last key", default=100)

    def act(self, context):
        obj, scene = context.object, context.scene
        self.fill(frame_start=scene.frame_start, frame_end=scene.frame_end)
        moves.check_range(self.frame_start, self.frame_end)
        frames = np.arange(self.frame_start, self.frame_end + 1, dtype=np.float64)
        places = region_track(scene, obj, self._radius(context), frames, self.smooth)
        empty = bpy.data.objects.new(f"{obj.name} Region", None)
        empty.empty_display_type = 'SPHERE'
        empty.empty_display_size = self._radius(context)
        scene.collection.objects.link(empty)
        empty.location = places[0]
        camera_keys.write(empty, "location", frames, places, np.gradient(places, frames, axis=0))
        scene.frame_set(scene.frame_current)
        camera = target_camera(context, False)
        if camera and self.how == 'LOOK':
            track = camera.constraints.new('TRACK_TO')
            track.target, track.track_axis, track.up_axis = empty, 'TRACK_NEGATIVE_Z', 'UP_Y'
        elif camera and self.how == 'MOVE':
            world = camera.matrix_world.copy()
            camera.parent = empty
            camera.matrix_parent_inverse = Matrix.Translation(-Vector(empty.matrix_world.translation))
            camera.matrix_world = world
        elif self.how != 'NONE':
            self.warn("The scene has no camera; the empty that follows the region was made.")

    def _radius(self, context):
        return self.radius or 0.1 * subject_of(context)[1]


class FASTGS_OT_handheld(Action, bpy.types.Operator):
    """Let the scene's camera shake as if a hand held it; the shake lies on top of its other animation"""

    bl_idname = "fastgs.handheld"
    bl_label = "Handheld"
    needs = (CAMERA,)

    sway: FloatProperty(name="Sway", description="How far the camera moves", subtype='DISTANCE', min=0.0, default=0.02)
    turn: FloatProperty(name="Turn", description="How far the camera turns", subtype='ANGLE', min=0.0, default=0.008)
    period: FloatProperty(name="Period", description="Duration of one swing in seconds", min=0.05, default=1.2)
    seed: IntProperty(name="Seed", description="Another number gives another shake", min=0, default=0)
    remove: BoolProperty(name="Remove", description="Remove an earlier shake", default=False, options={'SKIP_SAVE'})

    def act(self, context):
        camera, scene = target_camera(context, False), context.scene
        quaternion = camera.rotation_mode == 'QUATERNION'
        turning = "delta_rotation_quaternion" if quaternion else "delta_rotation_euler"
        _clear(camera, ("delta_location", "delta_rotation_euler", "delta_rotation_quaternion"))
        if self.remove:
            return
        rng = np.random.default_rng(self.seed)
        scale = self.period * scene.render.fps / scene.render.fps_base
        for path, size in (("delta_location", self.sway), (turning, self.turn * (0.5 if quaternion else 1.0))):
            camera.keyframe_insert(path, frame=scene.frame_start)
            for curve in [c for c in camera_keys.curves(camera) if c.data_path == path]:
                if path == "delta_rotation_quaternion" and curve.array_index == 0:
                    continue
                noise = curve.modifiers.new('NOISE')
                noise.scale, noise.strength, noise.depth = scale, 2 * size, 1
                noise.phase = float(rng.uniform(1, 1000))


def _clear(camera, paths):
    found = camera_keys.curves(camera)
    shaken = {c.data_path for c in found if c.data_path in paths and any(m.type == 'NOISE' for m in c.modifiers)}
    for curve in [c for c in found if c.data_path in shaken]:
        found.remove(curve)
    for path, rest in (("delta_location", (0, 0, 0)), ("delta_rotation_euler", (0, 0, 0)), ("delta_rotation_quaternion", (1, 0, 0, 0))):
        if not any(c.data_path == path for c in found):
            setattr(camera, path, rest)


def _place(camera, matrix):
    """Put a camera there in the world.  Of the numbers that mean the same turn it gets those next to its former ones: no key spins."""
    quaternion, euler = camera.rotation_quaternion.copy(), camera.rotation_euler.copy()
    camera.matrix_world = matrix
    if camera.rotation_mode == 'QUATERNION':
        turned = camera.rotation_quaternion.copy()
        turned.make_compatible(quaternion)
        camera.rotation_quaternion = turned
    elif camera.rotation_mode != 'AXIS_ANGLE':
        camera.rotation_euler = camera.rotation_euler.to_matrix().to_euler(camera.rotation_mode, euler)


class FASTGS_OT_key_from_view(Action, bpy.types.Operator):
    """Put the scene's camera where the 3D view looks from, and key it on the current frame"""

    bl_idname = "fastgs.key_from_view"
    bl_label = "Key Camera from View"
    needs = (IN_VIEW,)

    def act(self, context):
        camera = target_camera(context, False) or target_camera(context, True)
        view = context.region_data
        if view.view_perspective != 'CAMERA':
            _place(camera, eye_of(context.space_data, view))
            # a view shows, at the same focal length, twice what a camera with Blender's standard sensor does
            camera.data.lens = context.space_data.lens * camera.data.sensor_width / 72.0
        frame = context.scene.frame_current
        before, same, after = _keys_around(camera, frame)
        for owner, name in ((camera, "location"), (camera, camera_keys.rotation_path(camera)), (camera.data, "lens")):
            owner.keyframe_insert(name, frame=frame)
        done = f'"{camera.name}" is keyed on frame {frame}'
        if same:
            return self.warn(f"{done}, in place of the key that was there.")
        if before is not None and after is not None:
            return self.warn(f"{done}, between its keys on frames {before:g} and {after:g}: its move there has changed.")
        if before is not None:
            return f"{done}, after its key on frame {before:g}."
        return f"{done}." if after is None else f"{done}, before its key on frame {after:g}."


def _keys_around(camera, frame) -> tuple[float | None, bool, float | None]:
    """The frame of a camera's last key of its place before this one, whether it has one here, and that of the next one after."""
    at = {point.co.x for curve in camera_keys.curves(camera) if curve.data_path == "location" for point in curve.keyframe_points}
    return (max((x for x in at if x < frame - 0.5), default=None), any(abs(x - frame) <= 0.5 for x in at),
            min((x for x in at if x > frame + 0.5), default=None))
