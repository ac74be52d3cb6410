# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush: hides Gaussians of the active object under a circle or a box in the 3D view, at all times and depths."""
from __future__ import annotations

import math

import bpy
import gpu
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty
from gpu_extras.batch import batch_for_shader

from ..engine.viewport.eye import eye
from ..fastgs_blender.rendering.brush import Box, Stroke
from ..fastgs_blender.util.errors import FastGSError
from ..scene import brush, objects
from ..scene.splats.splat_object import sentence

HELP = "Drag: hide   Shift drag: show   C / B: circle or box   Wheel, [ ]: size of the circle   Middle button: turn the view   Esc: done"
COLOUR = (1.0, 1.0, 1.0, 0.9)


def _editable(context) -> bool:
    return context.object is not None and objects.is_splat(context.object) and context.object.is_editable


class FASTGS_OT_brush(bpy.types.Operator):
    """Hide Gaussians of the active object with a circle or a box in the 3D view, at all times and depths. The file stays as it is"""

    bl_idname = "fastgs.brush"
    bl_label = "Brush"
    bl_options = {'UNDO'}

    shape: EnumProperty(
        name="Shape", description="What is drawn",
        items=(
            ('CIRCLE', "Circle", "A round brush that is dragged over the Gaussians", 0),
            ('BOX', "Box", "A rectangle", 1),
        ), default='CIRCLE')
    radius: FloatProperty(
        name="Radius", description="Radius of the circle, in pixels", default=40.0, min=1.0, max=2000.0, subtype='PIXEL')
    show: BoolProperty(name="Show", description="Show again what was hidden, instead of hiding", options={'SKIP_SAVE'})
    path: CollectionProperty(
        name="Path", description="Where the brush went, in pixels of the region from its lower left; of a box two corners",
        type=bpy.types.OperatorMousePath, options={'SKIP_SAVE'})

    @classmethod
    def poll(cls, context):
        if not _editable(context):
            cls.poll_message_set("Select an object that shows splats")
            return False
        return True

    def execute(self, context):
        region, view = context.region, context.region_data
        if view is None:
            self.report({'ERROR'}, "The brush works in a 3D view alone; call it with one as context")
            return {'CANCELLED'}
        camera, _ = eye(region.width, region.height, view.view_matrix, view.window_matrix)
        points = [(point.loc[0], region.height - point.loc[1]) for point in self.path]
        if not points:
            return {'CANCELLED'}
        if self.shape == 'BOX':
            x, y = zip(points[0], points[-1], strict=True)
            shape = Box((min(x), min(y)), (max(x), max(y)))
        else:
            shape = Stroke(tuple(points), self.radius)
        try:
            count = brush.brush(context.object, context.evaluated_depsgraph_get(), camera, shape, not self.show)
        except FastGSError as error:
            self.report({'ERROR'}, sentence(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f"{count:,} Gaussians {'shown' if self.show else 'hidden'}")
        return {'FINISHED'}

    def invoke(self, context, event):
        if context.region_data is None:
            return self.execute(context)
        self._mouse, self._down = (event.mouse_region_x, event.mouse_region_y), False
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (context.region,), 'WINDOW', 'POST_PIXEL')
        context.workspace.status_text_set(HELP)
        context.window_manager.modal_handler_add(self)
        context.area.tag_redraw()
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        self._mouse = event.mouse_region_x, event.mouse_region_y
        context.area.tag_redraw()
        if event.type in {'ESC', 'RIGHTMOUSE', 'RET'} and event.value == 'PRESS':
            self.cancel(context)
            return {'CANCELLED'}  # each stroke is an undo step of its own
        if event.type == 'LEFTMOUSE' and event.value == 'PRESS':
            region = context.region
            if not (0 <= self._mouse[0] < region.width and 0 <= self._mouse[1] < region.height):
                return {'PASS_THROUGH'}
            self._down, self.show = True, event.shift
            self.path.clear()
            self.path.add().loc = self._mouse
        elif event.type == 'MOUSEMOVE' and self._down:
            self.path.add().loc = self._mouse
        elif event.type == 'LEFTMOUSE' and event.value == 'RELEASE' and self._down:
            self._down = False
            self.path.add().loc = self._mouse
            if self.execute(context) == {'FINISHED'}:
                bpy.ops.ed.undo_push(message="Show Gaussians" if self.show else "Hide Gaussians")
            self.path.clear()
        elif event.value == 'PRESS' and event.type in {'B', 'C'}:
            self.shape = 'BOX' if event.type == 'B' else 'CIRCLE'
        elif event.value == 'PRESS' and event.type in {'WHEELUPMOUSE', 'RIGHT_BRACKET', 'WHEELDOWNMOUSE', 'LEFT_BRACKET'}:
            self.radius *= 1.15 if event.type in {'WHEELUPMOUSE', 'RIGHT_BRACKET'} else 1 / 1.15
        elif event.type in {'MIDDLEMOUSE', 'TRACKPADPAN', 'TRACKPADZOOM'} or event.type.startswith("NUMPAD"):
            return {'PASS_THROUGH'}
        return {'RUNNING_MODAL'}

    def cancel(self, context):
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, 'WINDOW')
        context.workspace.status_text_set(None)
        if context.area:
            context.area.tag_redraw()

    def _draw(self, region):
        if bpy.context.region != region:
            return
        x, y = self._mouse
        if self.shape == 'CIRCLE':
            angles = [2 * math.pi * k / 48 for k in range(49)]
            points = [(x + self.radius * math.cos(a), y + self.radius * math.sin(a)) for a in angles]
        elif self._down:
            left, bottom = self.path[0].loc
            points = [(left, bottom), (x, bottom), (x, y), (left, y), (left, bottom)]
        else:
            points = [(x - 12, y), (x + 12, y), (x, y), (x, y + 12), (x, y - 12)]
        shader = gpu.shader.from_builtin('UNIFORM_COLOR')
        shader.bind()
        shader.uniform_float("color", COLOUR)
        batch_for_shader(shader, 'LINE_STRIP', {"pos": points}).draw(shader)


class _OnMask:
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context):
        return _editable(context) and bool(context.object.fastgs.mask)

    def execute(self, context):
        try:
            self.change(context.object)
        except FastGSError as error:
            self.report({'ERROR'}, sentence(error))
            return {'CANCELLED'}
        return {'FINISHED'}


class FASTGS_OT_show_hidden(_OnMask, bpy.types.Operator):
    """Show all Gaussians of the active object that the brush has hidden"""

    bl_idname = "fastgs.show_hidden"
    bl_label = "Show All"

    def change(self, obj):
        obj.fastgs.mask = ""


class FASTGS_OT_invert_hidden(_OnMask, bpy.types.Operator):
    """Hide what the brush has left of the active object, and show what it has hidden"""

    bl_idname = "fastgs.invert_hidden"
    bl_label = "Invert"

    def change(self, obj):
        brush.set_mask(obj, ~brush.mask_of(obj))


CLASSES = (FASTGS_OT_brush, FASTGS_OT_show_hidden, FASTGS_OT_invert_hidden)
