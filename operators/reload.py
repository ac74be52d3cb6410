# SPDX-License-Identifier: GPL-3.0-or-later
"""Reload: reads the files of splat objects again."""
from __future__ import annotations

import bpy

from ..fastgs_blender.util.errors import FastGSError
from ..scene import objects
from ..scene.splats.splat_object import refresh
from .action import SPLATS, Action, Need


def _targets(context) -> list[bpy.types.Object]:
    return [obj for obj in dict.fromkeys([context.object, *context.selected_objects]) if objects.is_splat(obj)]


class FASTGS_OT_reload(Action, bpy.types.Operator):
    """Read the files of the active and the selected objects again"""

    bl_idname = "fastgs.reload"
    bl_label = "Reload"
    needs = (Need(lambda context: bool(_targets(context)), SPLATS.reason),)

    def execute(self, context):
        targets = _targets(context)
        for path in {objects.abspath(obj) for obj in targets}:
            objects.reload(path)
        errors = []
        for obj in targets:
            try:
                refresh(obj)
            except FastGSError as error:
                errors.append(str(error))
        for error in dict.fromkeys(errors):
            self.fail(error)
        return {'FINISHED'} if len(errors) < len(targets) else {'CANCELLED'}
