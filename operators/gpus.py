# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: test the GPUs, and choose one."""
from __future__ import annotations

import bpy

from ..scene import devices, settings


class FASTGS_OT_test_gpus(bpy.types.Operator):
    """Compare small pictures and gradients of each GPU with the processor's, and take the time of both. Blender stays usable meanwhile"""

    bl_idname = "fastgs.test_gpus"
    bl_label = "Test"

    @classmethod
    def poll(cls, context):
        if devices.line():
            cls.poll_message_set("They are being tested")
        return not devices.line()

    def execute(self, context):
        running = devices.test()
        if bpy.app.background:
            running.wait()
            devices.look()
            if running.trouble:
                self.report({'ERROR'}, running.trouble)
                return {'CANCELLED'}
        return {'FINISHED'}


class FASTGS_OT_use_gpu(bpy.types.Operator):
    """Let scenes whose device is GPU use this one"""

    bl_idname = "fastgs.use_gpu"
    bl_label = "Use This GPU"

    name: bpy.props.StringProperty(name="Name", description="Of the GPU; empty for one that is faster than the processor")

    @classmethod
    def poll(cls, context):
        return settings.preferences() is not None

    def execute(self, context):
        settings.preferences().gpu = self.name
        return {'FINISHED'}


CLASSES = (FASTGS_OT_test_gpus, FASTGS_OT_use_gpu)
