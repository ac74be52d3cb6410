# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: test the GPUs, and choose one."""
import bpy

from ..fastgs_blender.util.errors import FastGSError
from ..scene import devices, settings
from .action import Action, Need


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
