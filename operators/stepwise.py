# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs long work of an operator in steps: with a window Blender shows progress and Esc ends it; without one it blocks."""
import math
import sys
import time
from collections.abc import Generator

import bpy

from ..fastgs_blender.util.errors import FastGSError
from ..fastgs_blender.util.screen import tell
from .action import Action

VIEW = ({'MOUSEMOVE', 'INBETWEEN_MOUSEMOVE', 'MIDDLEMOUSE', 'WHEELUPMOUSE', 'WHEELDOWNMOUSE', 'TRACKPADPAN', 'TRACKPADZOOM',
         'NDOF_MOTION', 'HOME', 'NUMPAD_PERIOD'} | {f"NUMPAD_{number}" for number in range(10)})
"""Events that turn and move the view."""
BUDGET = 0.1
"""Seconds of work between two looks at the keyboard."""
PAUSE = 0.05
"""Seconds between two looks at a process."""
REPORT_EVERY = 5.0
"""Seconds between two lines of progress without a window."""


class Stepwise(Action):
    """Base class of operators whose work is a generator, steps(); its return value goes to finish().

    The generator yields (done, total), perhaps with a third member, what is being done; or the share 0..1 that is done.

    An invoke() of the class's own must set `_interactive`; a call from a script, or a repetition with other values, blocks.
    """

    bl_options = {'REGISTER'}

    doing = "Working"
    free = False
    """Whether the scene may be edited during this work; otherwise the view alone can be turned."""
    interrupted = "{} was interrupted; finished parts are kept, and the next call continues from there"
    _interactive = False
    in_window = False
    """Whether Blender stays usable during this work; known from the first step on."""

    def steps(self, context) -> Generator:
        """The work.  Raises FastGSError."""
        raise NotImplementedError

    def finish(self, context, result) -> str | None:
        """Finish the work when all steps are done, and return what is reported.  Raises FastGSError."""
        raise NotImplementedError

    def invoke(self, context, event):
        self._interactive = True
        return self.execute(context)

    def execute(self, context):
        try:
            return self.begin(context, self.steps(context))
        except FastGSError as error:
            return self.fail(error)

    def begin(self, context, steps) -> set[str]:
        """Do all steps, or start a timer that does them; returns the result of execute()."""
        self._steps, self._timer, self._told = steps, None, time.monotonic()
        self.in_window, self._interactive = self._interactive and not bpy.app.background, False
        context.window_manager.progress_begin(0, 100)
        outcome = self._go_on(context, 0.0 if self.in_window else math.inf)  # errors at the start are reported at once
        if outcome is None:
            self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
            context.window_manager.modal_handler_add(self)
        return outcome or {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type == 'ESC':
            self._close(context)
            self.report({'INFO'}, self.interrupted.format(self.doing))
            return {'CANCELLED'}
        if event.type.startswith('TIMER'):  # others wait for theirs, such as panels that move; this work's own finds nobody else
            return self._go_on(context, BUDGET) or {'PASS_THROUGH'}
        if self.free or (event.type in VIEW and not event.ctrl and not event.alt):
            return {'PASS_THROUGH'}
        return {'RUNNING_MODAL'}  # nobody edits what is being worked on

    def cancel(self, context):
        self._close(context)

    def _go_on(self, context, seconds: float) -> set | None:
        """Do steps for this long, at least one; None while work is left."""
        until = time.monotonic() + seconds
        try:
            while True:
                step = next(self._steps)
                self._show(context, *((step, 1) if isinstance(step, float) else step))
                if time.monotonic() >= until:
                    return None
        except StopIteration as end:
            result = end.value
        except FastGSError as error:
            self._close(context)
            return self.fail(error)
        except BaseException:
            self._close(context)
            raise
        self._close(context)
        return self._ended(lambda: self.finish(context, result))

    def _show(self, context, done, total, stage=""):
        context.window_manager.progress_update(100 * done / max(total, 1))
        share = f"{done} of {total}" if total != 1 else f"{done:.0%}"
        text = ": ".join(filter(None, (self.doing, stage if stage != self.doing else "", share)))
        if not bpy.app.background and context.workspace:
            rest = "Esc interrupts" if self.free else "only the view can be turned; Esc interrupts"
            context.workspace.status_text_set(f"{text}   ({rest})" if self.in_window else text)
        if not self.in_window and time.monotonic() - self._told > REPORT_EVERY:
            self._told = time.monotonic()
            tell(f"FAST-GS: {text}", sys.stdout)

    def _close(self, context):
        if getattr(self, "_steps", None) is None:
            return
        self._steps.close()
        self._steps = None
        context.window_manager.progress_end()
        if not bpy.app.background and context.workspace:
            context.workspace.status_text_set(None)
        if self._timer:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None


def watched(command, progress):
    """Work for begin() that waits for a jobs.command.Command and returns its values; closing it ends the process.

    progress  () -> (what it is doing, the share of the whole that is done)
    """
    try:
        while not command.wait(PAUSE):
            stage, share = progress()
            yield share, 1, stage
    finally:
        command.stop()
    return command.result()
