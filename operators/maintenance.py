# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: compile and clear the renderer's kernels, open the guide, copy diagnostics."""
from __future__ import annotations

import bpy

from ..engine import compiling, diagnostics
from ..fastgs_blender.kernels.cpu import cache
from ..scene import pages


class FASTGS_OT_compile_kernels(bpy.types.Operator):
    """Compile the renderer for this machine now, in the background"""

    bl_idname = "fastgs.compile_kernels"
    bl_label = "Compile Now"

    @classmethod
    def poll(cls, context):
        if not compiling.has_numba():
            cls.poll_message_set("numba is not installed")
        return compiling.has_numba() and not compiling.is_running()

    def execute(self, context):
        if cache.is_filled():
            self.report({'INFO'}, "The renderer is compiled already")
        elif not compiling.start():
            self.report({'ERROR'}, "The renderer could not be compiled; the log has the reason")
            return {'CANCELLED'}
        elif bpy.app.background and not compiling.wait():
            self.report({'ERROR'}, "Compiling the renderer failed")
            return {'CANCELLED'}
        return {'FINISHED'}


class FASTGS_OT_clear_kernels(bpy.types.Operator):
    """Delete the compiled renderer; it is compiled again when it is needed"""

    bl_idname = "fastgs.clear_kernels"
    bl_label = "Clear"

    def execute(self, context):
        compiling.stop()
        freed = cache.size()
        cache.clear()
        self.report({'INFO'}, f"Freed {freed / 1e6:.1f} MB")
        return {'FINISHED'}


class FASTGS_OT_copy_diagnostics(bpy.types.Operator):
    """Put versions, graphics card, renderer and recent messages on the clipboard, for a report of a problem"""

    bl_idname = "fastgs.copy_diagnostics"
    bl_label = "Copy Diagnostics"

    def execute(self, context):
        context.window_manager.clipboard = diagnostics.text()
        self.report({'INFO'}, "Diagnostics are on the clipboard")
        return {'FINISHED'}


class FASTGS_OT_open_guide(bpy.types.Operator):
    """Open the user guide that comes with the extension"""

    bl_idname = "fastgs.open_guide"
    bl_label = "User Guide"

    def execute(self, context):
        guide = pages.path("guide")
        try:
            bpy.ops.wm.path_open(filepath=str(guide))
        except RuntimeError as error:  # nothing on this machine opens such files
            self.report({'ERROR'}, f"{guide} could not be opened ({str(error).strip()}); open it yourself")
            return {'CANCELLED'}
        return {'FINISHED'}


CLASSES = (FASTGS_OT_compile_kernels, FASTGS_OT_clear_kernels, FASTGS_OT_copy_diagnostics, FASTGS_OT_open_guide)
