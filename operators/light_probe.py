# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that adds a light probe."""
import bpy

from ..scene import light_probe, objects
from .action import OBJECT_MODE, Action


class FASTGS_OT_add_light_probe(Action, bpy.types.Operator):
    """Let the splats, as they look from one place, light the meshes of Render With Meshes: around the active mesh, or at the 3D cursor"""

    bl_idname = "fastgs.add_light_probe"
    bl_label = "Light Probe"
    needs = (OBJECT_MODE,)

    def act(self, context):
        active = context.object
        around = active is not None and active.select_get() and active.type in objects.MESHABLE and not objects.is_splat(active)
        probe = light_probe.add(context, active if around else None)
        for obj in context.selected_objects:
            obj.select_set(False)
        probe.select_set(True)
        context.view_layer.objects.active = probe
        if context.scene.fastgs.render_meshes == 'OFF':
            return f'"{probe.name}" lights meshes once Render With Meshes is chosen'
        return f'"{probe.name}" lights the meshes'
