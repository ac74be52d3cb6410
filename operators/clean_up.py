# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean Up: hides what spoils a capture beside its cameras, and shows at once what a slider changes."""
import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..fastgs_blender.selecting.clean import KINDS, STRENGTH, clean
from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects, selection
from ..scene.background import in_background
from .action import EDITABLE_SPLATS
from .stepwise import Stepwise

_Kinds = type("_Kinds", (), {"__annotations__": {
    name: BoolProperty(name=kind.label, description=f"Hide {kind.meaning}", default=True) for name, kind in KINDS.items()}})


class FASTGS_OT_clean_up(Stepwise, _Kinds, bpy.types.Operator):
    """Hide what spoils the active object: floaters, haze, what was never filmed, stray colours. E shows what was taken"""

    bl_idname = "fastgs.clean_up"
    bl_label = "Clean Up"
    bl_options = {'REGISTER', 'UNDO'}
    needs = (EDITABLE_SPLATS,)
    doing = "Looking for what spoils the capture"
    interrupted = "{} was interrupted; nothing was hidden"

    strength: FloatProperty(name="Strength", description="How much is hidden", default=STRENGTH, min=0.0, max=1.0, subtype='FACTOR')
    show: BoolProperty(name="Show What Is Taken", description="Show in red what was erased; the key E of the tools does the same")
    select: BoolProperty(name="Select It Instead", description="Select what would be hidden")
    counts: StringProperty(options={'HIDDEN', 'SKIP_SAVE'})

    def draw(self, context):
        layout = self.layout
        layout.prop(self, "strength", slider=True)
        counts = dict(pair.split("=") for pair in self.counts.split())
        for name in KINDS:
            row = layout.row()
            row.prop(self, name)
            if self.counts:
                row.label(text=f"{int(counts[name]):,}" if name in counts else "no cameras" if getattr(self, name) else "")
        layout.prop(self, "show")
        layout.prop(self, "select")

    def steps(self, context):
        obj = context.object
        self._name, model = obj.name, objects.load_one_model(obj, "cleaned")
        if not selection.shown(obj).any():  # the cameras' pictures are of all that is in its file
            raise FastGSError(f'"{obj.name}" shows none of its Gaussians, so nothing can be cleaned up; restore some first.')
        kinds = [name for name in KINDS if getattr(self, name)]
        return (yield from in_background(lambda progress: clean(model, self.strength, kinds=kinds, progress=progress)))

    def finish(self, context, result):
        obj = bpy.data.objects[self._name]
        own = selection.own(obj)
        found = {name: bits & own for name, bits in result.found.items()}
        self.counts = " ".join(f"{name}={bits.sum()}" for name, bits in found.items())
        taken = result.taken & own
        if self.select:
            return f"{selection.select(obj, taken):,} Gaussians selected"
        if self.show:
            context.window_manager.fastgs.show_erased = True
        selection.erase(obj, taken)
        told = ", ".join(f"{KINDS[name].label.lower()} {bits.sum():,}" for name, bits in found.items() if bits.any())
        blind = "; the file knows no cameras, so that only floaters and stray colours were looked for" if result.unjudged else ""
        return f"{taken.sum():,} of {own.sum():,} Gaussians hidden" + (f": {told}" if told else "") + blind
