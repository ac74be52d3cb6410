# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that makes a training Python: what it needs is downloaded.  The zip for Blender's store goes without this module."""
import bpy
from bpy.props import BoolProperty

from ..fastgs_blender.jobs import maker as making
from ..fastgs_blender.util.errors import FastGSError
from ..scene import notices, settings
from ..scene.training import installation
from .action import Need
from .stepwise import PAUSE, Stepwise


def offline_reason() -> str:
    """Why nothing may be downloaded; "" where it may."""
    if bpy.app.online_access:
        return ""
    if bpy.app.online_access_override:
        return "Blender was started without access to the internet; start it with --online-mode"
    return "Allow Online Access in the system preferences first"


class FASTGS_OT_make_training_python(Stepwise, bpy.types.Operator):
    """Make a Python environment for training in the extension's folder, with all that training can use; it is downloaded"""

    bl_idname = "fastgs.make_training_python"
    bl_label = "Make an Environment"
    needs = (Need(lambda context: not installation.is_making(), "An environment is being made"),)
    doing, free, interrupted = "Making an environment", True, "{} was interrupted"

    torch: BoolProperty(
        name="PyTorch", default=False, description="Also PyTorch, for scripts and for training in several processes; nothing in Blender "
        "needs it. Its small build for processors, where the package index offers one")

    @classmethod
    def poll(cls, context):
        if offline_reason():
            cls.poll_message_set(offline_reason())
        return not offline_reason() and super().poll(context)

    def invoke(self, context, event):
        self._interactive = True
        return context.window_manager.invoke_props_dialog(self, width=480)

    def draw(self, context):
        col = self.layout.column(align=True)
        col.label(text="numba, PyAV, pycolmap and what they need", icon='IMPORT')
        col.label(text=f"will be downloaded from the Python Package Index: {making.SIZE}.")
        col.label(text=f"They go into {installation.made_environment()}")
        col.prop(self, "torch", text=f"PyTorch, too: {making.TORCH_SIZE}")

    def steps(self, context):
        preferences, folder = settings.preferences(), installation.made_environment()
        index = preferences.package_index if preferences else ""
        maker = installation.maker = making.Maker(folder, folder.with_name("environment.log"), index, self.torch)
        try:
            while maker.poll():
                maker.wait(PAUSE)
                yield 0, 1, maker.last_line
        finally:
            maker.stop()
        if maker.failed:
            raise FastGSError(f"the environment could not be made ({maker.last_line}); {maker.log} tells more.")

    def finish(self, context, result):
        notices.redraw('PREFERENCES', 'VIEW_3D')
        return "The environment for training is ready"
