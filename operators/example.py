# SPDX-License-Identifier: GPL-3.0-or-later
"""A model to begin with, which comes with the extension."""
from pathlib import Path

import bpy

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "playground.safetensors"


class FASTGS_OT_import_example(bpy.types.Operator):
    """Import the model that comes with FAST-GS: a small scene of fast things, trained from 13 cameras"""

    bl_idname = "fastgs.import_example"
    bl_label = "Import Example"
    bl_options = {'REGISTER', 'UNDO'}

    def execute(self, context):
        return bpy.ops.import_scene.fastgs(filepath=str(EXAMPLE), relative_path=False, set_scene_range=True, use_engine=True)
