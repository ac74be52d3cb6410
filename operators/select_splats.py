# SPDX-License-Identifier: GPL-3.0-or-later
"""A click on splats selects their object, in every shading that shows them.

Blender's own operator selects by what it has drawn itself, of which splats are no part.  It comes first; this one follows, at the end of
the click, and corrects it where a splat is what is seen.
"""
import bpy
import numpy as np
from bpy.props import BoolProperty
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

from ..engine import compiling
from ..engine.viewport import picking
from ..scene import objects


class FASTGS_OT_select(bpy.types.Operator):
    """Select the object whose splats are clicked"""

    bl_idname = "fastgs.select"
    bl_label = "Select Splats"
    bl_options = {'UNDO', 'INTERNAL'}

    toggle: BoolProperty(name="Toggle", description="Add to the selection, or take out of it", default=False)

    @classmethod
    def poll(cls, context):
        return (context.mode == 'OBJECT' and context.region is not None and context.region.type == 'WINDOW'
                and isinstance(context.space_data, bpy.types.SpaceView3D) and not compiling.is_running())

    def invoke(self, context, event):
        if event.type in {'LEFTMOUSE', 'RIGHTMOUSE'} and event.type != f"{_select_mouse(context)}MOUSE":
            return {'PASS_THROUGH'}
        obj = self._clicked(context, (event.mouse_region_x, event.mouse_region_y))
        if obj is None:
            return {'PASS_THROUGH'}
        layer = context.view_layer
        chosen = not (self.toggle and obj.select_get() and layer.objects.active == obj)
        if not self.toggle:
            objects.select_only(context, obj)
        obj.select_set(chosen)
        layer.objects.active = obj
        return {'FINISHED'}

    def _clicked(self, context, at) -> bpy.types.Object | None:
        """The object whose splats are seen at a place of the region; None where something else is."""
        active = context.view_layer.objects.active
        if active is not None and active.select_get() and active.type not in objects.SURFACES and not self.toggle:
            return None  # the click was on a camera, a light or an empty, which is drawn over all
        found = picking.seen_at(context, *at)
        if found is None:
            return None
        name, depth, camera = found
        obj = context.view_layer.objects.get(name)
        if obj is None or not obj.visible_get() or obj.hide_select:
            return None
        view, region = context.region_data, context.region
        hit, place, _, _, other, _ = context.scene.ray_cast(
            context.evaluated_depsgraph_get(), region_2d_to_origin_3d(region, view, at), region_2d_to_vector_3d(region, view, at))
        if hit and not objects.is_splat(other) and (camera.world_to_camera @ np.array([*place, 1.0]))[2] < depth:
            return None
        return obj


def _select_mouse(context) -> str:
    """The button that selects, LEFT or RIGHT, as the key map's preferences have it."""
    preferences = context.window_manager.keyconfigs.active.preferences
    return getattr(preferences, "select_mouse", 'LEFT')
