# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing: from strokes, or from what is selected, to all that belongs to it."""
import bpy
from bpy.props import EnumProperty, FloatProperty

from ..fastgs_blender.selecting.grow import connected, grow
from ..scene import objects, selection
from ..scene.background import in_background
from .action import EDITABLE_SPLATS, Need
from .stepwise import Stepwise

BEGUN = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.wanted or context.object.fastgs.selection),
             "Draw a stroke over the thing first, with one of the tools that select")


class FASTGS_OT_grow(Stepwise, bpy.types.Operator):
    """Select the whole thing that strokes have begun to select, on all frames; strokes with Ctrl say what does not belong to it"""

    bl_idname = "fastgs.grow"
    bl_label = "Grow to the Thing"
    bl_options = {'REGISTER', 'UNDO'}
    needs = (BEGUN,)
    doing = "Growing"
    interrupted = "{} was interrupted; the selection is as it was"

    to: EnumProperty(
        name="To", description="How far the selection grows",
        items=(
            ('THING', "The Thing", "What lies together, moves together and looks alike", 0),
            ('CONNECTED', "All Connected", "Whatever can be reached from one Gaussian to the next, without a gap", 1),
        ), default='THING')
    reach: FloatProperty(
        name="Reach", description="How much farther than the border that was found the thing goes, or less far",
        min=-1, max=1, default=0, options={'SKIP_SAVE'})

    def draw(self, context):
        self.layout.prop(self, "to")
        if self.to == 'THING':
            self.layout.prop(self, "reach", slider=True)

    def steps(self, context):
        obj = context.object
        self._name, model, own = obj.name, objects.source_of(obj), selection.bits(obj, "part")
        yes, no = (selection.bits(obj, name)[own] for name in ("wanted" if obj.fastgs.wanted else "selection", "refused"))
        if self.to == 'CONNECTED':
            yes = selection.bits(obj, "selection")[own]
        work = (lambda progress: grow(model, yes, no, self.reach)) if self.to == 'THING' else (lambda progress: connected(model, yes))
        found = yield from in_background(work)
        out = own.copy()
        out[own] = found
        return out

    def finish(self, context, result):
        obj = bpy.data.objects[self._name]
        if not result.any():
            self.warn("the stroke says too little of what belongs together, so nothing grew; draw a longer one over the thing")
            return None
        selection.put(obj, selection=result & selection.own(obj))
        return f"{selection.bits(obj, 'selection').sum():,} Gaussians selected"
