# SPDX-License-Identifier: GPL-3.0-or-later
"""The operator that lets the compositor light splats."""
import bpy

from ..scene import joins
from .action import Action, Need

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
