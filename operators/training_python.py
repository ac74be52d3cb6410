# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that tests the training Python."""
import bpy

from ..fastgs_blender.jobs import environment as pythons
from ..fastgs_blender.util.errors import FastGSError
from ..scene.training import installation, watch
from .action import Action


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
