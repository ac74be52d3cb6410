# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that crop a splat object with shapes and write the remaining Gaussians as a new model."""
from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..fastgs_blender.util.errors import FastGSError
from ..scene import crops, objects
from ..scene.splats import splat_object


def _editable(context) -> bool:
    obj = context.object
    return obj is not None and objects.is_splat(obj) and obj.is_editable


class FASTGS_OT_add_crop_box(bpy.types.Operator):
    """Add a shape outside of which nothing of the active object's splats is shown"""

    bl_idname = "fastgs.add_crop_box"
    bl_label = "Add Crop"
    bl_options = {'REGISTER', 'UNDO'}

    shape: EnumProperty(
        name="Shape", description="What is added",
        items=(
            ('BOX', "Box", "An empty around the splats, which moves with them", 'CUBE', 0),
            ('SPHERE', "Sphere", "An empty around the splats, which moves with them", 'SPHERE', 1),
            ('MESH', "Selected Meshes", "The insides of the selected meshes, which must be closed", 'MESH_MONKEY', 2),
        ), default='BOX')

    @classmethod
    def poll(cls, context):
        return _editable(context) and context.mode == 'OBJECT'

    def execute(self, context):
        if self.shape == 'MESH':
            meshes = [obj for obj in context.selected_objects if obj.type == 'MESH' and not objects.is_splat(obj)]
            if not meshes:
                self.report({'ERROR'}, "No mesh is selected: select closed meshes and, last, the splat object")
                return {'CANCELLED'}
            for mesh in meshes:
                item = context.object.fastgs.crops.add()
                item.object, item.shape = mesh, 'MESH'
            return {'FINISHED'}
        box = crops.add_shape(context.object, self.shape)
        for other in context.selected_objects:
            other.select_set(False)
        box.select_set(True)
        return {'FINISHED'}


class FASTGS_OT_remove_crop_box(bpy.types.Operator):
    """Stop cropping the active object with this shape; the shape itself stays in the scene"""

    bl_idname = "fastgs.remove_crop_box"
    bl_label = "Remove Crop Box"
    bl_options = {'REGISTER', 'UNDO'}

    index: IntProperty(name="Index", description="The shape to remove", min=0)

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
    """Write the Gaussians that the crops show on any frame of the clip into a new file, and use this file for the object"""

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
