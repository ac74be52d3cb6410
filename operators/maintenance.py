# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: GPUs, the training Python, the compiled kernels, the guide, diagnostics."""
import bpy

from ..engine import compiling, diagnostics
from ..fastgs_blender.jobs import environment as pythons
from ..fastgs_blender.kernels.cpu import cache
from ..fastgs_blender.util.errors import FastGSError
from ..scene import devices, pages, settings
from ..scene.training import installation, watch
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


class FASTGS_OT_test_gpus(Action, bpy.types.Operator):
    """Compare small pictures and gradients of each GPU with the processor's, and take the time of both. Blender stays usable meanwhile"""

    bl_idname = "fastgs.test_gpus"
    bl_label = "Test"
    bl_options = {'REGISTER'}
    needs = (Need(lambda context: not devices.line(), "They are being tested"),)

    def act(self, context):
        running = devices.test()
        if bpy.app.background:
            running.wait()
            devices.refresh()
            if running.trouble:
                raise FastGSError(running.trouble)


class FASTGS_OT_use_gpu(Action, bpy.types.Operator):
    """Let scenes whose device is GPU use this one"""

    bl_idname = "fastgs.use_gpu"
    bl_label = "Use This GPU"
    bl_options = {'REGISTER'}
    needs = (Need(lambda context: settings.preferences() is not None, "The extension is not enabled"),)

    name: bpy.props.StringProperty(name="Name", description="Of the GPU; empty for one that is faster than the processor")

    def act(self, context):
        settings.preferences().gpu = self.name


class FASTGS_OT_test_training_python(Action, bpy.types.Operator):
    """Try whether the training Python has all that training needs, and say what is missing"""

    bl_idname = "fastgs.test_training_python"
    bl_label = "Test"
    bl_options = {'REGISTER'}

    def act(self, context):
        python = installation.python()
        report = installation.tested[python] = pythons.inspect(python)
        watch.redraw()
        if not report.ready:
            raise FastGSError(report.sentence)
        return report.sentence
