# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on the training Python: test it, make one."""
from __future__ import annotations

import bpy
from bpy.props import BoolProperty

from ..fastgs_blender.jobs import environment as pythons
from ..fastgs_blender.util.errors import FastGSError
from ..scene import settings
from ..scene.splats.splat_object import sentence
from ..scene.training import installation, watch


def offline_reason() -> str:
    """Why nothing may be downloaded; "" where it may."""
    if bpy.app.online_access:
        return ""
    if bpy.app.online_access_override:
        return "Blender was started without access to the internet; start it with --online-mode"
    return "Allow Online Access in the system preferences first"


class FASTGS_OT_test_training_python(bpy.types.Operator):
    """Try whether the training Python has all that training needs, and say what is missing"""

    bl_idname = "fastgs.test_training_python"
    bl_label = "Test"

    def execute(self, context):
        try:
            python = installation.python()
            report = installation.tested[python] = pythons.inspect(python)
        except FastGSError as error:
            self.report({'ERROR'}, sentence(error))
            return {'CANCELLED'}
        watch.redraw()
        self.report({'INFO' if report.ready else 'ERROR'}, report.sentence)
        return {'FINISHED'} if report.ready else {'CANCELLED'}


class FASTGS_OT_make_training_python(bpy.types.Operator):
    """Make a Python environment for training in the extension's folder, with all that training can use; it is downloaded"""

    bl_idname = "fastgs.make_training_python"
    bl_label = "Make an Environment"

    torch: BoolProperty(
        name="PyTorch", default=False, description="Also PyTorch, for scripts and for training in several processes; nothing in Blender "
        "needs it. Its small build for processors, where the package index offers one")

    @classmethod
    def poll(cls, context):
        reason = offline_reason() or ("An environment is being made" if installation.is_making() else "")
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def invoke(self, context, event):
        return context.window_manager.invoke_props_dialog(self, width=480)

    def draw(self, context):
        col = self.layout.column(align=True)
        col.label(text="numba, PyAV, pycolmap and what they need", icon='IMPORT')
        col.label(text=f"will be downloaded from the Python Package Index: {pythons.SIZE}.")
        col.label(text=f"They go into {installation.made_environment()}")
        col.prop(self, "torch", text=f"PyTorch, too: {pythons.TORCH_SIZE}")

    def execute(self, context):
        preferences = settings.preferences()
        folder = installation.made_environment()
        index = preferences.package_index if preferences else ""
        installation.maker = pythons.Maker(folder, folder.with_name("environment.log"), index, self.torch)
        if bpy.app.background:
            while installation.maker.poll():
                installation.maker.wait(1.0)
            return self._end()
        context.window_manager.modal_handler_add(self)
        self._timer = context.window_manager.event_timer_add(1.0, window=context.window)
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type != 'TIMER' or (installation.maker and installation.maker.poll()):
            return {'PASS_THROUGH'}
        self.cancel(context)
        for area in context.screen.areas if context.screen else ():
            area.tag_redraw()
        return self._end()

    def cancel(self, context):
        context.window_manager.event_timer_remove(self._timer)

    def _end(self):
        maker = installation.maker
        if maker is None or maker.failed:
            said = f" ({maker.last_line})" if maker else ""
            self.report({'ERROR'}, f"The environment could not be made{said}; {maker.log if maker else 'the log'} tells more.")
            return {'CANCELLED'}
        self.report({'INFO'}, "The environment for training is ready")
        return {'FINISHED'}


CLASSES = (FASTGS_OT_test_training_python, FASTGS_OT_make_training_python)
