# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture This Scene: films the open, animated scene from many cameras with its own render engine, as a capture."""
import time
from contextlib import closing
from pathlib import Path

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

from ..fastgs_blender.util.errors import FastGSError, printable
from ..scene.filming import progress
from ..scene.filming.film import Plan, film_steps
from ..scene.filming.options import CaptureOptions
from ..scene.settings import BLEND_RELATIVE
from ..scene.training import folders, watch
from .action import OBJECT_MODE, check_frames
from .stepwise import Stepwise


class FASTGS_OT_capture_scene(Stepwise, CaptureOptions, bpy.types.Operator):
    """Film the open scene with its own render engine from many cameras, as a capture to train on; existing pictures are kept"""

    bl_idname = "fastgs.capture_scene"
    bl_label = "Capture This Scene"
    needs = (OBJECT_MODE,)
    doing = "Filming"

    out: StringProperty(
        name="Folder", description="Folder for the capture; empty: a new folder beside the .blend", subtype='DIR_PATH',
        options=BLEND_RELATIVE)
    frame_start: IntProperty(name="Start", description="First frame; by default the scene's")
    frame_end: IntProperty(name="End", description="Last frame; by default the scene's")
    train: BoolProperty(name="Train", description="Train on the capture as soon as it is complete", default=False, options={'SKIP_SAVE'})

    def invoke(self, context, event):
        panel = context.scene.fastgs.training
        self.fill(**{name: getattr(panel, name) for name in CaptureOptions.__annotations__})
        return super().invoke(context, event)

    def steps(self, context):
        """Yields the progress in pictures, and returns notes for the user."""
        self.fill(frame_start=context.scene.frame_start, frame_end=context.scene.frame_end)
        self._began = time.monotonic()
        self._out = bpy.path.abspath(self.out) if self.out else folders.unused("capture")
        shown = progress.current = progress.Filming(printable(Path(self._out).name))
        try:
            with closing(film_steps(context.scene, self._plan(context), self._out)) as steps:
                while True:
                    try:
                        shown.step(*next(steps))
                    except StopIteration as end:
                        return end.value
                    progress.measure(context.scene, self)
                    watch.redraw()
                    yield shown.done, shown.total, shown.doing
        except RuntimeError as error:  # Blender's own words about a render that failed
            raise FastGSError(f"a picture could not be rendered ({str(error).strip()}); render the scene by itself to see why.") from error
        finally:
            progress.current = None
            watch.redraw()

    def _plan(self, context) -> Plan:
        scene = context.scene
        check_frames(self)
        pool = {'SELECTED': context.selected_objects, 'ALL': scene.objects}.get(self.cameras, ())
        names = tuple(sorted(obj.name for obj in pool if obj.type == 'CAMERA'))
        if self.cameras in ('SELECTED', 'ALL') and len(names) < 2:
            raise FastGSError("fewer than two cameras are chosen, and a capture needs several; select more, or choose new cameras.")
        selected = None
        if self.subject == 'SELECTED':
            selected = tuple(sorted(obj.name for obj in context.selected_objects if obj.type != 'CAMERA'))
            if not selected:
                raise FastGSError("nothing is selected; select the objects that the capture shows.")
        return Plan(
            self.frame_start, self.frame_end, self.frame_step, self.width, self.height, self.samples if self.quality == 'FAST' else 0,
            names, self.count, 'arc' if self.cameras == 'ARC' else 'dome', float(self.angle) * 57.29577951308232, self.distance, selected,
            self.hold_out, self.world)

    def finish(self, context, notes):
        for note in notes:
            self.warn(note)
        context.scene.fastgs.training.capture = self._out
        if self.train:
            try:
                bpy.ops.fastgs.train('INVOKE_DEFAULT' if self.in_window else 'EXEC_DEFAULT', source='FOLDER', capture=self._out,
                                     start_frame=self.frame_start, hide_originals=context.scene.fastgs.training.hide_originals)
            except RuntimeError as error:  # the capture is there all the same
                self.fail(str(error).strip().removeprefix("Error: "))
        return f"The capture is in {self._out}; it took {time.monotonic() - self._began:.0f} s"
