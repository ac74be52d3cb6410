# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work of an operator in steps: with a window Blender shows its progress and Esc ends it, without one it runs to its end."""
from __future__ import annotations

import bpy

from ..fastgs_blender.errors import FastGSError
from .splat_object import sentence


class Stepwise:
    """For operators: the work is a generator of (done, whole), and what it returns goes to finish().

    invoke() of the class must set `_interactive`; a call from a script, or a repetition with other values, blocks.
    """

    doing = "Working"

    def finish(self, context, result) -> set:
        """What is left when all steps are done; returns what execute() is to return."""
        raise NotImplementedError

    def begin(self, context, steps) -> set:
        """Do the steps, or let them be done; returns what execute() is to return."""
        self._steps, self._timer = steps, None
        interactive, self._interactive = getattr(self, "_interactive", False) and not bpy.app.background, False
        context.window_manager.progress_begin(0, 100)
        try:
            done = self._advance(context)
            while not done and not interactive:
                done = self._advance(context)
        except FastGSError as error:
            self._close(context)
            return self._fail(error)
        except BaseException:
            self._close(context)
            raise
        if done:
            self._close(context)
            return self.finish(context, self._result)
        self._timer = context.window_manager.event_timer_add(0.05, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type == 'ESC':
            self._close(context)
            self.report({'INFO'}, f"{self.doing} was interrupted; what is done is kept, and the next time goes on from there")
            return {'CANCELLED'}
        if event.type != 'TIMER':
            return {'RUNNING_MODAL'}
        try:
            if not self._advance(context):
                return {'RUNNING_MODAL'}
        except FastGSError as error:
            self._close(context)
            return self._fail(error)
        except BaseException:
            self._close(context)
            raise
        self._close(context)
        return self.finish(context, self._result)

    def cancel(self, context):
        self._close(context)

    def _advance(self, context) -> bool:
        try:
            done, whole = next(self._steps)
        except StopIteration as end:
            self._result = end.value
            return True
        context.window_manager.progress_update(100 * done / max(whole, 1))
        if not bpy.app.background and context.workspace:
            context.workspace.status_text_set(f"{self.doing}: {done} of {whole}   (Esc interrupts)")
        return False

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

    def _fail(self, error):
        self.report({'ERROR'}, sentence(error))
        return {'CANCELLED'}
