# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Import > 4D Gaussians: Example."""
from pathlib import Path

import bpy

from ..engine import compiling
from ..scene.splats.importing import Options, import_files

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "fireside.safetensors"


class FASTGS_OT_import_example(bpy.types.Operator):
    """Import the model that comes with FAST-GS: a dancer in a room, trained from 12 cameras"""

    bl_idname = "fastgs.import_example"
    bl_label = "Import Example"
    bl_options = {'REGISTER', 'UNDO'}

    def execute(self, context):
        done = import_files(context, [str(EXAMPLE)], Options(fit_range=True, use_engine=True, camera=None, view='SUBJECT'))
        if done.objects:
            compiling.start_on_first_use()
        return done.report(self)
