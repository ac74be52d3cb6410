# SPDX-License-Identifier: GPL-3.0-or-later
"""Align by Pairs: three places are clicked on each of two captures, and the one is moved onto the other."""
from dataclasses import replace
from itertools import pairwise

import blf
import bpy
import gpu
import numpy as np
from bpy.props import BoolProperty, FloatVectorProperty
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader

from ..engine.viewport import picking
from ..engine.viewport.eye import eye
from ..fastgs_blender.stitching.similarity import similarity
from ..fastgs_blender.util.errors import FastGSError
from ..scene import snapshot, stitching
from .action import IN_VIEW, OBJECT_MODE, Action
from .stepwise import VIEW
from .stitch import TWO

DOUBTFUL = 0.1
"""Share of how far the places lie from each other, from which on a rest between the pairs is no inexact click."""
COLOURS = ((1.0, 0.6, 0.2, 1.0), (0.35, 0.65, 1.0, 1.0))
"""Of the places on the object that moves and on the one that stays."""


class FASTGS_OT_align_pairs(Action, bpy.types.Operator):
    """Move the selected capture onto the active one by three places that are clicked on both, in turns: one on it, the same one there"""

    bl_idname = "fastgs.align_pairs"
    bl_label = "Align by Pairs"
    needs = (OBJECT_MODE, TWO)

    scale: BoolProperty(name="Scale", description="Change its size too; without this it is only moved and turned", default=True)
    places: FloatVectorProperty(
        name="Places", description="Six places in the world: of each pair the one on the object that moves, then the one on the other",
        size=18, subtype='NONE', options={'HIDDEN', 'SKIP_SAVE'})

    def act(self, context):
        obj, fixed = stitching.pair(context)
        if not self.properties.is_property_set("places"):
            raise FastGSError("no places are picked; click them in a 3D view, or give all six as places.")
        places = np.array(self.places, np.float64).reshape(3, 2, 3)
        found = similarity(places[:, 0], places[:, 1], self.scale)
        stitching.move(context, obj, fixed, found.matrix)
        if found.residual > DOUBTFUL * np.linalg.norm(places[:, 1] - places[:, 1].mean(0), axis=1).mean():
            self.warn(f'the pairs do not fit each other: moved onto "{fixed.name}", their places are {found.residual:.3g} apart; undo '
                      "this, and click the same places on both")
            return None
        sized = f", scaled by {found.scale:.4g}" if self.scale else ""
        return f'"{obj.name}" lies on "{fixed.name}"{sized}; its places are {found.residual:.3g} apart'

    def invoke(self, context, event):
        if self.properties.is_property_set("places"):
            return self.execute(context)
        if not IN_VIEW.met(context):
            return self.fail("places are picked in a 3D view; call this with the mouse in one")
        self._objects, self._found = stitching.pair(context), []
        try:
            stitching.check_movable(*self._objects)
        except FastGSError as error:
            return self.fail(error)
        self._region = context.region
        self._handle = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), 'WINDOW', 'POST_PIXEL')
        context.window_manager.modal_handler_add(self)
        self._tell(context)
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type in {'ESC', 'RIGHTMOUSE'} and event.value == 'PRESS':
            self.cancel(context)
            return {'CANCELLED'}
        if event.type in {'BACK_SPACE', 'Z'} and event.value == 'PRESS' and self._found:
            self._found.pop()
            self._tell(context)
        elif event.type == 'LEFTMOUSE' and event.value == 'PRESS' and not event.alt and self._holds(event):
            place = picked(context, self._objects[len(self._found) % 2], event.mouse_region_x, event.mouse_region_y)
            if place is None:
                self.warn(f'"{self._objects[len(self._found) % 2].name}" has nothing solid there')
            else:
                self._found.append(place)
                self._tell(context)
            if len(self._found) == 6:
                self.cancel(context)
                self.places = np.concatenate(self._found).tolist()
                return self.execute(context)
        elif event.type in VIEW or event.alt:
            return {'PASS_THROUGH'}
        return {'RUNNING_MODAL'}

    def _holds(self, event):
        """Whether the mouse is in the view."""
        return 0 <= event.mouse_region_x < self._region.width and 0 <= event.mouse_region_y < self._region.height

    def _tell(self, context):
        number, side = divmod(len(self._found), 2)
        if number < 3 and context.workspace:
            which = "the same place" if side else f"place {number + 1} of 3"
            context.workspace.status_text_set(
                f'Click {which} on "{self._objects[side].name}"   (Backspace takes the last one back; Esc cancels)')
        if context.area:
            context.area.tag_redraw()

    def cancel(self, context):
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, 'WINDOW')
        if context.workspace:
            context.workspace.status_text_set(None)
        if context.area:
            context.area.tag_redraw()

    def _draw(self):
        """A numbered cross on each place, and a line between the two of a pair."""
        region, view = bpy.context.region, bpy.context.region_data
        if region != self._region or view is None:
            return
        at = [location_3d_to_region_2d(region, view, place) for place in self._found]
        shader = gpu.shader.from_builtin('UNIFORM_COLOR')
        shader.bind()
        for number, point in enumerate(at):
            if point is None:
                continue
            x, y = point
            shader.uniform_float("color", COLOURS[number % 2])
            batch_for_shader(shader, 'LINES', {"pos": [(x - 8, y), (x + 8, y), (x, y - 8), (x, y + 8)]}).draw(shader)
            blf.color(0, *COLOURS[number % 2])
            blf.position(0, x + 10, y + 6, 0)
            blf.draw(0, str(number // 2 + 1))
        for number, (one, other) in enumerate(pairwise(at)):
            if number % 2 == 0 and one is not None and other is not None:
                shader.uniform_float("color", (1, 1, 1, 0.5))
                batch_for_shader(shader, 'LINES', {"pos": [tuple(one), tuple(other)]}).draw(shader)


def picked(context, obj, x: int, y: int) -> np.ndarray | None:
    """The place [3] in the world of an object's surface at a pixel of the region, whatever lies before it; None where it has none."""
    region, view = context.region, context.region_data
    camera, _ = eye(region.width, region.height, view.view_matrix, view.window_matrix)
    shown = snapshot.take(context.evaluated_depsgraph_get(), rendered=False)
    found = picking.splats_at(replace(shown, instances=[item for item in shown.instances if item.name == obj.name]), camera, x, y)
    if found is None:
        return None
    depth = found[1]
    column, row = x + 0.5 - camera.cx, camera.height - 1 - y + 0.5 - camera.cy
    at = np.array([column / camera.fx, row / camera.fy, 1.0]) * (1.0 if camera.orthographic else depth)
    at[2] = depth
    return (np.linalg.inv(camera.world_to_camera) @ [*at, 1.0])[:3]
