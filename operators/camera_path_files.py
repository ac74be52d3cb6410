# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports camera paths of other programs as keyframes, and exports any animated camera."""
import warnings
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..fastgs_blender.cameras.moves import MOST_FRAMES
from ..fastgs_blender.cameras.paths import FORMATS, CameraPath, Picture, format_named, load_path, save_path
from ..fastgs_blender.util.errors import FastGSError, printable
from ..scene import camera as cameras
from ..scene.cameras import space as camera_space
from ..scene.cameras.placing import animate, new_camera, set_optics, set_pose, use_render_size
from ..scene.frame_range import frame_kept, frame_rate
from .action import Action, Need, draw_options

AXES = {"nerfstudio": "RFU", "instant-ngp": "RFU", "transforms.json": "RFU"}
"""Of the formats that do not live in COLMAP's axes."""
FORMAT_ITEMS = tuple((module.name.upper().replace("-", "_").replace(".", "_"), module.label, "", i) for i, module in enumerate(FORMATS))
NAMES = {item[0]: module.name for item, module in zip(FORMAT_ITEMS, FORMATS)}


def picture_of(scene) -> Picture:
    """The scene's picture size and frame rate, for files that state none."""
    frame = cameras.render_area(scene.render)
    return Picture(frame.width, frame.height, scene.render.fps / scene.render.fps_base)


def _reported(operator, work):
    """The result of work(); its warnings are reported."""
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always")
        result = work()
    for text in dict.fromkeys(str(remark.message) for remark in remarks):
        operator.warn(text)
    return result


class FASTGS_OT_import_camera_path(Action, bpy.types.Operator, ImportHelper):
    """Import a camera path as an animated camera: FAST-GS, Nerfstudio, instant-ngp, SuperSplat, cameras.json, COLMAP or transforms.json"""

    bl_idname = "fastgs.import_camera_path"
    bl_label = "Import Camera Path"
    bl_options = {'REGISTER', 'UNDO', 'PRESET'}

    filter_glob: StringProperty(default="*.json;*.ssproj;*.txt;*.bin", options={'HIDDEN'})
    directory: StringProperty(subtype='DIR_PATH', options={'HIDDEN', 'SKIP_SAVE', 'SKIP_PRESET'})

    space: EnumProperty(name="Place", description="Where the path's world lies in the scene", items=camera_space.ITEMS, default='AUTO')
    keys: EnumProperty(
        name="Keyframes", description="Which frames get a key",
        items=(
            ('FRAMES', "Every Frame", "Exactly the path that the other program plays", 0),
            ('KEYS', "The File's Own", "Fewer keys, easier to edit; Blender's curves run between them", 1),
        ), default='FRAMES')
    new_camera: BoolProperty(name="New Camera", description="Make a new camera; otherwise the scene's camera is animated", default=True)
    keep_speed: BoolProperty(
        name="Keep Speed", description="Stretch the path where its frame rate differs from the scene's; else one frame is one frame",
        default=False)
    set_scene: BoolProperty(name="Set Scene", description="Give the scene the path's length, frame rate and picture size", default=False)

    def draw(self, context):
        draw_options(self, "space", "keys", "new_camera", "keep_speed", "set_scene")

    def act(self, context):
        file = bpy.path.abspath(self.filepath or self.directory)
        scene = context.scene
        if not file:
            raise FastGSError("no file was chosen; choose a camera path.")
        path = _reported(self, lambda: load_path(file, picture_of(scene)))
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        if self.set_scene and path.fps:
            scene.render.fps, scene.render.fps_base = frame_rate(path.fps)
        numbers, shown = self._keys(path)
        rate = scene.render.fps / scene.render.fps_base
        frames = scene.frame_start + numbers * (rate / path.fps if self.keep_speed and path.fps else 1.0)
        splat = camera_space.splat_of(context, self.space)
        shown = [camera_space.out_of(camera, camera_space.world_matrix(splat, path.axes)) for camera in shown]
        obj = self._camera(context, printable(Path(file).stem))
        obj.animation_data_clear()
        obj.data.animation_data_clear()
        if obj.parent:
            obj.parent = None
            self.warn(f'"{obj.name}" is no longer parented: the path says where it is.')
        set_optics(obj.data, shown[0])
        set_pose(obj, shown[0])
        animate(obj, shown, frames)
        scene.camera = obj
        if self.set_scene:
            scene.frame_end = max(scene.frame_start, round(frames[-1]))
            use_render_size(scene, obj)
        self._tell_aspect(scene, shown[0])
        scene.frame_set(scene.frame_current)
        return f"Imported {len(shown)} keys, {len(path)} frames"

    def _keys(self, path):
        if self.keys == 'KEYS' and path.keys:
            return np.array([number for number, _ in path.keys], np.float64), [camera for _, camera in path.keys]
        return np.arange(len(path), dtype=np.float64), list(path.cameras)

    def _camera(self, context, name):
        scene = context.scene
        if not self.new_camera and scene.camera and scene.camera.type == 'CAMERA':
            return scene.camera
        return new_camera(name, scene.collection)

    def _tell_aspect(self, scene, camera):
        frame, render = cameras.render_area(scene.render), scene.render
        here = frame.width * render.pixel_aspect_x / (frame.height * render.pixel_aspect_y)
        there = camera.width / camera.fx * camera.fy / camera.height
        if abs(here / there - 1) > 1e-3:
            self.warn(f"The path was made for pictures of {camera.width} x {camera.height}; the scene's have another shape, so the "
                      "pictures show less or more at their edges (Render as Filmed sets that size).")


class FASTGS_OT_export_camera_path(Action, bpy.types.Operator, ExportHelper):
    """Export the animated camera, frame by frame, or all selected cameras, for other programs"""

    bl_idname = "fastgs.export_camera_path"
    bl_label = "Export Camera Path"
    bl_options = {'PRESET'}
    needs = (Need(lambda context: _source(context) is not None, "Select a camera first; the scene has none"),)

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={'HIDDEN'})
    format: EnumProperty(name="Format", description="The program that will read the path", items=FORMAT_ITEMS, default='FASTGS')
    space: EnumProperty(name="World", description="The world to write the cameras in", items=camera_space.ITEMS, default='AUTO')
    selected: BoolProperty(name="Selected Cameras", default=False,
                           description="Write each selected camera at the current frame, under its name, instead of one camera's frames")
    use_range: BoolProperty(name="Own Range", description="Export other frames than the scene's", default=False)
    frame_start: IntProperty(name="First Frame", description="First frame that is written", default=1)
    frame_end: IntProperty(name="Last Frame", description="Last frame that is written", default=100)

    def check(self, context):
        """Give the name the ending of its format; a COLMAP model is a folder, and has none."""
        if NAMES[self.format] != "colmap":
            return super().check(context)
        before, self.filepath = self.filepath, self.filepath.removesuffix(self.filename_ext)
        return self.filepath != before

    def draw(self, context):
        own = () if self.selected else ("use_range", "frame_start", "frame_end") if self.use_range else ("use_range",)
        draw_options(self, "format", "space", "selected", *own)

    def act(self, context):
        scene, name = context.scene, NAMES[self.format]
        if not self.filepath:
            raise FastGSError("no file was chosen; give the camera path a name.")
        if name == "colmap":
            self.check(context)
        file, shots = bpy.path.abspath(self.filepath), self._chosen(context)
        splat = camera_space.splat_of(context, self.space)
        axes = camera_space.axes_of(splat, AXES.get(name, "RDF"))
        path = CameraPath(self._cameras(context, splat, axes, shots), scene.render.fps / scene.render.fps_base, shots[0][1], axes,
                          names=[obj.name for obj, _ in shots] if self.selected else ())
        _reported(self, lambda: save_path(path, file, name))
        return f"Exported {len(path)} {'cameras' if self.selected else 'frames'} to {file} ({format_named(name).label})"

    def _chosen(self, context):
        """[(camera's object, frame)] that are written."""
        scene = context.scene
        if self.selected:
            found = sorted((obj for obj in context.selected_objects if obj.type == 'CAMERA'), key=lambda obj: obj.name)
            if not found:
                raise FastGSError("no camera is selected; select those to export, or switch off Selected Cameras.")
            return [(obj, scene.frame_current) for obj in found]
        first, last = (self.frame_start, self.frame_end) if self.use_range else (scene.frame_start, scene.frame_end)
        if last < first:
            raise FastGSError("the last frame must not come before the first.")
        if last - first >= MOST_FRAMES:
            raise FastGSError(f"the range has {last - first + 1} frames, and at most {MOST_FRAMES} are exported; choose a shorter one.")
        return [(_source(context), number) for number in range(first, last + 1)]

    def _cameras(self, context, splat, axes, shots):
        scene = context.scene
        frame, found = cameras.render_area(scene.render), []
        with frame_kept(scene):
            for obj, number in shots:
                scene.frame_set(number)
                depsgraph = context.evaluated_depsgraph_get()
                evaluated = obj.evaluated_get(depsgraph)
                world = camera_space.world_matrix(splat.evaluated_get(depsgraph) if splat else None, axes)
                found.append(camera_space.into(cameras.camera_of(evaluated, frame, depsgraph), world))
        return found


def _source(context):
    """The camera to export: the active one, else the scene's, else a selected one."""
    for obj in (context.object, context.scene.camera, *context.selected_objects):
        if obj is not None and obj.type == 'CAMERA':
            return obj
    return None
