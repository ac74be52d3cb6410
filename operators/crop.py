# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that crop a splat object with shapes, and hide Gaussians for what they are."""
import bpy
from bpy.props import EnumProperty

from ..fastgs_blender.selecting.kinds import KINDS
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


PRESETS = [(key, kind.label, f"Begin with {kind.meaning}", number) for number, (key, kind) in enumerate(KINDS.items())]


class FASTGS_OT_add_filter(Action, bpy.types.Operator):
    """Hide or show Gaussians of the active object by size, opacity, speed, lifetime, colour or neighbours"""

    bl_idname = "fastgs.add_filter"
    bl_label = "Add Filter"
    needs = (EDITABLE_SPLATS,)

    preset: EnumProperty(name="Filter", description="What the filter begins with; every value can be changed", items=PRESETS)

    def act(self, context):
        found = KINDS[self.preset].filter(objects.load_model(objects.abspath(context.object)))
        item = context.object.fastgs.filters.add()
        item.kind, item.low, item.high, item.mode = found.kind, found.low, found.high, 'KEEP' if found.keep else 'HIDE'


class FASTGS_OT_remove_filter(Remove, bpy.types.Operator):
    """Remove this filter: what it hides is shown again"""

    bl_idname = "fastgs.remove_filter"
    bl_label = "Remove Filter"
    items, needs = "filters", listed("filters")
