# SPDX-License-Identifier: GPL-3.0-or-later
"""Erases Gaussians of the active object in the 3D view: one stroke of a round brush, one lasso or one box, at all times and depths.

The tools of the toolbar (ui/tools.py) call this operator when the mouse button goes down; it ends when the button comes up.
"""
from __future__ import annotations

from itertools import pairwise

import bpy
import gpu
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from ..engine.viewport.eye import eye
from ..fastgs_blender.selecting.shapes import Box, Lasso, Stroke
from ..fastgs_blender.util.errors import FastGSError
from ..scene import brush
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action, Need

HIDES, SHOWS = (1.0, 0.45, 0.35, 0.35), (0.45, 0.8, 1.0, 0.35)
"""Colours of the trail of a brush."""
LINE = (1.0, 1.0, 1.0, 0.9)
NEAR = 2.0
"""Pixels that the mouse must move until the path gets another point."""


class FASTGS_OT_brush(Action, bpy.types.Operator):
    """Hide Gaussians of the active object under a brush, in a lasso or in a box, at all times and depths. The file stays as it is"""

    bl_idname = "fastgs.brush"
    bl_label = "Erase Splats"
    bl_options = {'UNDO'}
    needs = (OBJECT_MODE, EDITABLE_SPLATS)

    shape: EnumProperty(
        name="Shape", description="What is drawn",
        items=(
            ('CIRCLE', "Brush", "A round brush that is dragged over the Gaussians", 0),
            ('BOX', "Box", "A rectangle", 1),
            ('LASSO', "Lasso", "A line around the Gaussians", 2),
        ), default='CIRCLE')
    radius: FloatProperty(
        name="Radius", description="Radius of the brush, in pixels", default=40.0, min=1.0, max=2000.0, subtype='PIXEL')
    show: BoolProperty(name="Restore", description="Show again what was hidden, instead of hiding", options={'SKIP_SAVE'})
    path: CollectionProperty(
        name="Path", description="Where the mouse went, in pixels of the region from its lower left; of a box two corners",
        type=bpy.types.OperatorMousePath, options={'SKIP_SAVE'})

    def execute(self, context):
        region, view = context.region, context.region_data
        if view is None:
            return self.fail("splats are erased in a 3D view; call this with one as context")
        camera, _ = eye(region.width, region.height, view.view_matrix, view.window_matrix)
        points = [(point.loc[0], region.height - point.loc[1]) for point in self.path]
        if not points:
            return {'CANCELLED'}
        if self.shape == 'BOX':
            x, y = zip(points[0], points[-1], strict=True)
            shape = Box((min(x), min(y)), (max(x), max(y)))
        else:
            shape = Lasso(tuple(points)) if self.shape == 'LASSO' else Stroke(tuple(points), self.radius)
        try:
            count = brush.brush(context.object, context.evaluated_depsgraph_get(), camera, shape, not self.show)
        except FastGSError as error:
            return self.fail(error)
        self.report({'INFO'}, f"{count:,} Gaussians {'shown again' if self.show else 'hidden'}")
        return {'FINISHED'} if count else {'CANCELLED'}  # what changes nothing is no undo step

    def invoke(self, context, event):
        if context.region_data is None:
            return self.execute(context)
        self.radius = context.scene.fastgs.eraser_radius
        self.path.clear()
        self.path.add().loc = event.mouse_region_x, event.mouse_region_y
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (context.region,), 'WINDOW', 'POST_PIXEL')
        context.window_manager.modal_handler_add(self)
        context.area.tag_redraw()
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        mouse = event.mouse_region_x, event.mouse_region_y
        if event.type in {'MOUSEMOVE', 'INBETWEEN_MOUSEMOVE'} and (Vector(mouse) - Vector(self.path[-1].loc)).length >= NEAR:
            self.path.add().loc = mouse
            context.area.tag_redraw()
        elif event.type == 'LEFTMOUSE' and event.value == 'RELEASE':
            self.path.add().loc = mouse
            self.cancel(context)
            return self.execute(context)
        elif event.type in {'ESC', 'RIGHTMOUSE'} and event.value == 'PRESS':
            self.cancel(context)
            return {'CANCELLED'}
        return {'RUNNING_MODAL'}

    def cancel(self, context):
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, 'WINDOW')
        if context.area:
            context.area.tag_redraw()

    def _draw(self, region):
        if bpy.context.region != region:
            return
        points = [Vector(point.loc) for point in self.path]
        gpu.state.blend_set('ALPHA')
        if self.shape == 'CIRCLE':
            _draw_in(SHOWS if self.show else HIDES, 'TRI_STRIP', trail(points, self.radius))
        else:
            if self.shape == 'BOX':
                (left, bottom), (right, top) = points[0], points[-1]
                points = [(left, bottom), (right, bottom), (right, top), (left, top)]
            _draw_in(SHOWS if self.show else LINE, 'LINE_STRIP', [*points, points[0]])
        gpu.state.blend_set('NONE')


def trail(points: list[Vector], radius: float) -> list[tuple[float, float]]:
    """The corners of a strip of triangles that covers what a round brush went over, nearly: from its first place to its last."""
    points = [points[0], *(after for before, after in pairwise(points) if after != before)]
    ways = [after - before for before, after in pairwise(points)] or [Vector((1, 0))]
    corners = []

    def across(middle, way, ahead):
        half = (radius**2 - ahead**2) ** 0.5
        way = way.normalized()
        side = Vector((-way.y, way.x)) * half
        corners.extend((tuple(middle + way * ahead + side), tuple(middle + way * ahead - side)))

    steps = [radius * k / 8 for k in range(9)]
    for ahead in steps[:0:-1]:
        across(points[0], ways[0], -ahead)
    for number, point in enumerate(points):
        across(point, ways[max(number - 1, 0)] + ways[min(number, len(ways) - 1)], 0.0)
    for ahead in steps[1:]:
        across(points[-1], ways[-1], ahead)
    return corners


def _draw_in(colour, kind, points):
    shader = gpu.shader.from_builtin('UNIFORM_COLOR')
    shader.bind()
    shader.uniform_float("color", colour)
    batch_for_shader(shader, kind, {"pos": points}).draw(shader)


ERASED = Need(lambda context: EDITABLE_SPLATS.met(context) and bool(context.object.fastgs.mask), "Nothing of the active object was erased")


class FASTGS_OT_show_hidden(Action, bpy.types.Operator):
    """Show all Gaussians of the active object that were erased"""

    bl_idname = "fastgs.show_hidden"
    bl_label = "Restore All"
    needs = (ERASED,)

    def act(self, context):
        context.object.fastgs.mask = ""


class FASTGS_OT_invert_hidden(Action, bpy.types.Operator):
    """Show the Gaussians of the active object that were erased, and hide all others"""

    bl_idname = "fastgs.invert_hidden"
    bl_label = "Swap Erased"
    needs = (ERASED,)

    def act(self, context):
        brush.set_mask(context.object, ~brush.mask_of(context.object))
