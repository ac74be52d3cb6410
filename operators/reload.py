# SPDX-License-Identifier: GPL-3.0-or-later
"""Reload: reads the files of splat objects again."""
import bpy

from ..fastgs_blender.util.errors import FastGSError
from ..scene import carrying, objects
from ..scene.splats.splat_object import refresh
from .action import SPLATS, Action, Need


def _targets(context) -> list[bpy.types.Object]:
    return [obj for obj in dict.fromkeys([context.object, *context.selected_objects]) if objects.is_splat(obj)]


class FASTGS_OT_reload(Action, bpy.types.Operator):
    """Read the files of the active and the selected objects again; parts and erasing are carried over to a retrained one"""

    bl_idname = "fastgs.reload"
    bl_label = "Reload"
    needs = (Need(lambda context: bool(_targets(context)), SPLATS.reason),)

    def execute(self, context):
        targets, errors = _targets(context), []
        for path in sorted({objects.abspath(obj) for obj in targets}):
            earlier = objects.earlier(path)
            objects.reload(path)
            try:
                for text in carrying.carry(path, earlier):
                    self.warn(text)
            except FastGSError as error:
                errors.append(str(error))
        targets += [obj for obj in bpy.data.objects if carrying.follows(obj, targets)]
        for obj in targets:
            try:
                refresh(obj)
            except FastGSError as error:
                errors.append(str(error))
        for error in dict.fromkeys(errors):
            self.fail(error)
        return {'FINISHED'} if any(objects.error_of(obj) is None for obj in targets) else {'CANCELLED'}
