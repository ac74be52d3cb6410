# SPDX-License-Identifier: GPL-3.0-or-later
"""The tools in the 3D view's toolbar that select Gaussians, and those that erase them."""
import bpy
from gpu_extras.presets import draw_circle_2d

from ..scene import objects

RADIUS = "scene.fastgs.brush_radius"
ROUND = {'CIRCLE', 'BALL'}
"""Shapes with a radius."""


def _press(key: str, operator: str, modifier: str = "", **properties) -> tuple:
    """An entry of a tool's key map."""
    event = {"type": key, "value": 'PRESS'} | ({modifier: True} if modifier else {})
    return operator, event, {"properties": list(properties.items())}


KEYS = (
    _press('A', "fastgs.select_kind", kind='ALL'),
    _press('A', "fastgs.select_kind", "alt", kind='NONE'),
    _press('I', "fastgs.select_kind", "ctrl", kind='INVERSE'),
    _press('L', "fastgs.grow"),
    _press('P', "fastgs.separate"),
    _press('J', "fastgs.join_parts", "ctrl"),
    *(_press(key, "fastgs.erase") for key in ('X', 'DEL', 'H')),
    _press('H', "fastgs.show_hidden", "alt"),
    _press('E', "wm.context_toggle", data_path="window_manager.fastgs.show_erased"),
)
"""Of all tools, as Edit Mode has them; E shows what was erased."""
SIZE = (
    _press('F', "wm.radial_control", data_path_primary=RADIUS),
    *(("wm.context_scale_float", {"type": key, "value": 'PRESS', "repeat": True}, {"properties": [("data_path", RADIUS), ("value", share)]})
      for key, share in (('LEFT_BRACKET', 0.87), ('RIGHT_BRACKET', 1.15))),
)


def _strokes(shape: str, *ways: tuple[str, str]) -> tuple:
    """What the left button does in a tool: nothing held, with Shift, with Ctrl; each as (what, mode)."""
    return tuple(_press('LEFTMOUSE', "fastgs.select_gaussians", modifier, shape=shape, what=what, mode=mode)
                 for modifier, (what, mode) in zip(("", "shift", "ctrl"), ways, strict=True))


class _Tool:
    bl_space_type = 'VIEW_3D'
    bl_context_mode = 'OBJECT'
    bl_cursor = 'CROSSHAIR'

    @staticmethod
    def draw_settings(context, layout, tool):
        if context.object is None or not objects.is_splat(context.object):
            layout.label(text="Select a splat object first", icon='INFO')
            return
        shape = next(cls.shape for cls in TOOLS if cls.bl_idname == tool.idname)
        if shape in ROUND:
            layout.prop(context.scene.fastgs, "brush_radius")
        if tool.idname.startswith("fastgs.erase"):
            layout.prop(context.window_manager.fastgs, "show_erased")
            return
        if shape != 'CLICK':
            layout.prop(context.scene.fastgs, "select_through")
        layout.operator("fastgs.grow", icon='ZOOM_IN')
        layout.menu("FASTGS_MT_select", text="Select")


def _tool(shape: str, name: str, label: str, description: str, icon: str, erases: bool) -> type:
    """A tool of the toolbar."""
    ways = [('ERASE', 'SET'), ('RESTORE', 'SET'), ('RESTORE', 'SET')] if erases else [
        ('SELECT', 'SET'), ('SELECT', 'ADD'), ('SELECT', 'SUBTRACT')]
    round_ = shape in ROUND
    more = "Shift or Ctrl shows them again" if erases else "Shift adds, Ctrl takes away"
    members = {
        "bl_idname": f"fastgs.{'erase' if erases else 'select'}_{name}", "bl_label": label, "bl_icon": icon, "shape": shape,
        "bl_description": f"{description}.\n{more}{'; F or [ ] sets the size' if round_ else ''}",
        "bl_keymap": (*_strokes(shape, *ways), *KEYS, *(SIZE if round_ else ()))}
    if shape == 'CIRCLE':
        members["draw_cursor"] = staticmethod(_draw_radius)
    return type(f"FASTGS_{'erase' if erases else 'select'}_{name}", (_Tool, bpy.types.WorkSpaceTool), members)


def _draw_radius(context, tool, xy):
    if hasattr(context.scene, "fastgs"):  # Blender calls this until another tool is chosen, even without the extension
        draw_circle_2d(xy, (1.0, 1.0, 1.0, 1.0), context.scene.fastgs.brush_radius, segments=48)


SELECTING = (
    _tool('CLICK', "thing", "Select Splats: Thing", "Select what is clicked and all that belongs to it", "ops.generic.select", False),
    _tool('BOX', "box", "Select Splats: Box", "Select Gaussians of the active object in a box", "ops.generic.select_box", False),
    _tool('LASSO', "lasso", "Select Splats: Lasso", "Select Gaussians of the active object around which a line is drawn",
          "ops.generic.select_lasso", False),
    _tool('CIRCLE', "brush", "Select Splats: Brush", "Select Gaussians of the active object under a brush", "ops.generic.select_circle",
          False),
    _tool('BALL', "ball", "Select Splats: Sphere", "Select Gaussians of the active object in a ball around what is clicked",
          "ops.mesh.primitive_sphere_add_gizmo", False),
)
ERASING = (
    _tool('CIRCLE', "brush", "Erase Splats", "Hide Gaussians of the active object under a brush", "brush.gpencil_draw.erase", True),
    _tool('LASSO', "lasso", "Lasso Erase Splats", "Hide Gaussians of the active object around which a line is drawn",
          "ops.sculpt.lasso_hide", True),
    _tool('BOX', "box", "Box Erase Splats", "Hide Gaussians of the active object in a box", "ops.sculpt.border_hide", True),
)
TOOLS = (*SELECTING, *ERASING)


def _known() -> bool:
    """Whether there are key maps for tools; a Blender in background has none, and no toolbar."""
    return bpy.context.window_manager.keyconfigs.addon is not None


def register():
    if not _known():
        return
    for group in (SELECTING, ERASING):
        for number, tool in enumerate(group):
            first = not number
            bpy.utils.register_tool(tool, after=None if first else {group[number - 1].bl_idname}, separator=first and group is SELECTING,
                                    group=first)


def unregister():
    if _known():
        for tool in reversed(TOOLS):
            bpy.utils.unregister_tool(tool)
