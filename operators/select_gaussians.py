# SPDX-License-Identifier: GPL-3.0-or-later
"""Selects, erases or restores Gaussians of the active object by what is drawn in the 3D view: a click, a stroke, a lasso, a box, a ball.

The tools of the toolbar (ui/tools.py) call this operator when the mouse button goes down; it ends when the button comes up.
"""
import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty
from mathutils import Vector

from ..engine.viewport import trails
from ..engine.viewport.eye import eye
from ..fastgs_blender.selecting.shapes import Box, Lasso, Stroke
from ..fastgs_blender.util.errors import FastGSError
from ..scene import selection
from .action import EDITABLE_SPLATS, OBJECT_MODE, Action

NEAR = 2.0
"""Pixels that the mouse must move until the path gets another point."""
CLICK = 6.0
"""Radius of what a click means, in pixels."""
STROKES = {'CIRCLE', 'CLICK'}
"""Shapes that mean what is seen under them, for Grow to the Thing."""
WORDS = {'ERASE': "hidden", 'RESTORE': "shown again"}


class FASTGS_OT_select_gaussians(Action, bpy.types.Operator):
    """Select, erase or restore Gaussians of the active object under a brush, in a lasso, a box or a ball, at all times. The file stays"""

    bl_idname = "fastgs.select_gaussians"
    bl_label = "Select Gaussians"
    bl_options = {'UNDO'}
    needs = (OBJECT_MODE, EDITABLE_SPLATS)

    shape: EnumProperty(
        name="Shape", description="What is drawn",
        items=(
            ('CIRCLE', "Brush", "A round brush that is dragged over the Gaussians", 0),
            ('BOX', "Box", "A rectangle", 1),
            ('LASSO', "Lasso", "A line around the Gaussians", 2),
            ('BALL', "Sphere", "A ball around what is clicked, as large as the mouse is dragged", 3),
            ('CLICK', "Click", "What is clicked, grown to the whole thing", 4),
        ), default='CIRCLE')
    what: EnumProperty(
        name="What", description="What happens to the Gaussians",
        items=(
            ('SELECT', "Select", "They are selected", 0),
            ('ERASE', "Erase", "They are hidden", 1),
            ('RESTORE', "Restore", "They are shown again", 2),
        ), default='SELECT')
    mode: EnumProperty(
        name="Mode", description="What becomes of the selection",
        items=(
            ('SET', "Set", "They alone are selected", 0),
            ('ADD', "Add", "They are selected too", 1),
            ('SUBTRACT', "Subtract", "They are taken out of the selection, and Grow to the Thing does not reach them", 2),
        ), default='SET', options={'SKIP_SAVE'})
    through: BoolProperty(name="Through", description="All Gaussians there, and not only those that are seen", default=True)
    radius: FloatProperty(name="Radius", description="Radius of the brush, in pixels", default=40.0, min=1.0, max=2000.0, subtype='PIXEL')
    path: CollectionProperty(
        name="Path", description="Where the mouse went, in pixels of the region from its lower left; of a box two corners",
        type=bpy.types.OperatorMousePath, options={'SKIP_SAVE'})

    def execute(self, context):
        region, view = context.region, context.region_data
        if view is None:
            return self.fail("Gaussians are selected in a 3D view; call this with one as context")
        points = [(point.loc[0], region.height - point.loc[1]) for point in self.path]
        if not points:
            return {'CANCELLED'}
        camera, _ = eye(region.width, region.height, view.view_matrix, view.window_matrix)
        try:
            sight = selection.Sight(context.evaluated_depsgraph_get(), camera)
            shape = self._drawn(points, sight)
            if shape is None:  # a ball, where nothing is
                return {'CANCELLED'}
            through = self.through and self.shape != 'CLICK'
            found = sight.under(context.object, shape, through, self.what == 'RESTORE')
            strokes = self.what == 'SELECT' and self.shape in STROKES and not through
            return self._done(context, found, sight.touched(context.object, shape) if strokes else None)
        except FastGSError as error:
            return self.fail(error)

    def _done(self, context, found, meant):
        obj = context.object
        if self.what != 'SELECT':
            count = selection.erase(obj, found, self.what == 'ERASE')
            changed, text = count > 0, f"{count:,} Gaussians {WORDS[self.what]}"
        else:
            changed = selection.drawn(obj, found, self.mode, meant)
            text = f"{selection.bits(obj, 'selection').sum():,} Gaussians selected"
        self.report({'INFO'}, text)
        return {'FINISHED'} if changed else {'CANCELLED'}  # what changes nothing is no undo step

    def _drawn(self, points, sight):
        """The library's shape of a path; None where a ball has no middle."""
        first, last = points[0], points[-1]
        if self.shape == 'BOX':
            x, y = zip(first, last, strict=True)
            return Box((min(x), min(y)), (max(x), max(y)))
        if self.shape == 'BALL':
            return sight.ball(first, self._reach())
        if self.shape == 'LASSO':
            return Lasso(tuple(points))
        return Stroke(tuple(points), CLICK) if self.shape == 'CLICK' else Stroke(tuple(points), self.radius)

    def _reach(self) -> float:
        """The radius of a ball: as far as the mouse was dragged, else the brush's."""
        dragged = (Vector(self.path[-1].loc) - Vector(self.path[0].loc)).length
        return dragged if dragged > NEAR else self.radius

    def invoke(self, context, event):
        if context.region_data is None:
            return self.execute(context)
        self.radius = context.scene.fastgs.brush_radius
        if self.what == 'SELECT':
            self.through = context.scene.fastgs.select_through
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
            done = self.execute(context)
            if self.shape == 'CLICK' and done == {'FINISHED'} and bpy.ops.fastgs.grow.poll():
                bpy.ops.fastgs.grow('INVOKE_DEFAULT')
                return {'CANCELLED'}  # it ends as the one step of undo
            return done
        elif event.type in {'ESC', 'RIGHTMOUSE'} and event.value == 'PRESS':
            self.cancel(context)
            return {'CANCELLED'}
        return {'RUNNING_MODAL'}

    def cancel(self, context):
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, 'WINDOW')
        if context.area:
            context.area.tag_redraw()

    def _draw(self, region):
        if bpy.context.region == region:
            radius = self._reach() if self.shape == 'BALL' else self.radius
            trails.draw(self.shape, [Vector(point.loc) for point in self.path], radius, self.what, self.mode)
