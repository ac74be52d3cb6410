# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools in the 3D view's toolbar that erase splats: a round brush, a lasso and a box."""
from __future__ import annotations

import bpy
from gpu_extras.presets import draw_circle_2d

from ..scene import objects

RADIUS = "scene.fastgs.eraser_radius"


def _strokes(shape: str) -> tuple:
    """What the left button does in a tool: it hides; with Shift or Ctrl it shows again."""
    strokes = [("fastgs.brush", {"type": 'LEFTMOUSE', "value": 'PRESS'}, {"properties": [("shape", shape)]})]
    strokes += [("fastgs.brush", {"type": 'LEFTMOUSE', "value": 'PRESS', key: True}, {"properties": [("shape", shape), ("show", True)]})
                for key in ("shift", "ctrl")]
    return tuple(strokes)


class _Tool:
    bl_space_type = 'VIEW_3D'
    bl_context_mode = 'OBJECT'

    @staticmethod
    def draw_settings(context, layout, tool):
        if context.object is None or not objects.is_splat(context.object):
            layout.label(text="Select a splat object first", icon='INFO')
            return
        if tool.idname == FASTGS_eraser.bl_idname:
            layout.prop(context.scene.fastgs, "eraser_radius")
        layout.operator("fastgs.show_hidden", icon='HIDE_OFF')
        layout.operator("fastgs.invert_hidden", icon='ARROW_LEFTRIGHT')


class FASTGS_eraser(_Tool, bpy.types.WorkSpaceTool):
    bl_idname = "fastgs.eraser"
    bl_label = "Erase Splats"
    bl_description = ("Hide Gaussians of the active object under a brush.\n"
                      "Shift or Ctrl shows them again; F or [ ] sets the size")
    bl_icon = "brush.gpencil_draw.erase"
    bl_cursor = 'CROSSHAIR'
    bl_keymap = (
        *_strokes('CIRCLE'),
        ("wm.radial_control", {"type": 'F', "value": 'PRESS'}, {"properties": [("data_path_primary", RADIUS)]}),
        *(("wm.context_scale_float", {"type": key, "value": 'PRESS', "repeat": True},
           {"properties": [("data_path", RADIUS), ("value", share)]})
          for key, share in (('LEFT_BRACKET', 0.87), ('RIGHT_BRACKET', 1.15))),
    )

    @staticmethod
    def draw_cursor(context, tool, xy):
        if hasattr(context.scene, "fastgs"):  # Blender calls this until another tool is chosen, even without the extension
            draw_circle_2d(xy, (1.0, 1.0, 1.0, 1.0), context.scene.fastgs.eraser_radius, segments=48)


class FASTGS_lasso_eraser(_Tool, bpy.types.WorkSpaceTool):
    bl_idname = "fastgs.lasso_eraser"
    bl_label = "Lasso Erase Splats"
    bl_description = "Hide Gaussians of the active object around which a line is drawn.\nShift or Ctrl shows them again"
    bl_icon = "ops.sculpt.lasso_hide"
    bl_cursor = 'CROSSHAIR'
    bl_keymap = _strokes('LASSO')


class FASTGS_box_eraser(_Tool, bpy.types.WorkSpaceTool):
    bl_idname = "fastgs.box_eraser"
    bl_label = "Box Erase Splats"
    bl_description = "Hide Gaussians of the active object in a box.\nShift or Ctrl shows them again"
    bl_icon = "ops.sculpt.border_hide"
    bl_cursor = 'CROSSHAIR'
    bl_keymap = _strokes('BOX')


TOOLS = (FASTGS_eraser, FASTGS_lasso_eraser, FASTGS_box_eraser)


def _known() -> bool:
    """Whether there are key maps for tools; a Blender in background has none, and no toolbar."""
    return bpy.context.window_manager.keyconfigs.addon is not None


def register():
    if _known():
        for number, tool in enumerate(TOOLS):
            bpy.utils.register_tool(tool, after={TOOLS[number - 1].bl_idname} if number else None, separator=not number)


def unregister():
    if _known():
        for tool in reversed(TOOLS):
            bpy.utils.unregister_tool(tool)
