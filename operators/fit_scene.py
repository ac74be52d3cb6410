# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits the scene to a capture: its range and rate; and all that an import into a new scene sets up, where the scene is not new."""
from __future__ import annotations

import bpy

from ..scene.cameras.from_view import stand_in_view
from ..scene.frame_range import fit_scene
from ..scene.objects import is_splat


def _on_splats(cls, context, possible) -> bool:
    obj = context.object
    if obj is None or not is_splat(obj) or not possible(obj):
        cls.poll_message_set("Select an object that shows splats")
        return False
    return True


class FASTGS_OT_fit_scene(bpy.types.Operator):
    """Set the scene's first and last frame and its frame rate from the active object's capture"""

    bl_idname = "fastgs.fit_scene"
    bl_label = "Fit Scene to Capture"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return _on_splats(cls, context, lambda obj: obj.fastgs.frame_count > 1)

    def execute(self, context):
        fit_scene(context.scene, context.object)
        return {'FINISHED'}


class FASTGS_OT_set_up_scene(bpy.types.Operator):
    """Give the scene the capture's range and frame rate, render with FAST-GS, and let a new camera see what the 3D view shows"""

    bl_idname = "fastgs.set_up_scene"
    bl_label = "Set Up Scene"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return _on_splats(cls, context, lambda obj: True)

    def execute(self, context):
        scene, obj = context.scene, context.object
        fit_scene(scene, obj)
        scene.render.engine = 'FASTGS'
        stand_in_view(context, [obj])
        return {'FINISHED'}


def offer_set_up(context, operator) -> None:
    """After an import by a user into a scene that is in use, and was left as it is: one click sets it up."""
    chosen = operator.set_scene_range, operator.use_engine, operator.camera
    if bpy.app.background or all(chosen) or not operator.options.is_invoke or operator.options.is_repeat:
        return

    def draw(menu, _):
        menu.layout.label(text="The scene keeps its range, its frame rate, its engine and its camera.")
        menu.layout.operator("fastgs.set_up_scene", icon='SCENE_DATA')

    context.window_manager.popup_menu(draw, title="4D Gaussians Imported", icon='INFO')


CLASSES = (FASTGS_OT_fit_scene, FASTGS_OT_set_up_scene)
