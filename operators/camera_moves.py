# SPDX-License-Identifier: GPL-3.0-or-later
"""Animates cameras by ordinary keyframes: orbit, dolly, a smooth path through cameras."""
import re

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty
from mathutils import Vector

from ..fastgs_blender.cameras import moves
from ..scene.cameras import keys as camera_keys
from ..scene.cameras.sides import filmed_side
from ..scene.cameras.subjects import capture_cameras, far_enough, subject_of, target_camera
from ..scene.objects import is_splat
from .action import OBJECT_MODE, Action, Need

CAMERA = Need(lambda context: target_camera(context, False) is not None, "The scene has no camera")


class _Move(Action):
    """Base class of the camera moves: range, ease, preview, and the limit to the region that the capture's cameras span."""

    needs = (OBJECT_MODE,)

    frame_start: IntProperty(name="First Frame", description="Frame on which the move begins", default=1)
    frame_end: IntProperty(name="Last Frame", description="Frame on which the move ends", default=100)
    ease: FloatProperty(
        name="Ease", description="Share of the time spent on starting and stopping; 0 is constant speed", subtype='FACTOR',
        min=0.0, max=1.0, default=0.0)
    spacing: IntProperty(
        name="Key Every", description="Frames between keyframes: fewer keys are easier to edit, more keys follow the path more closely",
        min=1, soft_max=50, default=10)
    new_camera: BoolProperty(name="New Camera", description="Animate a new camera, which becomes the scene's camera", default=False)
    stay_inside: BoolProperty(
        name="Stay Inside Capture", description="Keep the camera within the region that the capture's cameras span", default=False)
    margin: FloatProperty(
        name="Margin", description="How far beyond the capture's cameras the camera may go", subtype='DISTANCE', min=0.0, default=0.25)
    preview: BoolProperty(
        name="Preview as Curve", description="Show the path as a curve and leave the camera alone", default=False, options={'SKIP_SAVE'})

    def fitting(self, context) -> dict:
        """Values from the scene for properties that the user has not set."""
        return {"frame_start": context.scene.frame_start, "frame_end": context.scene.frame_end}

    def move(self, context, camera):
        """The function from shares of the way [M] to a moves.Path; camera may be None.  Raises FastGSError."""
        raise NotImplementedError

    def act(self, context):
        self.fill(**self.fitting(context))
        fresh = self.new_camera or not (context.scene.camera and context.scene.camera.type == 'CAMERA')
        moves.check_range(self.frame_start, self.frame_end)
        move = self.move(context, target_camera(context, False))
        cameras = np.array([c.matrix_world.translation for c in capture_cameras(context.scene)])

        def at(frames):
            share = moves.ease((frames - self.frame_start) / (self.frame_end - self.frame_start), self.ease)
            path = move(share)
            return moves.clamp_to_hull(path, cameras, self.margin) if self.stay_inside and len(cameras) else path

        every = at(np.arange(self.frame_start, self.frame_end + 1, dtype=np.float64))
        if len(cameras):
            beyond = moves.inside(every, cameras, self.margin + 1e-4)
            if beyond.any():
                first = self.frame_start + int(np.flatnonzero(beyond)[0])
                self.warn(f"From frame {first} on the camera leaves the region that the capture covers, by up to {beyond.max():.3g}; "
                          "expect holes there.")
        if self.preview:
            camera_keys.show(context, every)
            return
        camera_keys.hide(context)
        camera = target_camera(context, fresh)
        camera_keys.animate(camera, at, camera_keys.key_frames(self.frame_start, self.frame_end, self.spacing))
        if any(c.enabled for c in camera.constraints):
            self.warn(f'"{camera.name}" has constraints, which change its path.')
        context.scene.frame_set(context.scene.frame_current)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        own = [name for name in type(self).__annotations__ if name not in _Move.__annotations__]
        for name in [*own, "frame_start", "frame_end", "ease", "spacing", "new_camera"]:
            layout.prop(self, name)
        if capture_cameras(context.scene):
            layout.prop(self, "stay_inside")
            layout.prop(self, "margin")
        layout.prop(self, "preview")


class FASTGS_OT_camera_orbit(_Move, bpy.types.Operator):
    """Move the camera around the selected splats, the active object or the 3D cursor"""

    bl_idname = "fastgs.camera_orbit"
    bl_label = "Orbit"

    turns: FloatProperty(name="Turns", description="Number of turns; negative turns go clockwise", default=1.0, soft_min=-4.0, soft_max=4.0)
    radius: FloatProperty(name="Distance", description="Distance from the subject's centre", subtype='DISTANCE', min=1e-3, default=5.0)
    elevation: FloatProperty(name="Elevation", description="Angle above the horizon at the beginning", subtype='ANGLE', default=0.35)
    rise: FloatProperty(name="Rise", description="By how much the elevation changes along the way", subtype='ANGLE', default=0.0)
    start: FloatProperty(name="Start", description="Angle around the subject at the beginning", subtype='ANGLE', default=-np.pi / 2)
    filmed_side: BoolProperty(
        name="Stay on Filmed Side", description="Go from one end to the other of the side from which the subject was filmed, instead of by "
        "Start and Turns", default=False, options={'SKIP_SAVE'})

    def fitting(self, context):
        centre, size = subject_of(context)
        camera = target_camera(context, False)
        away = camera.matrix_world.translation - centre if camera else Vector((0, -1, 0.35)).normalized() * far_enough(context.scene, size)
        return {**super().fitting(context), "radius": max(away.length, 1e-3), "start": float(np.arctan2(away.y, away.x)),
                "elevation": float(np.arctan2(away.z, away.xy.length))}

    def move(self, context, camera):
        centre, _ = subject_of(context)
        lens = camera.data.lens if camera else 50.0
        start, turns, side = self.start, self.turns, self._side(context, centre)
        if self.filmed_side and side is not None:
            start, turns = side.first, side.width / (2 * np.pi)
            if self.turns < 0:
                start, turns = start + side.width, -turns
        elif side is not None:
            share = moves.ease(np.linspace(0, 1, self.frame_end - self.frame_start + 1), self.ease)
            gone = np.flatnonzero(side.beyond(start + 2 * np.pi * turns * share))
            if len(gone):
                self.warn(f"From frame {self.frame_start + int(gone[0])} on the orbit leaves the side that was filmed, "
                          f"{np.degrees(side.width):.0f} degrees wide; expect holes there. Stay on Filmed Side, in the panel Orbit below, "
                          "keeps to it.")
        return lambda s: moves.orbit(s, np.array(centre), self.radius, self.elevation, start, turns, lens, self.rise)

    @staticmethod
    def _side(context, centre):
        """From where the subject was filmed; None: from all around, or nothing tells."""
        chosen = [obj for obj in {context.object, *context.selected_objects} if is_splat(obj)]
        return filmed_side(chosen[0], centre) if len(chosen) == 1 else None


class FASTGS_OT_camera_dolly(_Move, bpy.types.Operator):
    """Move the scene's camera straight on, or make a dolly zoom"""

    bl_idname = "fastgs.camera_dolly"
    bl_label = "Dolly"
    needs = (OBJECT_MODE, CAMERA)

    axis: EnumProperty(
        name="Direction", description="Which way the camera goes, as it sees it",
        items=(('FORWARD', "Forward", "Into the picture", 0), ('RIGHT', "Right", "To the right", 1), ('UP', "Up", "Upwards", 2)),
        default='FORWARD')
    distance: FloatProperty(name="Distance", description="How far; negative goes the other way", subtype='DISTANCE', default=1.0)
    zoom: BoolProperty(
        name="Keep Subject's Size", description="Change the focal length so that the subject stays as large as it is (a dolly zoom)",
        default=False)

    def move(self, context, camera):
        context.scene.frame_set(self.frame_start)
        position, rotation = camera_keys.pose(camera)
        axes = np.array(camera.matrix_world.to_3x3().normalized())
        direction = {'FORWARD': -axes[:, 2], 'RIGHT': axes[:, 0], 'UP': axes[:, 1]}[self.axis]
        subject = None
        if self.zoom and self.axis == 'FORWARD':
            subject = float(np.dot(np.array(subject_of(context)[0]) - position, direction))
        moves.dolly(np.ones(1), position, rotation, direction, self.distance, camera.data.lens, subject)  # complains at once
        lens = camera.data.lens
        return lambda s: moves.dolly(s, position, rotation, direction, self.distance, lens, subject)


class FASTGS_OT_camera_through(_Move, bpy.types.Operator):
    """Move a camera smoothly through the selected cameras, each next to its neighbours"""

    bl_idname = "fastgs.camera_through"
    bl_label = "Path Through Cameras"
    needs = (OBJECT_MODE, Need(lambda context: sum(obj.type == 'CAMERA' for obj in context.selected_objects) > 1,
                               "Select two cameras at least"))

    order: EnumProperty(
        name="Order", description="Which camera comes after which",
        items=(('PLACE', "By Place", "A short way through all of them, from the active camera or the end nearest to it", 0),
               ('NAME', "By Name", "In the order of their names, numbers as numbers", 1)), default='PLACE')
    closed: BoolProperty(name="Closed", description="Return to the first camera at the end", default=False)
    new_camera: BoolProperty(name="New Camera", description="Animate a new camera, which becomes the scene's camera", default=True)

    def move(self, context, camera):
        chosen = [o for o in context.selected_objects if o.type == 'CAMERA' and (self.new_camera or o != camera)]
        chosen.sort(key=lambda o: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", o.name)])
        if self.order == 'PLACE' and len(chosen) > 2:
            first = chosen.index(context.object) if context.object in chosen else 0
            places = np.array([o.matrix_world.translation for o in chosen])
            chosen = [chosen[k] for k in moves.order_by_place(places, self.closed, first)]
        poses = [camera_keys.pose(o) for o in chosen]
        sensor = camera.data.sensor_width if camera else 36.0  # the fields of view count, whatever the sensors
        given = moves.Path(np.array([p for p, _ in poses]), np.array([q for _, q in poses]),
                           np.array([o.data.lens * sensor / o.data.sensor_width for o in chosen]))
        moves.through(np.zeros(1), given, self.closed)  # complains at once
        return lambda s: moves.through(s, given, self.closed)
