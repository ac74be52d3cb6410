# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits the scene to a capture: its range and rate; and all that an import into a new scene sets up, where the scene is not new."""
import bpy

from ..scene.cameras.from_view import stand_in_view
from ..scene.frame_range import fit_scene
from .action import SPLATS, Action, Need


class FASTGS_OT_fit_scene(Action, bpy.types.Operator):
    """Set the scene's first and last frame and its frame rate from the active object's capture"""

    bl_idname = "fastgs.fit_scene"
    bl_label = "Fit Scene to Capture"
    needs = (SPLATS, Need(lambda context: context.object.fastgs.frame_count > 1, "A still has no clip"))

    def act(self, context):
        fit_scene(context.scene, context.object)


class FASTGS_OT_set_up_scene(Action, bpy.types.Operator):
    """Give the scene the capture's range and frame rate, render with FAST-GS, and let a new camera see what the 3D view shows"""

    bl_idname = "fastgs.set_up_scene"
    bl_label = "Set Up Scene"
    needs = (SPLATS,)

    def act(self, context):
        scene, obj = context.scene, context.object
        fit_scene(scene, obj)
        scene.render.engine = 'FASTGS'
        stand_in_view(context, [obj])


def offer_set_up(context, operator) -> None:
    """After an import by a user into a scene that is in use, and was left as it is: one click sets it up."""
    chosen = operator.set_scene_range, operator.use_engine, operator.camera
    if bpy.app.background or all(chosen) or not operator.options.is_invoke or operator.options.is_repeat:
        return

    def draw(menu, _):
        menu.layout.label(text="The scene keeps its range, its frame rate, its engine and its camera.")
        menu.layout.operator("fastgs.set_up_scene", icon='SCENE_DATA')

    context.window_manager.popup_menu(draw, title="4D Gaussians Imported", icon='INFO')
