# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds how far the clocks of a capture's cameras are from each other, in a process that Blender watches."""
from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..fastgs_blender.jobs.sync import Sync
from ..fastgs_blender.util.errors import FastGSError
from ..scene.settings import BLEND_RELATIVE
from ..scene.splats.splat_object import sentence
from ..scene.training import installation, watch


class FASTGS_OT_sync_cameras(bpy.types.Operator):
    """Find how far the clocks of the capture's cameras are apart, from sound, a flash or motion, for training to use. Esc ends it"""

    bl_idname = "fastgs.sync_cameras"
    bl_label = "Sync Cameras"

    capture: StringProperty(name="Capture", description="The capture's folder; by default the panel's", subtype='DIR_PATH',
                            options={'SKIP_SAVE'} | BLEND_RELATIVE)

    def invoke(self, context, event):
        try:
            self._work = self._begun(context)
        except FastGSError as error:
            return self._fail(error)
        self._timer = context.window_manager.event_timer_add(0.5, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type == 'ESC' and event.value == 'PRESS':
            self.cancel(context)
            self.report({'INFO'}, "The clocks were not compared to the end; nothing was written")
            return {'CANCELLED'}
        if event.type != 'TIMER':
            return {'PASS_THROUGH'}
        if self._work.running:
            context.workspace.status_text_set(f"Sync Cameras: {self._work.doing}; Esc ends it")
            return {'PASS_THROUGH'}
        self._clean(context)
        return self._report()

    def cancel(self, context):
        self._work.end()
        self._clean(context)

    def execute(self, context):
        try:
            self._work = self._begun(context)
        except FastGSError as error:
            return self._fail(error)
        try:
            self._work.wait()
        except KeyboardInterrupt:
            self._work.end()
            raise
        return self._report()

    def _clean(self, context):
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        watch.redraw()

    def _begun(self, context) -> Sync:
        capture = bpy.path.abspath(self.capture or context.scene.fastgs.training.capture).rstrip("/\\")
        if not capture:
            raise FastGSError("no capture is chosen; choose its folder.")
        if not Path(capture).exists():
            raise FastGSError(f"{capture}: there is no such capture; check the folder.")
        return Sync(installation.python(), capture)

    def _report(self):
        """Report the result, and keep it as a text."""
        try:
            found = self._work.result()
        except FastGSError as error:
            return self._fail(error)
        name = f"Clocks of {Path(found.capture).name}"
        text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
        text.from_string(found.text)
        if found.lost:
            self.report({'WARNING'}, f"The clocks of {', '.join(found.lost)} could not be found and are taken as right")
        self.report({'INFO'}, f"{found.summary}. The text \"{text.name}\" tells more")
        return {'FINISHED'}

    def _fail(self, error):
        self.report({'ERROR'}, sentence(error))
        return {'CANCELLED'}


CLASSES = (FASTGS_OT_sync_cameras,)
