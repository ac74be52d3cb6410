# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a capture as Blender cameras, with what they filmed behind them."""
from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Quaternion

from .. import fastgs_blender as fg
from ..fastgs_blender.util import rotations
from ..fastgs_blender.util.errors import FastGSError
from ..scene import camera as cameras
from ..scene.cameras import keys as camera_keys
from ..scene.cameras import space as camera_space
from ..scene.cameras import undistorted
from ..scene.frame_range import frame_rate
from ..scene.splats.splat_object import sentence
from .stepwise import Stepwise

MOST_UNDISTORTED = 600
"""Pictures that an import undistorts unasked: more take minutes."""


@dataclass(frozen=True)
class Reel:
    """A view's pictures as Blender plays them: a film, a numbered sequence, or a still."""

    path: Path
    source: str
    count: int
    offset: int


def reel_of(shots: list) -> Reel:
    """How to play these shots' files, one a frame, in order; a still where Blender could not."""
    sources = [shot.image for shot in shots]
    first, count = sources[0], len(sources)
    together = all(shot.frame == shots[0].frame + i for i, shot in enumerate(shots))
    if first.frame is not None:
        even = together and all(s.path == first.path and s.frame == first.frame + i for i, s in enumerate(sources))
        return Reel(first.path, 'MOVIE', count if even else 1, first.frame)
    digits = re.search(r"(\d+)(?=\D*$)", first.path.name)
    if digits is None or not together or count == 1:
        return Reel(first.path, 'FILE', 1, 0)
    number, width = int(digits[1]), len(digits[1])
    names = (f"{first.path.name[:digits.start()]}{number + i:0{width}}{first.path.name[digits.end():]}" for i in range(count))
    if any(source.path != first.path.with_name(name) for source, name in zip(sources, names)):
        return Reel(first.path, 'FILE', 1, 0)
    return Reel(first.path, 'SEQUENCE', count, number - 1)


def show_behind(data: bpy.types.Camera, reel: Reel, start: int) -> None:
    """Make a reel the camera's background, its first picture on frame `start` of the scene, filling the camera's frame."""
    image = bpy.data.images.load(str(reel.path), check_existing=True)
    if reel.source != 'FILE':
        image.source = reel.source
    background = data.background_images.new()
    background.image = image
    background.frame_method, background.display_depth, background.alpha = 'STRETCH', 'BACK', 1.0
    user = background.image_user
    user.frame_start, user.frame_duration, user.frame_offset = start, reel.count, reel.offset
    user.use_auto_refresh, user.use_cyclic = True, False
    data.show_background_images = True


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
    obj.rotation_quaternion = Quaternion(rotations.from_matrices(pose[:3, :3]))


def animate(obj: bpy.types.Object, shots: list[fg.Camera], frames: np.ndarray) -> None:
    """Key poses, and whatever of the intrinsics changes, on these frames; between them the curves are smooth."""
    poses = np.array([cameras.pose_of(camera) for camera in shots])
    optics = [cameras.optics_of(camera) for camera in shots]
    obj.rotation_mode = 'QUATERNION'
    turns = rotations.one_sign(rotations.from_matrices(poses[:, :3, :3]))
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


class FASTGS_OT_import_capture(Stepwise, bpy.types.Operator, ImportHelper):
    """Import the cameras of a multi-view capture, with their films or pictures as backgrounds"""

    bl_idname = "fastgs.import_capture"
    bl_label = "Import Capture Cameras"
    bl_options = {'REGISTER', 'UNDO', 'PRESET'}
    doing = "Correcting the lenses' pictures"

    directory: StringProperty(subtype='DIR_PATH', options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})

    space: EnumProperty(name="Place", description="Where the capture's world lies in the scene", items=camera_space.ITEMS, default='AUTO')
    backgrounds: EnumProperty(
        name="Backgrounds", description="What to show behind each camera",
        items=(
            ('AUTO', "Automatic", "The files themselves, or undistorted copies where lenses distort and the pictures are not too many", 0),
            ('FILES', "Files", "The files as they are, also where the lens distorts", 1),
            ('UNDISTORTED', "Undistorted", "Copies without the lens' distortion, written once into the extension's folder", 2),
            ('NONE', "None", "Cameras only", 3),
        ), default='AUTO')
    scale: FloatProperty(
        name="Picture Scale", description="Size of the pictures against the files; 0 leaves it to the capture's layout",
        min=0.0, max=1.0, default=0.0)
    set_scene: BoolProperty(
        name="Set Scene", description="Give the scene the capture's frame rate, length and picture size, and its first camera",
        default=False)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        for name in ("space", "backgrounds", "scale", "set_scene"):
            layout.prop(self, name)

    def invoke(self, context, event):
        self._interactive = True
        return ImportHelper.invoke(self, context, event)

    def execute(self, context):
        path = bpy.path.abspath(self.filepath or self.directory)
        if not path:
            self.report({'ERROR'}, "No capture was chosen; choose its folder, or a file that describes it.")
            return {'CANCELLED'}
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        return self.begin(context, self._read(path))

    def _read(self, path):
        """The capture and what plays behind each of its views; yields the progress of writing pictures."""
        from ..fastgs_blender.captures import open_capture

        capture = open_capture(path.rstrip("/\\") or path, scale=self.scale or None)
        if not capture.posed:
            raise FastGSError(f"{capture.path} does not say where its cameras are; calibrate it first (train it, or use COLMAP).")
        return capture, (yield from self._reels(capture))

    def finish(self, context, result):
        capture, reels = result
        for problem in (*capture.faults, *capture.notes):
            self.report({'WARNING'}, sentence(problem))
        made = self._create(context, capture, reels)
        if self.set_scene:
            self._fit_scene(context.scene, capture, made)
        else:
            self._tell_rate(context.scene, capture)
        self.report({'INFO'}, f"Imported {len(made)} cameras, {capture.clip.frame_count} frames")
        return {'FINISHED'}

    def _start(self, context) -> int:
        """Scene frame of the capture's first frame: where its splat object begins, else where the scene does."""
        splat = camera_space.splat_of(context, self.space)
        return round(splat.fastgs.start_frame) if splat else context.scene.frame_start

    def _create(self, context, capture, reels) -> list[bpy.types.Object]:
        splat, start = camera_space.splat_of(context, self.space), self._start(context)
        name = Path(capture.path).stem or "Capture"
        collection = bpy.data.collections.new(name)
        context.scene.collection.children.link(collection)
        world = bpy.data.objects.new(name, None)
        world.empty_display_type, world.empty_display_size = 'ARROWS', 0.2 * capture.extent
        collection.objects.link(world)
        if splat:
            world.parent = splat
        else:
            world.matrix_world = camera_space.world_matrix(None, capture.axes)
        made = []
        for view in capture.views:
            shots = [shot for shot in capture.shots if shot.view == view]
            data = bpy.data.cameras.new(view)
            obj = bpy.data.objects.new(view, data)
            data.fastgs.view = view
            data.display_size = 0.1 * capture.extent
            data.clip_end = max(data.clip_end, 100 * capture.extent)
            collection.objects.link(obj)
            obj.parent = world
            set_optics(data, shots[0].camera)
            set_pose(obj, shots[0].camera)
            if len({id(shot.camera) for shot in shots}) > 1:
                animate(obj, [shot.camera for shot in shots], np.array([start + shot.frame for shot in shots], np.float64))
            if view in reels:
                show_behind(data, reels[view], start + shots[0].frame)
            made.append(obj)
        for obj in context.view_layer.objects.selected:
            obj.select_set(False)
        for obj in made:
            obj.select_set(True)
        context.view_layer.objects.active = made[0]
        return made

    def _reels(self, capture):
        """What plays behind each view {view: Reel}; yields progress."""
        if self.backgrounds == 'NONE':
            return {}
        distorted = [shot for shot in capture.shots if not shot.image.lens.is_pinhole]
        undistort = self.backgrounds == 'UNDISTORTED' or (self.backgrounds == 'AUTO' and len(distorted) <= MOST_UNDISTORTED)
        if distorted and undistort:
            copies = yield from undistorted.steps(capture, distorted)
            capture.shots[:] = [copies.get(shot, shot) for shot in capture.shots]
        elif distorted:
            self.report({'WARNING'}, f"{len({shot.view for shot in distorted})} lenses distort, and so do their backgrounds; import again "
                                     f"with Backgrounds set to Undistorted to have {len(distorted)} corrected pictures written.")
        return {view: reel_of([shot for shot in capture.shots if shot.view == view]) for view in capture.views}

    def _fit_scene(self, scene, capture, made):
        scene.render.fps, scene.render.fps_base = frame_rate(capture.clip.fps)
        start = round(made[0].parent.parent.fastgs.start_frame) if made[0].parent.parent else scene.frame_start
        scene.frame_start, scene.frame_end = start, start + capture.clip.frame_count - 1
        use_render_size(scene, made[0])

    def _tell_rate(self, scene, capture):
        rate = scene.render.fps / scene.render.fps_base
        if capture.clip.frame_count > 1 and abs(rate / capture.clip.fps - 1) > 1e-3:
            self.report({'WARNING'}, f"The capture has {capture.clip.fps:g} frames per second and the scene {rate:g}: backgrounds show one "
                                     "picture a scene frame, so set the scene's frame rate to keep them in step with the splats.")


class FASTGS_OT_render_as_filmed(bpy.types.Operator):
    """Look through the active camera of a capture, and render at the size and pixel aspect that it filmed with"""

    bl_idname = "fastgs.render_as_filmed"
    bl_label = "Render as Filmed"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        obj = context.object
        return obj is not None and obj.type == 'CAMERA' and obj.data.fastgs.width > 0

    def execute(self, context):
        use_render_size(context.scene, context.object)
        return {'FINISHED'}


CLASSES = (FASTGS_OT_import_capture, FASTGS_OT_render_as_filmed)
