# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that make parts of splat objects and join them, erase what is selected, restore it, and write files without it."""
from pathlib import Path

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ..scene import objects, selection
from ..scene.splats import parting, splat_object
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action, Need

PICKED = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.selection), "No Gaussians are selected")
ERASED = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.mask), "Nothing of the active object was erased")
PART = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.part), "The active object shows its whole file")


def _others(context) -> list[bpy.types.Object]:
    return [obj for obj in context.selected_objects if obj != context.object and objects.is_splat(obj) and obj.is_editable]


class FASTGS_OT_separate(Action, bpy.types.Operator):
    """Make a new object, a part, of the selected Gaussians: the child of this one, with its look and time, which then are its own"""

    bl_idname = "fastgs.separate"
    bl_label = "Separate"
    needs = (OBJECT_MODE, EDITABLE_SPLATS, PICKED)

    name: StringProperty(name="Name", description="What the new object is called", default="Part")

    def act(self, context):
        obj = context.object
        part = parting.separate(context, obj, selection.bits(obj, "selection"), self.name)
        return f'"{part.name}" has {part.fastgs.gaussian_count:,} Gaussians'


class FASTGS_OT_join_parts(Action, bpy.types.Operator):
    """Give the Gaussians of the selected parts back to the active object, which shows them where the file has them"""

    bl_idname = "fastgs.join_parts"
    bl_label = "Join Parts"
    needs = (OBJECT_MODE, EDITABLE_SPLATS,
             Need(lambda context: bool(_others(context)), "Select parts of one file, and last the one that stays"))

    def act(self, context):
        return f"{parting.join(context, context.object, _others(context)):,} Gaussians came back"


class FASTGS_OT_show_whole(Action, bpy.types.Operator):
    """Show all Gaussians of the file, also those that are shown by other parts, or that this part does not know"""

    bl_idname = "fastgs.show_whole"
    bl_label = "Show Whole File"
    needs = (PART,)

    def act(self, context):
        context.object.fastgs.part = ""
        splat_object.refresh(context.object)


class FASTGS_OT_erase(Action, bpy.types.Operator):
    """Hide the selected Gaussians at all times; the file stays as it is"""

    bl_idname = "fastgs.erase"
    bl_label = "Erase"
    needs = (PICKED,)

    def act(self, context):
        obj = context.object
        return f"{selection.erase(obj, selection.bits(obj, 'selection')):,} Gaussians hidden"


class FASTGS_OT_show_hidden(Action, bpy.types.Operator):
    """Show all Gaussians of the active object that were erased"""

    bl_idname = "fastgs.show_hidden"
    bl_label = "Restore All"
    needs = (ERASED,)

    def act(self, context):
        context.object.fastgs.mask = ""


class FASTGS_OT_invert_hidden(Action, bpy.types.Operator):
    """Show the Gaussians of the active object that were erased, and hide all others"""

    bl_idname = "fastgs.invert_hidden"
    bl_label = "Swap Erased"
    needs = (ERASED,)

    def act(self, context):
        selection.clear(context.object)
        selection.put(context.object, mask=selection.own(context.object))


class FASTGS_OT_delete_for_good(Action, bpy.types.Operator, ExportHelper):
    """Write a new file without what was erased, and what crops and filters hide on all frames, and let the active object use it"""

    bl_idname = "fastgs.delete_for_good"
    bl_label = "Delete for Good"
    needs = (EDITABLE_SPLATS, Need(lambda context: selection.hides_anything(context.object),
                                   "Nothing of the active object was erased, cropped, filtered or made a part"))

    filename_ext = ".safetensors"
    filter_glob: StringProperty(default="*.safetensors", options={'HIDDEN'})

    def invoke(self, context, event):
        path = Path(objects.abspath(context.object))
        self.filepath = str(path.with_name(f"{path.stem}-cleaned{self.filename_ext}"))
        context.window_manager.fileselect_add(self)
        return {'RUNNING_MODAL'}

    def act(self, context):
        obj = context.object
        target = bpy.path.abspath(self.filepath)
        left, total = selection.write_left(obj, context.evaluated_depsgraph_get(), target)
        selection.clear(obj)
        before = obj.fastgs.part
        obj.fastgs.part = ""
        try:
            splat_object.show_file(obj, target)
        except Exception:
            obj.fastgs.part = before
            raise
        obj.fastgs.mask = ""
        obj.fastgs.crops.clear()
        obj.fastgs.filters.clear()
        return f"Wrote {left:,} of {total:,} Gaussians"
