# SPDX-License-Identifier: GPL-3.0-or-later
"""Grow to the Thing: from strokes, or from what is selected, to all that belongs to it."""
import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty

from ..fastgs_blender.selecting.grow import connected, grow, unsure
from ..scene import objects, selection
from ..scene.background import in_background
from .action import EDITABLE_SPLATS, Need
from .stepwise import Stepwise

BEGUN = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.wanted or context.object.fastgs.selection),
             "Draw a stroke over the thing first, with one of the tools that select")


ASK = ("1 part is unsure (pink, or violet where not selected): draw over it with Shift or Ctrl, and grow again",
       "{} parts are unsure (pink, or violet where not selected): draw over each with Shift or Ctrl, and grow again")


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

        def work(progress):
            if self.to == 'CONNECTED':
                return connected(model, yes), np.zeros(len(yes), int)
            thing = grow(model, yes, no, self.reach)
            return thing, unsure(model, yes, no, thing)

        found = yield from in_background(work)
        out = np.zeros((2, len(own)), int)
        out[:, own] = found
        return out

    def finish(self, context, result):
        obj = bpy.data.objects[self._name]
        thing, part = result[0] > 0, result[1] * selection.own(obj)
        if not thing.any():
            self.warn("the stroke says too little of what belongs together, so nothing grew; draw a longer one over the thing")
            return None
        selection.put(obj, selection=thing & selection.own(obj), unsure=part > 0)
        count, told = len(np.unique(part[part > 0])), f"{selection.bits(obj, 'selection').sum():,} Gaussians selected"
        return f"{told}; {ASK[count > 1].format(count)}" if count else told
