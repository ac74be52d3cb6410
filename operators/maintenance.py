# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: compile and clear the renderer's kernels, open the guide, copy diagnostics."""
import bpy

from ..engine import compiling, diagnostics
from ..fastgs_blender.kernels.cpu import cache
from ..fastgs_blender.util.errors import FastGSError
from ..scene import pages
from .action import Action, Need


class FASTGS_OT_compile_kernels(Action, bpy.types.Operator):
    """Compile the renderer for this machine now, in the background"""

    bl_idname = "fastgs.compile_kernels"
    bl_label = "Compile Now"
    bl_options = {'REGISTER'}
    needs = (Need(lambda context: compiling.has_numba(), "numba is not installed"),
             Need(lambda context: not compiling.is_running(), "It is being compiled"))

    def act(self, context):
        if cache.is_filled():
            return "The renderer is compiled already"
        if not compiling.start():
            raise FastGSError("the renderer could not be compiled; the log has the reason")
        if bpy.app.background and not compiling.wait():
            raise FastGSError("compiling the renderer failed")
        return None


class FASTGS_OT_clear_kernels(Action, bpy.types.Operator):
    """Delete the compiled renderer; it is compiled again when it is needed"""

    bl_idname = "fastgs.clear_kernels"
    bl_label = "Clear"
    bl_options = {'REGISTER'}

    def act(self, context):
        compiling.stop()
        freed = cache.size()
        cache.clear()
        return f"Freed {freed / 1e6:.1f} MB"


class FASTGS_OT_copy_diagnostics(Action, bpy.types.Operator):
    """Put versions, graphics card, renderer and recent messages on the clipboard, for a report of a problem"""

    bl_idname = "fastgs.copy_diagnostics"
    bl_label = "Copy Diagnostics"
    bl_options = {'REGISTER'}

    def act(self, context):
        context.window_manager.clipboard = diagnostics.text()
        return "Diagnostics are on the clipboard"


class FASTGS_OT_open_guide(Action, bpy.types.Operator):
    """Open the user guide that comes with the extension"""

    bl_idname = "fastgs.open_guide"
    bl_label = "User Guide"
    bl_options = {'REGISTER'}

    def act(self, context):
        guide = pages.path("guide")
        try:
            bpy.ops.wm.path_open(filepath=str(guide))
        except RuntimeError as error:  # nothing on this machine opens such files
            raise FastGSError(f"{guide} could not be opened ({str(error).strip()}); open it yourself") from error
