# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that crop a splat object with shapes."""
import bpy
from bpy.props import EnumProperty

from ..fastgs_blender.util.errors import FastGSError
from ..scene import crops, objects
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action, Remove, listed


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


class FASTGS_OT_remove_crop_box(Remove, bpy.types.Operator):
    """Stop cropping the active object with this shape; the shape itself stays in the scene"""

    bl_idname = "fastgs.remove_crop_box"
    bl_label = "Remove Crop Box"
    items, needs = "crops", listed("crops")
