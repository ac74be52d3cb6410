# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean Up: hides what spoils a capture, and shows at once what a slider changes."""
from __future__ import annotations

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..scene import cleaning, objects, selection
from .action import EDITABLE_SPLATS, Action

_Reasons = type("_Reasons", (), {"__annotations__": {
    name: BoolProperty(name=label, description=meaning, default=True) for name, (label, meaning, _) in cleaning.REASONS.items()}})


class FASTGS_OT_clean_up(Action, _Reasons, bpy.types.Operator):
    """Hide what spoils the active object: floaters, needles, haze before the cameras, what was hardly filmed. E shows what was taken"""

    bl_idname = "fastgs.clean_up"
    bl_label = "Clean Up"
    needs = (EDITABLE_SPLATS,)

    amount: FloatProperty(name="Amount", description="How much is hidden", default=0.5, min=0.0, max=1.0, subtype='FACTOR')
    show: BoolProperty(name="Show What Is Taken", description="Show in red what was erased; the key E of the tools does the same")
    select: BoolProperty(name="Select It Instead", description="Select what would be hidden")
    counts: StringProperty(options={'HIDDEN', 'SKIP_SAVE'})

    def draw(self, context):
        layout = self.layout
        layout.prop(self, "amount", slider=True)
        for name, count in zip(cleaning.REASONS, self.counts.split(), strict=False):
            row = layout.row()
            row.prop(self, name)
            row.label(text=f"{int(count):,}")
        layout.prop(self, "show")
        layout.prop(self, "select")

    def act(self, context):
        obj, wanted = context.object, {name for name in cleaning.REASONS if getattr(self, name)}
        model = objects.load_one_model(obj, "cleaned")
        own = selection.own(obj)
        found = {name: bits & own for name, bits in cleaning.proposed(model, self.amount, wanted).items()}
        self.counts = " ".join(str(int(found[name].sum()) if name in found else 0) for name in cleaning.REASONS)
        taken = np.any([*found.values(), np.zeros(len(model), bool)], 0)
        if self.select:
            return f"{selection.select(obj, taken):,} Gaussians selected"
        if self.show:
            context.scene.fastgs.show_erased = True
        selection.erase(obj, taken)
        told = ", ".join(f"{cleaning.REASONS[name][0].lower()} {bits.sum():,}" for name, bits in found.items() if bits.any())
        return f"{taken.sum():,} of {own.sum():,} Gaussians hidden" + (f": {told}" if told else "")
