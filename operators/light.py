# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for the light between splats and the scene: a light probe, and a node that lights splats in the compositor."""
import bpy

from ..scene import joins, light_probe, objects
from .action import OBJECT_MODE, Action, Need


class FASTGS_OT_add_light_probe(Action, bpy.types.Operator):
    """Let the splats, as they look from one place, light the meshes of Render With Meshes: around the active mesh, or at the 3D cursor"""

    bl_idname = "fastgs.add_light_probe"
    bl_label = "Light Probe"
    needs = (OBJECT_MODE,)

    def act(self, context):
        active = context.object
        around = active is not None and active.select_get() and active.type in objects.MESHABLE and not objects.is_splat(active)
        probe = light_probe.add(context, active if around else None)
        objects.select_only(context, probe)
        if context.scene.fastgs.render_meshes == 'OFF':
            return f'"{probe.name}" lights meshes once Render With Meshes is chosen'
        return f'"{probe.name}" lights the meshes'


EDITABLE_SCENE = Need(lambda context: context.scene is not None and context.scene.is_editable, "The scene is linked from another file")
OURS = Need(lambda context: context.scene.render.engine == 'FASTGS', "Choose FAST-GS as render engine first")


class FASTGS_OT_add_relight(Action, bpy.types.Operator):
    """Add a node to the compositor that lights splats by the scene's lamps, as Scene Light does, and switch on the passes that it needs"""

    bl_idname = "fastgs.add_relight"
    bl_label = "Relight in Compositor"
    needs = (EDITABLE_SCENE, OURS)

    def act(self, context):
        nodes = joins.add_relights(context.scene)
        return f"{len(nodes)} node{'s' * (len(nodes) != 1)} in the compositor: {joins.RELIGHT}; leave the objects' Scene Light as it was"
