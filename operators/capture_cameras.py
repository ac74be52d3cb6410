# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports the cameras of a capture, with their films or pictures as backgrounds."""
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper
from mathutils import Matrix

from ..fastgs_blender.util.errors import FastGSError, printable
from ..scene import model_space, objects, paths
from ..scene.cameras import clips, undistorted
from ..scene.cameras import space as camera_space
from ..scene.cameras.backgrounds import reel_of, show_behind
from ..scene.cameras.placing import animate, new_camera, set_optics, set_pose, use_render_size
from .action import Action, Need, draw_options
from .stepwise import Stepwise

MOST_UNDISTORTED = 600
"""Pictures that an import undistorts unasked: more take minutes."""


class FASTGS_OT_import_capture(Stepwise, bpy.types.Operator, ImportHelper):
    """Import the cameras of a multi-view capture, with their films or pictures as backgrounds"""

    bl_idname = "fastgs.import_capture"
    bl_label = "Import Capture Cameras"
    bl_options = {'REGISTER', 'UNDO', 'PRESET'}
    doing = "Undistorting the pictures"
    free = True

    directory: StringProperty(subtype='DIR_PATH', options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})

    space: EnumProperty(name="Place", description="Where the capture's world lies in the scene", items=camera_space.ITEMS, default='AUTO')
    backgrounds: EnumProperty(
        name="Backgrounds", description="What to show behind each camera",
        items=(
            ('AUTO', "Automatic", "The files themselves; undistorted copies if lenses distort and there are not too many pictures", 0),
            ('FILES', "Files", "The files unchanged, even if the lens distorts", 1),
            ('UNDISTORTED', "Undistorted", "Copies without lens distortion, written once into the extension's folder", 2),
            ('NONE', "None", "Cameras only", 3),
        ), default='AUTO')
    scale: FloatProperty(
        name="Picture Scale", description="Factor on the size of the pictures; 0: as the capture's layout has it",
        min=0.0, max=1.0, default=0.0)
    set_scene: BoolProperty(
        name="Set Scene", description="Give the scene the capture's frame rate, length and picture size, and its first camera",
        default=False)

    def draw(self, context):
        draw_options(self, "space", "backgrounds", "scale", "set_scene")

    def invoke(self, context, event):
        self._interactive = True
        return ImportHelper.invoke(self, context, event)

    def steps(self, context):
        path = bpy.path.abspath(self.filepath or self.directory)
        if not path:
            raise FastGSError("no capture was chosen; choose its folder, or a file that describes it.")
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        return self._read(path)

    def _read(self, path):
        """The capture and the background of each of its views; yields the progress of writing pictures."""
        from ..fastgs_blender.captures import open_capture

        capture = open_capture(paths.bare(path), scale=self.scale or None)
        if not capture.posed:
            raise FastGSError(f"{capture.path} does not say where its cameras are; calibrate it first (train it, or use COLMAP).")
        return capture, (yield from self._reels(capture))

    def finish(self, context, result):
        capture, reels = result
        for problem in (*capture.faults, *capture.notes):
            self.warn(problem)
        made = self._create(context, capture, reels)
        context.view_layer.update()
        clip = clips.filmed(context)
        if clip is not None and self.set_scene:
            clips.fit(context.scene, clip)
        elif self.set_scene:
            use_render_size(context.scene, made[0])
        elif clip is not None and (difference := clips.difference(context.scene, clip)):
            self.warn(f"{difference}  Backgrounds show one picture a scene frame; Set Scene, in the Capture panel, gives the scene the "
                      "capture's rate, range and picture size.")
        return f"Imported {len(made)} cameras, {capture.clip.frame_count} frames"

    def _start(self, context) -> int:
        """Scene frame of the capture's first frame: the start of its splat object, else of the scene."""
        splat = camera_space.splat_of(context, self.space)
        return round(splat.fastgs.start_frame) if splat else context.scene.frame_start

    def _create(self, context, capture, reels) -> list[bpy.types.Object]:
        splat, start = camera_space.splat_of(context, self.space), self._start(context)
        name = printable(Path(capture.path).stem) or "Capture"
        collection = bpy.data.collections.new(name)
        context.scene.collection.children.link(collection)
        world = bpy.data.objects.new(name, None)
        world.empty_display_type, world.empty_display_size = 'ARROWS', 0.2 * capture.extent
        collection.objects.link(world)
        if splat:
            world.parent = splat
            world.matrix_parent_inverse = Matrix(model_space.model_matrix(splat).tolist())
        else:
            world.matrix_world = camera_space.world_matrix(None, capture.axes)
        made = []
        for view in capture.views:
            shots = [shot for shot in capture.shots if shot.view == view]
            obj = new_camera(view, collection)
            data = obj.data
            data.fastgs.view = view
            clips.remember(data, start, capture.clip)
            data.display_size = 0.1 * capture.extent
            data.clip_end = max(data.clip_end, 100 * capture.extent)
            obj.parent = world
            set_optics(data, shots[0].camera)
            set_pose(obj, shots[0].camera)
            if len({id(shot.camera) for shot in shots}) > 1:
                animate(obj, [shot.camera for shot in shots], np.array([start + shot.frame for shot in shots], np.float64))
            if view in reels:
                show_behind(data, reels[view], start + shots[0].frame)
            made.append(obj)
        objects.select_only(context, *made)
        return made

    def _reels(self, capture):
        """The background of each view {view: Reel}; yields progress."""
        if self.backgrounds == 'NONE':
            return {}
        distorted = [shot for shot in capture.shots if not shot.image.lens.is_pinhole]
        undistort = self.backgrounds == 'UNDISTORTED' or (self.backgrounds == 'AUTO' and len(distorted) <= MOST_UNDISTORTED)
        if distorted and undistort:
            copies = yield from undistorted.steps(capture, distorted)
            capture.shots[:] = [copies.get(shot, shot) for shot in capture.shots]
        elif distorted:
            self.warn(f"{len({shot.view for shot in distorted})} lenses distort, and so do their pictures; import again with Backgrounds "
                      f"set to Undistorted to have {len(distorted)} corrected pictures written.")
        return {view: reel_of([shot for shot in capture.shots if shot.view == view]) for view in capture.views}


class FASTGS_OT_set_scene(Action, bpy.types.Operator):
    """Give the scene the frame rate, the frame range and the picture size of the imported capture, and look through its camera"""

    bl_idname = "fastgs.set_scene"
    bl_label = "Set Scene"
    needs = (Need(lambda context: clips.filmed(context) is not None, "Import a capture's cameras first"),)

    def act(self, context):
        clips.fit(context.scene, clips.filmed(context))


def _is_filmed(context) -> bool:
    obj = context.object
    return obj is not None and obj.type == 'CAMERA' and obj.data.fastgs.width > 0


class FASTGS_OT_render_as_filmed(Action, bpy.types.Operator):
    """Look through the active camera of a capture, and render at the size and pixel aspect that it filmed with"""

    bl_idname = "fastgs.render_as_filmed"
    bl_label = "Render as Filmed"
    needs = (Need(_is_filmed, "Select a camera of a capture first"),)

    def act(self, context):
        use_render_size(context.scene, context.object)
