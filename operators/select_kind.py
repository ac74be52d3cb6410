# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that select Gaussians of the active object for what they are."""
from functools import partial

import bpy
from bpy.props import EnumProperty, FloatVectorProperty

from ..fastgs_blender.model.edits import state_of
from ..fastgs_blender.selecting import kinds
from ..scene import objects, selection, snapshot
from ..scene.background import in_steps
from .action import EDITABLE_SPLATS, OnItem, listed
from .stepwise import Stepwise

WAYS = (
    ('SET', "Set", "They alone are selected", 0),
    ('ADD', "Add", "They are selected too", 1),
    ('SUBTRACT', "Subtract", "They are taken out of the selection", 2),
    ('AND', "Intersect", "Of what is selected, they stay so", 3),
)
PLAIN = (
    ('ALL', "All", "Select all that the object shows", 0),
    ('NONE', "None", "Select nothing", 1),
    ('INVERSE', "Inverse", "Select what is not selected, and nothing else", 2),
)
KINDS = tuple((key, kind.label, f"Select {kind.meaning}", number) for number, (key, kind) in enumerate(kinds.KINDS.items(), len(PLAIN)))


class _Mode:
    needs = (EDITABLE_SPLATS,)

    mode: EnumProperty(name="Mode", description="What becomes of the selection", items=WAYS, default='SET', options={'SKIP_SAVE'})


class FASTGS_OT_select_kind(_Mode, Stepwise, bpy.types.Operator):
    """Select Gaussians of the active object for what they are"""

    bl_idname = "fastgs.select_kind"
    bl_label = "Select Gaussians by Kind"
    bl_options = {'REGISTER', 'UNDO'}
    doing, interrupted = "Selecting", "{} was interrupted; the selection is as it was"

    kind: EnumProperty(name="Kind", description="What is selected", items=PLAIN + KINDS)
    colour: FloatVectorProperty(
        name="Colour", description="The colour that is looked for; unset it is that of what is selected", subtype='COLOR_GAMMA', size=3,
        default=(0.0, 1.0, 0.0), min=0.0, max=1.0, options={'SKIP_SAVE'})

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "kind")
        if self.kind == 'COLOUR':
            layout.prop(self, "colour")
        if self.kind not in {'NONE', 'INVERSE'}:
            layout.prop(self, "mode")

    def steps(self, context):
        """Returns the object's name and what was found [N] bool of its file."""
        obj = context.object
        shown, before = selection.shown(obj), selection.bits(obj, "selection")
        plain = {'NONE': before & False, 'ALL': shown, 'INVERSE': shown & ~before}.get(self.kind)
        if plain is not None:
            return obj.name, plain
        model = objects.load_one_model(obj, "selected")
        if self.kind == 'COLOUR' and before.any() and not self.properties.is_property_set("colour"):
            self.colour = state_of(model.take(before), 0.5).colour.mean(0)
        work = partial(kinds.chosen, model, self.kind, tuple(self.colour))
        return obj.name, shown & ((yield from in_steps(lambda progress: work(), self.in_window)) if self.kind in kinds.GROWN else work())

    def finish(self, context, result):
        obj = bpy.data.objects[result[0]]
        if self.kind == 'NONE':
            selection.clear(obj)
            return "Nothing is selected"
        return f"{selection.select(obj, result[1], 'SET' if self.kind == 'INVERSE' else self.mode):,} Gaussians selected"


class FASTGS_OT_select_filtered(_Mode, OnItem, bpy.types.Operator):
    """Select what this filter means, and switch the filter off, so that it is seen"""

    bl_idname = "fastgs.select_filtered"
    bl_label = "Select Filtered"
    items, needs = "filters", listed("filters")

    def act(self, context):
        obj, item = context.object, self.item(context)
        item.use = False
        found = snapshot.filter_of(item).holds(objects.load_one_model(obj, "selected"))
        return f"{selection.select(obj, found & selection.shown(obj), self.mode):,} Gaussians selected"
