# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators that put two captures together: aligning them by their surfaces, grading one to the other, fading one into the other."""

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty

from ..fastgs_blender.stitching.fitting import align
from ..fastgs_blender.stitching.grading import match_grade
from ..scene import stitching
from ..scene.background import in_steps
from .action import OBJECT_MODE, Action, Need
from .stepwise import Stepwise

TWO = Need(lambda context: stitching.pair(context) is not None,
           "Select two splat objects: first the one that is changed, then, as the active one, the one that stays")


class _OfTwo(Stepwise):
    """Work on two objects that the library does by itself, in a thread where there is a window."""

    bl_options = {'REGISTER', 'UNDO'}
    needs = (OBJECT_MODE, TWO)

    def work(self, moving, fixed, progress):
        """What the library does with two instances."""
        raise NotImplementedError

    def precheck(self, obj, fixed) -> None:
        """Raise FastGSError before the work where its result could not be used."""

    def steps(self, context):
        """Yields the share that is done; returns the objects and the result."""
        obj, fixed = stitching.pair(context)
        self.precheck(obj, fixed)
        depsgraph = context.evaluated_depsgraph_get()
        pair = stitching.shown(obj, depsgraph), stitching.shown(fixed, depsgraph)
        return obj, fixed, (yield from in_steps(lambda progress: self.work(*pair, progress), self.in_window))


class FASTGS_OT_align_overlap(_OfTwo, bpy.types.Operator):
    """Move the selected capture onto the active one, where both show the same surfaces on this frame"""

    bl_idname = "fastgs.align_overlap"
    bl_label = "Align by Overlap"
    doing, interrupted = "Aligning", "Aligning was cancelled; nothing was moved"

    scale: BoolProperty(name="Scale", description="Change its size too; without this it is only moved and turned", default=False)
    search: BoolProperty(name="Search All Around", description="Try other places and turns where it does not fit from where it is",
                         default=True)

    def precheck(self, obj, fixed):
        stitching.check_movable(obj, fixed)

    def work(self, moving, fixed, progress):
        return align(moving, fixed, scale=self.scale, search=self.search, progress=progress)

    def finish(self, context, result):
        obj, fixed, found = result
        stitching.move(context, obj, fixed, found.matrix)
        sized = f", scaled by {found.scale:.4g}" if self.scale else ""
        lies = "lies on" if (found.matrix != np.eye(4)).any() else "stays where it is, on"
        return (f'"{obj.name}" {lies} "{fixed.name}"{sized}: {found.overlap:.0%} overlap, {found.residual:.3g} apart there; '
                f"{found.agreement:.0%} of what comes near agrees")


class FASTGS_OT_match_grade(_OfTwo, bpy.types.Operator):
    """Give the selected capture the colours of the active one by what both show on this frame; it changes the look, not the file"""

    bl_idname = "fastgs.match_grade"
    bl_label = "Match Grade"
    doing, interrupted = "Comparing colours", "Comparing colours was cancelled; nothing was changed"

    def work(self, moving, fixed, progress):
        return match_grade(moving, fixed, progress)

    def finish(self, context, result):
        obj, fixed, found = result
        stitching.grade(obj, found.looks)
        return (f'"{obj.name}" has the colours of "{fixed.name}": they differed by {100 * found.before:.1f} %, now by '
                f"{100 * found.after:.1f} %, in {found.pixels:,} pixels that show both")


class FASTGS_OT_cross_fade(Action, bpy.types.Operator):
    """Fade the selected capture into the active one from this frame on, by keys of their opacities"""

    bl_idname = "fastgs.cross_fade"
    bl_label = "Cross-Fade"
    needs = (OBJECT_MODE, TWO)

    start: FloatProperty(name="Start", description="The frame on which the fade begins", default=1.0)
    frames: FloatProperty(name="Frames", description="How long it takes", default=24.0, min=0.1, soft_max=250.0)
    overlap: FloatProperty(
        name="Overlap", description="Share of the time in which both are shown fully, so that nothing shines through what is solid. "
        "Without it the one goes as the other comes", default=0.0, min=0.0, max=1.0, subtype='FACTOR')

    def invoke(self, context, event):
        self.fill(start=context.scene.frame_current + context.scene.frame_subframe)
        return self.execute(context)

    def act(self, context):
        before, after = stitching.pair(context)
        stitching.cross_fade(before, after, self.start, self.frames, self.overlap)
        context.view_layer.update()
        return f'"{before.name}" fades into "{after.name}" on the frames {self.start:g} to {self.start + self.frames:g}'
