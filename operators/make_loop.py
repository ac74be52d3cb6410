# SPDX-License-Identifier: GPL-3.0-or-later
"""Make Loop: finds the best cut of a clip and lets the object play it over and over."""
from functools import partial

import bpy
from bpy.props import BoolProperty, FloatProperty

from ..fastgs_blender.stitching.loops import find_loop
from ..fastgs_blender.util.errors import FastGSError
from ..scene import stitching
from ..scene.background import in_steps
from .action import EDITABLE_SPLATS, OBJECT_MODE, Need
from .stepwise import Stepwise


class FASTGS_OT_make_loop(Stepwise, bpy.types.Operator):
    """Find the part of the clip that loops best, by pictures and motion, and play it over and over; it sets trim, loop and fade"""

    bl_idname = "fastgs.make_loop"
    bl_label = "Make Loop"
    bl_options = {'REGISTER', 'UNDO'}
    needs = (OBJECT_MODE, EDITABLE_SPLATS, Need(lambda context: context.object.fastgs.frame_count > 3, "The clip has too few frames"))
    doing, interrupted = "Looking for a loop", "Looking for a loop was cancelled; nothing was changed"

    least: FloatProperty(
        name="At Least", description="Frames of the capture that the loop lasts at least; 0 is half of the clip", default=0.0, min=0.0)
    fade: FloatProperty(
        name="Fade", description="Frames of the capture over which the end fades into the beginning; 0 cuts", default=8.0, min=0.0,
        soft_max=50.0)
    propose: BoolProperty(name="Only Propose", description="Say what the best loop is, and change nothing", default=False)

    def steps(self, context):
        """Yields the share that is done; returns the object and the loop."""
        obj = context.object
        stitching.check_loop(obj)
        source, settings = stitching.looped(obj, context.evaluated_depsgraph_get())
        work = partial(find_loop, source, least=self.least or None, fade=self.fade, settings=settings)
        return obj, (yield from in_steps(lambda progress: work(progress=progress), self.in_window))

    def finish(self, context, result):
        obj, found = result
        told = ""
        if not self.propose:
            try:
                same, left = stitching.playing(obj, context.scene)
                for each in (obj, *same):
                    stitching.loop(each, found)
            except ReferenceError:
                raise FastGSError("the splat object was deleted meanwhile.") from None
            told = _named(". The same loop: ", same) + _named(". Left, because they are timed in another way: ", left)
        if found.uncut:
            return (f"the whole clip loops best; no cut is better: from its last frame to its first the picture changes {found.cut:.1f} "
                    "times as much as from frame to frame" + told)
        return (f"frames {found.start:g} to {found.start + found.length:g} loop, {found.length:g} frames. At the seam the picture changes "
                f"{found.cut:.1f} times as much as from frame to frame, with the fade {found.blended:.1f} times; the whole clip's seam "
                f"{found.whole:.1f} times" + told)


def _named(begin: str, many: list) -> str:
    """A sentence that ends with the names of objects; "" where there are none."""
    return begin + ", ".join(f'"{each.name}"' for each in many) if many else ""
