# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that crop a splat object with boxes and write the remaining Gaussians as a new model."""
from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..fastgs_blender.util.errors import FastGSError
from ..scene import crops, objects
from ..scene.splats import splat_object


def _editable(context) -> bool:
    obj = context.object
    return obj is not None and objects.is_splat(obj) and obj.is_editable


class FASTGS_OT_add_crop_box(bpy.types.Operator):
    """Add an empty around the active object's splats, as a box outside of which nothing is shown. It moves with the object"""

    bl_idname = "fastgs.add_crop_box"
    bl_label = "Add Crop Box"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return _editable(context) and context.mode == 'OBJECT'

    def execute(self, context):
        box = crops.add_box(context.object)
        for other in context.selected_objects:
            other.select_set(False)
        box.select_set(True)
        return {'FINISHED'}


class FASTGS_OT_remove_crop_box(bpy.types.Operator):
    """Stop cropping the active object with this box; the box itself stays in the scene"""

    bl_idname = "fastgs.remove_crop_box"
    bl_label = "Remove Crop Box"
    bl_options = {'REGISTER', 'UNDO'}

    index: IntProperty(name="Index", description="The box to remove", min=0)

    @classmethod
    def poll(cls, context):
        return _editable(context) and len(context.object.fastgs.crops) > 0

    def execute(self, context):
        boxes = context.object.fastgs.crops
        if self.index >= len(boxes):
            return {'CANCELLED'}
        boxes.remove(self.index)
        context.object.update_tag()
        return {'FINISHED'}


class FASTGS_OT_apply_crop(bpy.types.Operator, ExportHelper):
    """Write the Gaussians that the boxes show on any frame of the clip into a new file, and use this file for the object"""

    bl_idname = "fastgs.apply_crop"
    bl_label = "Apply Crop"
    bl_options = {'REGISTER', 'UNDO'}

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})

    @classmethod
    def poll(cls, context):
        return _editable(context) and any(item.use and item.object for item in context.object.fastgs.crops)

    def invoke(self, context, event):
        path = Path(objects.abspath(context.object))
        self.filepath = str(path.with_name(f"{path.stem}-cropped{self.filename_ext}"))
        context.window_manager.fileselect_add(self)
        return {'RUNNING_MODAL'}

    def execute(self, context):
        obj = context.object
        target = bpy.path.abspath(self.filepath)
        try:
            left, total = crops.write_cropped(obj, context.evaluated_depsgraph_get(), target)
            splat_object.show_file(obj, target)
        except FastGSError as error:
            self.report({'ERROR'}, splat_object.sentence(error))
            return {'CANCELLED'}
        obj.fastgs.crops.clear()
        self.report({'INFO'}, f"Wrote {left:,} of {total:,} Gaussians")
        return {'FINISHED'}


CLASSES = (FASTGS_OT_add_crop_box, FASTGS_OT_remove_crop_box, FASTGS_OT_apply_crop)
