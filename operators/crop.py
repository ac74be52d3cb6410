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
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action, Need, item_of


class FASTGS_OT_add_crop_box(Action, bpy.types.Operator):
    """Add a shape outside of which nothing of the active object's splats is shown"""

    bl_idname = "fastgs.add_crop_box"
    bl_label = "Add Crop"
    needs = (EDITABLE_SPLATS, OBJECT_MODE)

    shape: EnumProperty(
        name="Shape", description="What is added",
        items=(
            ('BOX', "Box", "An empty around the splats, which moves with them", 'CUBE', 0),
            ('SPHERE', "Sphere", "An empty around the splats, which moves with them", 'SPHERE', 1),
            ('MESH', "Selected Meshes", "The insides of the selected meshes, which must be closed", 'MESH_MONKEY', 2),
        ), default='BOX')

    def act(self, context):
        if self.shape == 'MESH':
            meshes = [obj for obj in context.selected_objects if obj.type == 'MESH' and not objects.is_splat(obj)]
            if not meshes:
                raise FastGSError("no mesh is selected: select closed meshes and, last, the splat object")
            for mesh in meshes:
                item = context.object.fastgs.crops.add()
                item.object, item.shape = mesh, 'MESH'
            return
        box = crops.add_shape(context.object, self.shape)
        for other in context.selected_objects:
            other.select_set(False)
        box.select_set(True)


class FASTGS_OT_remove_crop_box(Action, bpy.types.Operator):
    """Stop cropping the active object with this shape; the shape itself stays in the scene"""

    bl_idname = "fastgs.remove_crop_box"
    bl_label = "Remove Crop Box"
    needs = (EDITABLE_SPLATS, Need(lambda context: len(context.object.fastgs.crops) > 0, "The object has no crops"))

    index: IntProperty(name="Index", description="The shape to remove", min=0)

    def act(self, context):
        item_of(context.object.fastgs.crops, self.index)
        context.object.fastgs.crops.remove(self.index)
        context.object.update_tag()


class FASTGS_OT_apply_crop(Action, bpy.types.Operator, ExportHelper):
    """Write the Gaussians that the crops show on any frame of the clip into a new file, and use this file for the object"""

    bl_idname = "fastgs.apply_crop"
    bl_label = "Apply Crop"
    needs = (EDITABLE_SPLATS, Need(lambda context: any(item.use and item.object for item in context.object.fastgs.crops),
                                   "The object has no crops that are used"))

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})

    def invoke(self, context, event):
        path = Path(objects.abspath(context.object))
        self.filepath = str(path.with_name(f"{path.stem}-cropped{self.filename_ext}"))
        context.window_manager.fileselect_add(self)
        return {'RUNNING_MODAL'}

    def act(self, context):
        obj = context.object
        target = bpy.path.abspath(self.filepath)
        left, total = crops.write_cropped(obj, context.evaluated_depsgraph_get(), target)
        splat_object.show_file(obj, target)
        obj.fastgs.crops.clear()
        return f"Wrote {left:,} of {total:,} Gaussians"
